"""Aeroplanes: fuselage, wings, tail and engines; nose towards -z."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sensors.assets.procedural import solids
from std_toolkit.arrays import Array

if TYPE_CHECKING:
    from manifold3d import Manifold

PLANS = ("airliner", "jumbo", "business", "propeller", "biplane", "fighter")


def aeroplane(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """An aeroplane about 10 units long."""
    plan = PLANS[int(rng.integers(len(PLANS)))]
    if plan in ("airliner", "jumbo", "business"):
        return _jet(rng, paint, plan)
    if plan == "fighter":
        return _fighter(rng, paint)
    return _propeller(rng, paint, biplane=plan == "biplane")


def _jet(rng: np.random.Generator, paint: solids.Paint, plan: str) -> Manifold:
    r = float({"airliner": 0.52, "jumbo": 0.62, "business": 0.5}[plan] * rng.uniform(0.94, 1.06))
    body, accent = solids.one_of(rng, solids.WHITE, solids.SILVER, solids.WHITE), solids.vivid(rng)
    spine = [(-5.0, 0.02, -0.2), (-4.9, 0.3, -0.16), (-4.55, 0.62, -0.08), (-4.0, 0.88, -0.02)]
    spine += [(-3.3, 1.0, 0.0), (2.2, 1.0, 0.0), (3.4, 0.8, 0.12), (4.4, 0.45, 0.3)]
    spine += [(5.0, 0.14, 0.42)]
    hull = _fuselage(spine, r)
    made = _with_glass(paint, hull, body, [
        solids.box((-1, 0.1 * r, -4.75), (1, 0.5 * r, -4.3)),
        *([_row(r, -3.6, 3.0, 26)] if plan != "business" else [_row(r, -2.6, 0.6, 6)]),
    ])  # fmt: skip
    sweep = float(rng.uniform(1.6, 2.3))
    span = float(rng.uniform(4.2, 5.0)) * (0.85 if plan == "business" else 1)
    chord = float(rng.uniform(1.7, 2.1)) * (0.85 if plan == "business" else 1)
    wing_z = float(rng.uniform(-0.9, -0.5)) + (0.6 if plan == "business" else 0)
    for side in (-1, 1):
        wing = _wing(
            (side * 0.3 * r, -0.5 * r, wing_z),
            (side * span, -0.5 * r + 0.09 * span, wing_z + sweep),
            chord,
            0.34 * chord,
            0.13,
        )
        made += paint(wing, solids.one_of(rng, body, solids.SILVER))
        if plan != "business":
            count = 2 if plan == "jumbo" else 1
            for k in range(count):
                share = 0.36 if count == 1 else (0.3, 0.58)[k]
                x = side * share * span
                y = -0.5 * r + 0.09 * span * share - 0.36
                z = wing_z + sweep * share - 0.15
                made += _engine(paint, (x, y, z), 0.33 if count == 1 else 0.27, 1.25, accent)
                pylon = solids.box((x - 0.04, y + 0.1, z - 0.3), (x + 0.04, y + 0.42, z + 0.65))
                made += paint(pylon, solids.GREY)
        else:
            x = side * (r + 0.3)
            made += _engine(paint, (x, 0.35 * r, 2.2), 0.3, 1.5, accent)
            made += paint(
                solids.box((min(0, x), 0.3 * r - 0.05, 2.0), (max(0, x), 0.3 * r + 0.05, 2.8)), body
            )
    t_tail = plan == "business" or rng.uniform() < 0.2
    height = float(rng.uniform(1.8, 2.2))
    fin = _wing((0, 0.3 * r, 3.2), (0, 0.3 * r + height, 4.6), 1.7, 0.8, 0.1)
    made += paint(fin, accent)
    at = 0.3 * r + (0.96 * height if t_tail else 0.15)
    for side in (-1, 1):
        z = 4.45 if t_tail else 3.7
        stab = _wing((0, at, z), (side * 1.75, at + 0.12, z + 0.8), 1.05, 0.45, 0.1)
        made += paint(stab, accent if t_tail else body)
    return made


def _propeller(rng: np.random.Generator, paint: solids.Paint, *, biplane: bool) -> Manifold:
    r = float(rng.uniform(0.62, 0.75))
    body, accent = (
        solids.vivid(rng),
        solids.one_of(rng, solids.WHITE, solids.vivid(rng), solids.hsv(0.15, 0.8, 0.9)),
    )
    spine = [(-4.2, 0.55, -0.05), (-4.0, 0.78, -0.04), (-3.4, 0.92, 0.0), (-2.2, 1.0, 0.02)]
    spine += [(-0.2, 1.0, 0.05), (2.0, 0.62, 0.1), (4.0, 0.26, 0.14), (4.6, 0.1, 0.15)]
    hull = _fuselage(spine, r)
    high_wing = not biplane and rng.uniform() < 0.5
    cabin = solids.ellipsoid((1.25 * r, 1.3 * r, 2.9), 28).translate([0, 0.8 * r, -0.8])
    if biplane:
        pit = solids.rod((0, 0.55 * r, 0.35), (0, 2 * r, 0.35), 0.45, None, 28)
        made = paint(hull, body) - paint(pit, solids.DARK)
        screen = solids.ellipsoid((0.8, 0.6, 0.12), 16).translate([0, 0.95 * r, -0.2])
        made += paint(screen, solids.GLASS)
    else:
        made = paint(hull, body) + paint(cabin, solids.GLASS)
        frame = solids.box((-0.72 * r, 0.5, -0.85), (0.72 * r, 1.52 * r, -0.72))
        made += paint(frame ^ cabin.scale([1.02, 1.02, 1.0]), body)
    span, chord = float(rng.uniform(4.4, 5.2)), float(rng.uniform(1.5, 1.8))
    sweep = float(rng.uniform(-0.1, 0.35))
    levels = [1.5 * r] if high_wing else [-0.55 * r]
    if biplane:
        span *= 0.85
        levels = [-0.65 * r, 1.75 * r]
    for level in levels:
        rise = 0.05 * span if level < 0 else 0.02 * span
        z = -1.9 if level > 0 or not biplane else -1.6
        for side in (-1, 1):
            end = (side * span, level + rise, z + sweep)
            wing = _wing((-side * 0.05, level, z), end, chord, chord * 0.8, 0.12)
            made += paint(wing, accent)
    if biplane:
        for side in (-1, 1):
            for z in (-1.5, -0.6):
                x = side * 0.68 * span
                strut = solids.rod(
                    (x, levels[0], z + 0.2), (x, levels[1] + 0.05, z), 0.05, None, 10
                )
                made += paint(strut, solids.DARK)
                brace = solids.rod(
                    (side * 0.4, 0.5 * r, z), (side * 0.6, levels[1], z), 0.05, None, 10
                )
                made += paint(brace, solids.DARK)
    elif high_wing:
        for side in (-1, 1):
            foot, tip = (side * 0.6 * r, -0.4 * r, -1.1), (side * 0.5 * span, levels[0], -1.2)
            made += paint(solids.rod(foot, tip, 0.05, None, 10), solids.GREY)
    made += _nose(rng, paint)
    made += paint(_wing((0, 0, 3.2), (0, 1.6, 4.2), 1.5, 0.75, 0.1), accent)
    for side in (-1, 1):
        stab = _wing((0, 0.15, 3.4), (side * 1.7, 0.2, 3.8), 1.1, 0.7, 0.1)
        made += paint(stab, accent)
    return made + _undercarriage(paint, r)


def _nose(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    """Spinner and blades."""
    z = -4.25
    blades = int(rng.integers(2, 5))
    cone = solids.lathe([(0.3, 0), (0.27, 0.2), (0.17, 0.42), (0.03, 0.55)], 32)
    made = paint(cone.rotate([-90, 0, 0]).translate([0, -0.03, z + 0.08]), solids.SILVER)
    length = float(rng.uniform(1.2, 1.5))
    blade = (
        solids.ellipsoid((0.2, length, 0.06), 20).rotate([0, 35, 0]).translate([0, length / 2, 0])
    )
    for k in range(blades):
        part = blade.rotate([0, 0, 360 * k / blades + 20]).translate([0, -0.03, z])
        made += paint(part, solids.DARK)
    return made


def _undercarriage(paint: solids.Paint, r: float) -> Manifold:
    made = None
    for x, y, z, size in (
        (-0.95, -r - 0.75, -1.8, 0.34),
        (0.95, -r - 0.75, -1.8, 0.34),
        (0.0, -0.28, 4.1, 0.16),
    ):
        wheel = solids.rod((x - 0.1, y, z), (x + 0.1, y, z), size, None, 32)
        leg = solids.rod((x, y, z), (0.35 * x, y + (0.9 if x else 0.4), z), 0.06, None, 10)
        for solid, color in ((wheel, solids.DARK), (leg, solids.GREY)):
            part = paint(solid, color)
            made = part if made is None else made + part
    return made


def _fighter(rng: np.random.Generator, paint: solids.Paint) -> Manifold:
    r = float(rng.uniform(0.55, 0.65))
    body = solids.one_of(rng, (122, 132, 140), (96, 104, 92), (150, 152, 150), (88, 110, 140))
    darker: solids.Rgb = tuple(int(0.75 * c) for c in body)  # type: ignore[assignment]
    spine = [(-5.4, 0.03, -0.05), (-4.9, 0.22, -0.04), (-4.0, 0.5, 0.0), (-2.8, 0.8, 0.0)]
    spine += [(-1.0, 1.0, 0.0), (2.0, 1.02, 0.0), (4.2, 0.72, 0.0), (4.4, 0.68, 0.0)]
    hull = _fuselage(spine, r, flat=0.9)
    made = paint(hull, body)
    made += paint(
        solids.ellipsoid((0.72 * r, 1.05 * r, 2.3), 28).translate([0, 0.62 * r, -2.5]), solids.GLASS
    )
    for side in (-1, 1):
        intake = solids.loft(_rounded_rings(side * 0.95 * r, -0.1 * r, 0.4, 0.52, (-1.6, 2.8)))
        made += paint(intake, body)
        made -= paint(
            solids.loft(_rounded_rings(side * 0.97 * r, -0.1 * r, 0.3, 0.42, (-2.0, -1.1))),
            solids.DARK,
        )
    delta = rng.uniform() < 0.5
    span = float(rng.uniform(2.9, 3.5))
    root, tip = (4.2, 0.7) if delta else (2.8, 0.8)
    front = 0.0 if delta else 0.2
    for side in (-1, 1):
        wing = _wing(
            (0, -0.1 * r, front - 0.4), (side * span, -0.1 * r, front + root - 0.9), root, tip, 0.06
        )
        made += paint(wing, darker)
        if delta:
            canard = _wing((0, 0.1 * r, -2.3), (side * 1.6, 0.15 * r, -1.5), 1.2, 0.4, 0.07)
            made += paint(canard, darker)
        else:
            stab = _wing((0, 0, 3.2), (side * 1.9, -0.05, 4.3), 1.4, 0.6, 0.07)
            made += paint(stab, darker)
        rail = solids.rod(
            (side * span, -0.1 * r, front + root - 1.5),
            (side * span, -0.1 * r, front + root + 0.4),
            0.09,
            None,
            14,
        )
        made += paint(rail, solids.WHITE)
    twin = rng.uniform() < 0.6
    for x in (-0.75 * r, 0.75 * r) if twin else (0.0,):
        fin = _wing((x, 0.4 * r, 2.6), (1.7 * x, 0.4 * r + 1.65, 4.1), 1.6, 0.7, 0.07)
        made += paint(fin, darker)
    for x in (-0.5 * r, 0.5 * r) if twin else (0.0,):
        nozzle = solids.turned(
            solids.outline_of_turn([(0.42, 0.0), (0.34, 0.7)])
            - solids.outline_of_turn([(0.3, 0.35), (0.26, 0.8)])
        )
        made += paint(nozzle.rotate([90, 0, 0]).translate([x, 0, 4.1]), solids.DARK)
    return made


def _fuselage(spine: list[tuple[float, float, float]], r: float, *, flat: float = 1.0) -> Manifold:
    """Round sections along z: (z, radius as a fraction, centre height as a fraction)."""
    from scipy.interpolate import PchipInterpolator

    z, size, rise = np.array(spine).T
    fine = np.unique(np.concatenate([np.linspace(z[0], z[-1], 44), z]))
    radius = PchipInterpolator(z, size)(fine) * r
    middle = PchipInterpolator(z, rise)(fine) * r
    turn = 2 * np.pi * np.arange(48) / 48
    x = radius[:, None] * np.cos(turn)
    y = flat * radius[:, None] * np.sin(turn) + middle[:, None]
    return solids.loft(np.stack([x, y, np.broadcast_to(fine[:, None], x.shape)], axis=-1))


def _rounded_rings(
    x: float, y: float, half_w: float, half_h: float, ends: tuple[float, float]
) -> Array:
    turn = 2 * np.pi * np.arange(32) / 32
    c, s = np.cos(turn), np.sin(turn)
    ring = np.stack(
        [
            x + half_w * np.sign(c) * np.abs(c) ** 0.5,
            y + half_h * np.sign(s) * np.abs(s) ** 0.5,
            np.zeros(32),
        ],
        axis=1,
    )
    return np.stack([ring + np.array([0, 0, z]) for z in np.linspace(*ends, 5)])


def _wing(
    root: tuple[float, float, float],
    tip: tuple[float, float, float],
    root_chord: float,
    tip_chord: float,
    thickness: float,
) -> Manifold:
    """A wing between two leading-edge points, chords along +z, with a symmetric aerofoil."""
    u = (1 - np.cos(np.linspace(0, np.pi, 13))) / 2
    half = (
        5
        * thickness
        * (0.2969 * u**0.5 - 0.126 * u - 0.3516 * u**2 + 0.2843 * u**3 - 0.1036 * u**4)
    )
    # The trailing edge keeps a minimum thickness; otherwise it is not a solid.
    half = np.maximum(half, 0.012)
    half[0] = 0.0
    profile = np.concatenate([np.stack([u, half], 1), np.stack([u[::-1], -half[::-1]], 1)[:-1]])
    a, b = np.array(root), np.array(tip)
    span = b - a
    out = np.array([span[0], span[1], 0.0])
    out /= np.linalg.norm(out)
    normal = np.cross([0.0, 0.0, 1.0], out)
    rings = []
    for share in np.linspace(0, 1, 9):
        chord = root_chord + (tip_chord - root_chord) * share
        thick = chord if share < 0.97 else 0.6 * chord
        ring = a + share * span + chord * profile[:, :1] * [0, 0, 1.0]
        rings.append(ring + thick * profile[:, 1:] * normal)
    return solids.loft(np.stack(rings))


def _engine(
    paint: solids.Paint,
    at: tuple[float, float, float],
    radius: float,
    length: float,
    color: solids.Rgb,
) -> Manifold:
    """A nacelle along z, its front at `at`, with fan and cone within."""
    keys = [(0.86, 0.0), (0.98, 0.08), (1.0, 0.35), (0.9, 0.75), (0.68, 1.0)]
    outer = solids.outline_of_turn([(radius * r, length * z) for r, z in keys])
    duct = solids.outline_of_turn([(0.76 * radius, -0.1), (0.74 * radius, 0.22 * length)])
    jet = solids.outline_of_turn([(0.4 * radius, 0.85 * length), (0.55 * radius, 1.1 * length)])
    shell = paint(solids.turned(solids.rounded(outer, 0.02), 40), color)
    made = (
        shell
        - paint(solids.turned(duct, 40), solids.DARK)
        - paint(solids.turned(jet, 40), solids.DARK)
    )
    cone = solids.outline_of_turn([(0.04, 0.06 * length), (0.26 * radius, 0.3 * length)])
    made += paint(solids.turned(cone, 24), solids.SILVER)
    # Bodies of revolution have their axis along y; nacelles have it along z.
    return made.rotate([90, 0, 0]).translate(list(at))


def _row(r: float, start: float, end: float, count: int) -> Manifold:
    """Blocks through the fuselage at the cabin windows."""
    from manifold3d import Manifold

    step = (end - start) / count
    window = solids.box((-1, 0.12 * r, -0.28 * step), (1, 0.12 * r + 0.17, 0.28 * step))
    return Manifold.compose([window.translate([0, 0, start + step * k]) for k in range(count)])


def _with_glass(
    paint: solids.Paint, hull: Manifold, color: solids.Rgb, windows: list[Manifold]
) -> Manifold:
    """The hull with window openings; a slightly thinner body of glass fills them."""
    shell = paint(hull, color)
    for window in windows:
        shell -= paint(window, solids.DARK)
    return shell + paint(hull.scale([0.965, 0.97, 0.993]), solids.GLASS)
