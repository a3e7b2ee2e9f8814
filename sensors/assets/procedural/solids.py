"""Solids and colours for procedural shapes, finished as one mesh.

Every solid is a `manifold3d.Manifold`: unions and differences of them are closed again, unlike
meshes that are merely joined.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

Rgb = tuple[int, int, int]

DARK: Rgb = (32, 33, 36)

GREY: Rgb = (120, 122, 126)

SILVER: Rgb = (190, 192, 196)

WHITE: Rgb = (236, 234, 228)

GLASS: Rgb = (38, 52, 66)

RED: Rgb = (178, 32, 30)

AMBER: Rgb = (226, 150, 40)

# Colour of faces that a cut exposes if the cutter has no colour.
_BARE = GREY

FEWEST_FACES, MOST_FACES = 2000, 20000

Array = NDArray[np.float64]

LATHE_SECTIONS = 80

BODY = "body"
"""Name of the part that has the object's material."""


class Paint:
    """Keeps the colour of every part through unions and differences.

    Attributes:
        cavity: what a closed vessel can contain, in the coordinates of its parts; None: nothing.
    """

    def __init__(self) -> None:
        self._colors: dict[int, Rgb] = {}
        self._names: dict[int, str] = {}
        self.cavity: Manifold | None = None

    def __call__(self, solid: Manifold, color: Rgb, name: str = BODY) -> Manifold:
        """The solid as a part with a colour. Cutting with it leaves its colour on the cut.

        Args:
            name: of the part; "cap", "label" and "print" are opaque on glass objects.
        """
        part = solid.as_original()
        self._colors[part.original_id()] = color
        self._names[part.original_id()] = name
        return part

    def mesh(
        self, body: Manifold
    ) -> tuple[Array, NDArray[np.int64], NDArray[np.uint8], NDArray[np.str_]]:
        """Vertices (V, 3), faces (F, 3), their colours (F, 3) and parts (F,) of a finished body.

        Slivers left by cuts are removed, and large flat faces are divided until there are some
        thousands of faces.

        Raises:
            ToolkitError: the body is empty or exceeds the number of faces.
        """
        low, high = np.split(np.array(body.bounding_box()), 2)
        diagonal = float(np.linalg.norm(high - low))
        tolerance = 1e-5
        solid = body.simplify(tolerance * diagonal)
        while solid.num_tri() > MOST_FACES and tolerance < 2e-3:
            tolerance *= 2
            solid = body.simplify(tolerance * diagonal)
        length = 0.25
        while solid.num_tri() < FEWEST_FACES and length > 0.01:
            solid = solid.refine_to_length(length * diagonal)
            length *= 0.8
        if not FEWEST_FACES <= solid.num_tri() <= MOST_FACES:
            raise ToolkitError("a procedural body has too many faces", value=solid.num_tri())
        mesh = solid.to_mesh64()
        faces = np.asarray(mesh.tri_verts, dtype=np.int64)
        colors = np.empty((len(faces), 3), dtype=np.uint8)
        names = np.empty(len(faces), dtype="U8")
        starts = np.asarray(mesh.run_index, dtype=np.int64) // 3
        for k, original in enumerate(mesh.run_original_id):
            colors[starts[k] : starts[k + 1]] = self._colors.get(int(original), _BARE)
            names[starts[k] : starts[k + 1]] = self._names.get(int(original), BODY)
        return np.asarray(mesh.vert_properties[:, :3], dtype=np.float64), faces, colors, names


def hsv(hue: float, saturation: float, value: float) -> Rgb:
    """RGB bytes of a hue, saturation and value in [0, 1]."""
    r, g, b = colorsys.hsv_to_rgb(hue % 1, saturation, value)
    return round(255 * r), round(255 * g), round(255 * b)


def vivid(rng: np.random.Generator) -> Rgb:
    """A saturated colour, as on packaging and toys."""
    return hsv(rng.uniform(), rng.uniform(0.55, 0.9), rng.uniform(0.5, 0.95))


def muted(rng: np.random.Generator) -> Rgb:
    """A muted colour, as on glazed crockery."""
    return hsv(rng.uniform(), rng.uniform(0.05, 0.5), rng.uniform(0.35, 0.95))


def metal(rng: np.random.Generator) -> Rgb:
    """The grey of a metal."""
    return hsv(rng.uniform(0.55, 0.65), rng.uniform(0, 0.06), rng.uniform(0.55, 0.85))


def one_of(rng: np.random.Generator, *colors: Rgb) -> Rgb:
    """One of some colours."""
    return colors[int(rng.integers(len(colors)))]


