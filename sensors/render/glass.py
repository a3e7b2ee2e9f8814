"""Glass of the wavefront path tracer: refraction, Fresnel loss, haze, wavy walls.

A face transmits by Snell's law and reflects by Fresnel's. Two numbers of a material describe walls
that are not what the mesh shows: `bend` is the share of the refraction of a wall as thick as the
mesh's (a sheet of plastic, much thinner, hardly shifts what lies behind it), and `waves` deviates
what is transmitted, as a wall of uneven thickness does.

Light from the projector and the sky reaches surfaces behind glass on a straight line, with the
losses of all faces that it crosses. For walls with parallel faces this is exact but for a shift by
less than their thickness. Solids bend it: they let a share of it through (`Table.shadow`).

Import only after a variant has been set.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit
import mitsuba
import numpy as np

from sensors.materials.material_draw import Glass

mi: Any = mitsuba  # their types differ by variant
dr: Any = drjit

FACES = 4
"""Faces that light crosses on its way through a hollow object; `transmission` is of all."""

THICK_SHARE = 0.06
"""An object with a larger mean thickness, relative to its diagonal, is solid."""

SOLID_SHADOW = 0.25
"""Share of the projector's light that reaches a surface behind a solid at the same place."""

WEAK = 0.3
"""Reflectance of a face below which the reflected light of the projector is left out.

Random choices between little reflected and much transmitted light would put noise on the dots.
"""

_WAVES = 8
_SMOOTHEST = 2e-3
_SHARPEST_GLINT = 0.03


@dataclass(frozen=True, eq=False)
class GlassSurface:
    """The glass of one mesh.

    Attributes:
        material: drawn numbers.
        tint: (3,) transmittance of the whole object by colour, `transmission` apart.
        solid: whether the mesh has no cavity.
        seed: of its waves.
    """

    material: Glass
    tint: tuple[float, float, float]
    solid: bool
    seed: int


@dataclass(eq=False)
class Face:
    """Numbers of the face of glass at every ray; without meaning where `clear` is false."""

    clear: Any
    ior: Any
    bent: Any
    passed: Any
    shadow: Any
    alpha: Any
    glint: Any
    haze: Any
    waves: Any
    scale: Any
    phase: Any


class Table:
    """The glass surfaces of a scene by the tracer's number of a shape.

    Args:
        shapes: Mitsuba meshes of the active variant.
        surfaces: of each, None where it is opaque.
    """

    def __init__(self, shapes: Sequence[Any], surfaces: Sequence[GlassSurface | None]) -> None:
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in shapes]
        rows = np.zeros((max(numbers) + 1, 16), np.float32)
        for number, surface in zip(numbers, surfaces, strict=True):
            if surface is None:
                continue
            g = surface.material
            phase = np.random.default_rng(surface.seed).uniform(0, 100, 3)
            passed = (np.asarray(surface.tint) * g.transmission) ** (1 / FACES)
            rows[number] = (
                1,
                g.ior,
                1 + g.bend * (g.ior - 1),
                *passed,
                SOLID_SHADOW**0.5 if surface.solid else 1,
                max(g.roughness**2, _SMOOTHEST),
                max(g.gloss_roughness**2, _SHARPEST_GLINT),
                g.haze,
                np.deg2rad(g.waves_deg),
                1 / g.wave_m,
                *phase,
                0,
            )
        self._columns = [mi.Float(np.ascontiguousarray(c)) for c in rows.T]

    def at(self, shape: Any, active: Any) -> Face:
        """The numbers of the shapes (a pointer per ray)."""
        index = dr.reinterpret_array(mi.UInt32, shape)
        c = [dr.gather(mi.Float, column, index, active) for column in self._columns[:15]]
        _, ior, bent, red, green, blue, shadow, alpha, glint, haze, waves, scale, *phase = c
        return Face(
            clear=active & (c[0] > 0),
            ior=ior,
            bent=bent,
            passed=mi.Spectrum(red, green, blue),
            shadow=shadow,
            alpha=alpha,
            glint=glint,
            haze=haze,
            waves=waves,
            scale=scale,
            phase=mi.Vector3f(*phase),
        )


