"""Solids that objects are put together from: y up, any unit, closed by construction.

Everything is a `manifold3d.Manifold`: unions and cuts of them are closed again, which meshes glued
together would not be.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

Array = NDArray[np.float64]
LATHE_SECTIONS = 80


def polygon(points: ArrayLike) -> CrossSection:
    """A filled polygon (N, 2), whichever way round it is given."""
    from manifold3d import CrossSection, FillRule

    p = np.asarray(points, dtype=np.float64)
    x, y = p.T
    if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0:
        p = p[::-1]
    return CrossSection([p.tolist()], FillRule.NonZero)


def rectangle(low: Sequence[float], high: Sequence[float]) -> CrossSection:
    """An axis-aligned rectangle between two corners (2,)."""
    return polygon([low, (high[0], low[1]), high, (low[0], high[1])])


def rounded(section: CrossSection, radius: float, segments: int = 20) -> CrossSection:
    """Convex corners rounded by a radius; parts thinner than twice the radius vanish."""
    from manifold3d import JoinType

    inner = section.offset(-radius, JoinType.Miter, 4.0)
    return inner.offset(radius, JoinType.Round, 2.0, segments)


def outline_of_turn(profile: ArrayLike) -> CrossSection:
    """The section of a turned body by a plane through its axis.

    Args:
        profile: (N, 2) radius and height from the bottom to the top, the outer side only.
    """
    p = np.asarray(profile, dtype=np.float64)
    return polygon(np.concatenate([p, (p * [-1, 1])[::-1]]))


def vessel(profile: ArrayLike, wall: float, *, base: float) -> CrossSection:
    """Section of a hollow turned body, open at its top.

    Args:
        profile: (N, 2) outer radius and height, bottom to top.
        wall: thickness of the wall, the same everywhere.
        base: thickness of the bottom at the axis.
    """
    from manifold3d import JoinType

    p = np.asarray(profile, dtype=np.float64)
    floor, top = p[:, 1].min() + base, p[:, 1].max()
    # The hollow is that of a body which goes on beyond the mouth the way it reaches it.
    slope = (p[-1] - p[-2]) / np.linalg.norm(p[-1] - p[-2])
    beyond = np.maximum(p[-1] + 4 * wall * slope, [0.1 * wall, 0])
    longer = outline_of_turn(np.concatenate([p, [beyond, beyond + np.array([0, 4 * wall])]]))
    reach = 2 * float(p[:, 0].max()) + 8 * wall
    room = longer.offset(-wall, JoinType.Round, 2.0, 32)
    room = room ^ rectangle((-reach, floor), (reach, top + wall))
    body = outline_of_turn(p) - rounded(room, min(0.3 * base, 0.3 * wall))
    return rounded(body, 0.35 * min(wall, base), 14)


def turned(section: CrossSection, sections: int = LATHE_SECTIONS) -> Manifold:
    """The body that a section of radius and height makes by turning about y."""
    return section.revolve(sections).rotate([-90, 0, 0])


def smooth_profile(keys: ArrayLike, samples: int = 40) -> Array:
    """(N, 2) radius and height through key points of rising height, without overshoot."""
    from scipy.interpolate import PchipInterpolator

    r, y = np.asarray(keys, dtype=np.float64).T
    heights = np.unique(np.concatenate([np.linspace(y[0], y[-1], samples), y]))
    return np.stack([PchipInterpolator(y, r)(heights), heights], axis=1)


def along_x(section: CrossSection, width: float) -> Manifold:
    """A section of (z, y) made as wide as `width`, centred at x = 0."""
    from manifold3d import Manifold

    solid = Manifold.extrude(section.mirror([1, 0]), width)
    return solid.translate([0, 0, -width / 2]).rotate([0, 90, 0])


def along_y(section: CrossSection, low: float, high: float) -> Manifold:
    """A section of (x, z) between two heights."""
    from manifold3d import Manifold

    solid = Manifold.extrude(section.mirror([0, 1]), high - low)
    return solid.rotate([-90, 0, 0]).translate([0, low, 0])


def along_z(section: CrossSection, low: float, high: float) -> Manifold:
    """A section of (x, y) between two z."""
    from manifold3d import Manifold

    return Manifold.extrude(section, high - low).translate([0, 0, low])


def box(low: Sequence[float], high: Sequence[float]) -> Manifold:
    """An axis-aligned box between two corners (3,)."""
    from manifold3d import Manifold

    size = (np.asarray(high, dtype=np.float64) - low).tolist()
    return Manifold.cube(size).translate(list(map(float, low)))


def rounded_box(size: Sequence[float], radius: float, segments: int = 20) -> Manifold:
    """A box of a size (3,) about the origin with rounded edges."""
    from manifold3d import Manifold

    ball = Manifold.sphere(radius, segments)
    x, y, z = (s / 2 - radius for s in size)
    corners = [(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    return Manifold.batch_hull([ball.translate(c) for c in corners])


def ellipsoid(size: Sequence[float], segments: int = 32) -> Manifold:
    """An ellipsoid of a size (3,) about the origin."""
    from manifold3d import Manifold

    return Manifold.sphere(0.5, segments).scale(list(map(float, size)))


def rod(
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    end_radius: float | None = None,
    segments: int = 32,
) -> Manifold:
    """A round bar between two points (3,), conical if its ends differ."""
    from manifold3d import Manifold

    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    bar = Manifold.cylinder(length, radius, radius if end_radius is None else end_radius, segments)
    return bar.transform(np.stack([x, np.cross(z, x), z, a], axis=1))


def loft(rings: ArrayLike) -> Manifold:
    """The skin over rings (N, S, 3) of equally many points, both ends closed flat.

    Raises:
        ToolkitError: the rings make no closed solid.
    """
    r = np.asarray(rings, dtype=np.float64)
    count, sides, _ = r.shape
    vertices = np.concatenate([r.reshape(-1, 3), r[0].mean(0)[None], r[-1].mean(0)[None]])
    i, j = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a, b = (i * sides + j).ravel(), (i * sides + (j + 1) % sides).ravel()
    k = np.arange(sides)
    first, last = count * sides, (count - 1) * sides
    faces = np.concatenate(
        [
            np.stack([a, a + sides, b], 1),
            np.stack([b, a + sides, b + sides], 1),
            np.stack([k, (k + 1) % sides, np.full(sides, first)], 1),
            np.stack([last + (k + 1) % sides, last + k, np.full(sides, first + 1)], 1),
        ]
    )
    return closed(vertices, faces)


def tube(
    path: ArrayLike, half_width: ArrayLike, half_height: ArrayLike, sides: int = 24
) -> Manifold:
    """A bar along a path (N, 3) in the x-y plane, its section an ellipse.

    Args:
        half_width: along z, one number or one per point.
        half_height: across the path within the plane, likewise.
    """
    p = np.asarray(path, dtype=np.float64)
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(tangent, [0.0, 0.0, 1.0])
    turn = 2 * np.pi * np.arange(sides) / sides
    w = np.broadcast_to(np.asarray(half_width, dtype=np.float64), len(p))[:, None, None]
    h = np.broadcast_to(np.asarray(half_height, dtype=np.float64), len(p))[:, None, None]
    flat = np.array([0.0, 0.0, 1.0])
    return loft(
        p[:, None]
        + h * np.cos(turn)[None, :, None] * across[:, None]
        + w * np.sin(turn)[None, :, None] * flat
    )


def closed(vertices: Array, faces: NDArray[Any]) -> Manifold:
    """A solid of a closed mesh, turned inside out if it was given so.

    Raises:
        ToolkitError: the mesh is not closed.
    """
    from manifold3d import Error, Manifold, Mesh64

    def made(order: NDArray[Any]) -> Manifold:
        mesh = Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(order, np.uint64))
        return Manifold(mesh)

    solid = made(faces)
    if solid.status() == Error.NoError and solid.volume() < 0:
        solid = made(faces[:, ::-1])
    if solid.status() != Error.NoError or solid.volume() <= 0:
        raise ToolkitError("the surface does not close to a solid", value=str(solid.status()))
    return solid


def united(solids: Sequence[Manifold]) -> Manifold:
    """The union of solids."""
    from manifold3d import Manifold, OpType

    return Manifold.batch_boolean(list(solids), OpType.Add)