def polygon(points: ArrayLike) -> CrossSection:
    """A filled polygon (N, 2) of either orientation."""
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
    """The section of a body of revolution in a plane through its axis.

    Args:
        profile: (N, 2) radius and height from bottom to top, the outer side only.
    """
    p = np.asarray(profile, dtype=np.float64)
    return polygon(np.concatenate([p, (p * [-1, 1])[::-1]]))


def vessel(profile: ArrayLike, wall: float, *, base: float) -> CrossSection:
    """Section of a hollow body of revolution, open at its top.

    Args:
        profile: (N, 2) outer radius and height, bottom to top.
        wall: uniform thickness of the wall.
        base: thickness of the bottom at the axis.
    """
    from manifold3d import JoinType

    p = np.asarray(profile, dtype=np.float64)
    floor, top = p[:, 1].min() + base, p[:, 1].max()
    # The hollow is that of a body extended beyond the mouth along its last slope.
    slope = (p[-1] - p[-2]) / np.linalg.norm(p[-1] - p[-2])
    beyond = np.maximum(p[-1] + 4 * wall * slope, [0.1 * wall, 0])
    longer = outline_of_turn(np.concatenate([p, [beyond, beyond + np.array([0, 4 * wall])]]))
    reach = 2 * float(p[:, 0].max()) + 8 * wall
    room = longer.offset(-wall, JoinType.Round, 2.0, 32)
    room = room ^ rectangle((-reach, floor), (reach, top + wall))
    body = outline_of_turn(p) - rounded(room, min(0.3 * base, 0.3 * wall))
    return rounded(body, 0.35 * min(wall, base), 14)


def turned(section: CrossSection, sections: int = LATHE_SECTIONS) -> Manifold:
    """The body of revolution about y of a section of radius and height."""
    return section.revolve(sections).rotate([-90, 0, 0])


def lathe(
    profile: ArrayLike, sections: int = LATHE_SECTIONS, *, edge: float = 0.0, corner: int = 20
) -> Manifold:
    """The body of revolution about y of an outer profile (N, 2), its edges rounded by `edge`."""
    section = outline_of_turn(profile)
    return turned(rounded(section, edge, corner) if edge else section, sections)


def smooth_profile(keys: ArrayLike, samples: int = 40) -> Array:
    """(N, 2) radius and height through key points of increasing height, without overshoot."""
    from scipy.interpolate import PchipInterpolator

    r, y = np.asarray(keys, dtype=np.float64).T
    heights = np.unique(np.concatenate([np.linspace(y[0], y[-1], samples), y]))
    return np.stack([PchipInterpolator(y, r)(heights), heights], axis=1)


def along_x(section: CrossSection, width: float) -> Manifold:
    """A section of (z, y) extruded to `width`, centred at x = 0."""
    from manifold3d import Manifold

    solid = Manifold.extrude(section.mirror([1, 0]), width)
    return solid.translate([0, 0, -width / 2]).rotate([0, 90, 0])


def along_y(section: CrossSection, low: float, high: float) -> Manifold:
    """A section of (x, z) extruded between two heights."""
    from manifold3d import Manifold

    solid = Manifold.extrude(section.mirror([0, 1]), high - low)
    return solid.rotate([-90, 0, 0]).translate([0, low, 0])


def along_z(section: CrossSection, low: float, high: float) -> Manifold:
    """A section of (x, y) extruded between two z."""
    from manifold3d import Manifold

    return Manifold.extrude(section, high - low).translate([0, 0, low])


def box(low: Sequence[float], high: Sequence[float]) -> Manifold:
    """An axis-aligned box between two corners (3,)."""
    from manifold3d import Manifold

    size = (np.asarray(high, dtype=np.float64) - low).tolist()
    return Manifold.cube(size).translate(list(map(float, low)))


def rounded_box(size: Sequence[float], radius: float, segments: int = 20) -> Manifold:
    """A box of size (3,) centred at the origin with rounded edges."""
    from manifold3d import Manifold

    ball = Manifold.sphere(radius, segments)
    x, y, z = (s / 2 - radius for s in size)
    corners = [(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    return Manifold.batch_hull([ball.translate(c) for c in corners])


def ellipsoid(size: Sequence[float], segments: int = 32) -> Manifold:
    """An ellipsoid of size (3,) centred at the origin."""
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
    """The surface through rings (N, S, 3) of equally many points, both ends closed flat.

    Raises:
        ToolkitError: the rings do not form a closed solid.
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
    """A bar along a path (N, 3) in the x-y plane with an elliptic section.

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
    """A solid of a closed mesh; inverted faces are reversed.

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