def fresnel(cosine: Any, ior: Any) -> Any:
    """Reflectance of a face for unpolarised light that arrives outside at a cosine."""
    inner = dr.safe_sqrt(1 - (1 - dr.square(cosine)) / dr.square(ior))
    across = (cosine - ior * inner) / (cosine + ior * inner)
    along = (ior * cosine - inner) / (ior * cosine + inner)
    return 0.5 * (dr.square(across) + dr.square(along))


def straight(face: Face, cosine: Any) -> Any:
    """Share of light that a face passes on a straight line, by colour."""
    return face.passed * ((1 - fresnel(dr.abs(cosine), face.ior)) * face.shadow * (1 - face.haze))


def deviation(face: Face, p: Any) -> Any:
    """A smooth field of small vectors: the slopes of a wall at points of the world."""
    rng = np.random.default_rng(7)
    total = mi.Vector3f(0)
    x = p * face.scale * dr.two_pi + face.phase
    for _ in range(_WAVES):
        k, along = rng.normal(size=3), rng.normal(size=3)
        k *= rng.uniform(0.5, 1.5) / np.linalg.norm(k)
        total += mi.Vector3f(*(float(v) for v in along)) * dr.cos(
            x.x * float(k[0]) + x.y * float(k[1]) + x.z * float(k[2]) + float(rng.uniform(0, 6))
        )
    return total * (face.waves * float((2 / _WAVES / 3) ** 0.5))


def scattered(face: Face, si: Any, d: Any, towards: Any) -> Any:
    """Scattering of light from a direction into -d, times its cosine: haze and a highlight."""
    n = si.sh_frame.n
    out, into = dr.abs(dr.dot(n, d)), dr.abs(dr.dot(n, towards))
    half = dr.normalize(towards - d)
    same = dr.dot(n, towards) * dr.dot(n, d) < 0
    a2 = dr.square(face.glint)
    peak = a2 / (dr.pi * dr.square(dr.square(dr.dot(n, half)) * (a2 - 1) + 1))
    mirrored = fresnel(dr.abs(dr.dot(half, d)), face.ior) * peak / (4 * dr.maximum(out, 0.1))
    return face.haze * dr.inv_pi * into + dr.select(same, dr.minimum(mirrored, 4), 0)


def crossed(
    face: Face, si: Any, d: Any, choice: Any, rough: Any, *, dots: bool
) -> tuple[Any, Any, Any]:
    """Directions of rays after a face.

    Args:
        face: of glass.
        si: where rays meet it.
        d: their directions.
        choice, rough: one and two random numbers of each.
        dots: whether the projector is the only light, of which weak reflections are left out.

    Returns:
        Directions, weights by colour, and whether they are reflected.
    """
    slope = deviation(face, si.p)
    spread = face.alpha * dr.safe_sqrt(-dr.log(dr.maximum(1 - rough.x, 1e-6)))
    sin, cos = dr.sincos(dr.two_pi * rough.y)
    n = si.sh_frame.n
    m = dr.normalize(n + si.sh_frame.s * (spread * cos) + si.sh_frame.t * (spread * sin) + slope)
    facing = -dr.dot(d, m)
    enters = facing > 0
    m = dr.select(enters, m, -m)
    inside = dr.abs(facing)
    ratio = dr.select(enters, 1 / face.bent, face.bent)
    sin2 = dr.square(ratio) * (1 - dr.square(inside))
    total = sin2 >= 1
    beyond = dr.safe_sqrt(1 - sin2)
    reflectance = dr.select(total, 1, fresnel(dr.select(enters, inside, beyond), face.ior))
    chance = dr.select(reflectance < WEAK, 0, reflectance) if dots else reflectance
    mirror = choice < chance
    kept = 1 - face.haze
    weight = dr.select(
        mirror,
        mi.Spectrum(kept),
        face.passed * (kept * (1 - reflectance) / dr.maximum(1 - chance, 1e-6)),
    )
    through = d * ratio + m * (ratio * inside - beyond)
    # A wall of uneven thickness deviates; along the wall only, so that rays stay on their side.
    through += slope - m * dr.dot(slope, m)
    turned = dr.select(mirror, d + m * (2 * inside), through)
    return dr.normalize(turned), weight, mirror
