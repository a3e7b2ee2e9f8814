"""Closed surfaces in metres, y up, from which the kinds of objects are made.

Every surface is watertight. Parts that are joined overlap without being merged: each of them is
closed, and cameras see the outermost.
"""

from collections.abc import Sequence

import numpy as np
import trimesh

from sensors.synthetic.shapes import finely
from std_toolkit.arrays import Array
from std_toolkit.geometry import so3_exp

SECTIONS = 72
# Edges of flat faces: interpolated normals round a corner over this length, as a carton has it.
FLAT_EDGE_M = 0.006
PROFILE_STEP_M = 0.005


def circle(sections: int = SECTIONS) -> Array:
    """(N, 2) directions of a round section."""
    turn = 2 * np.pi * np.arange(sections) / sections
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def rounded_rectangle(aspect: float, power: float = 6.0, sections: int = SECTIONS) -> Array:
    """(N, 2) superellipse: half width 1 along x, `aspect` along z.

    Args:
        aspect: depth divided by width.
        power: 2 is an ellipse; larger ones have sharper corners.
        sections: number of points.
    """
    # This parametrisation is dense at the corners and coarse where the section is straight.
    unit = circle(sections)
    return np.sign(unit) * np.abs(unit) ** (2 / power) * np.array([1.0, aspect])


def turned(profile: Sequence[tuple[float, float]], section: Array | None = None) -> trimesh.Trimesh:
    """A section swept up a closed profile that begins and ends on the axis.

    Args:
        profile: (radius, height), the outside first, from the bottom.
        section: (N, 2) as of `circle`, the default, or `rounded_rectangle`.
    """
    section = circle() if section is None else section
    line = finely(np.asarray(profile, dtype=np.float64), step=PROFILE_STEP_M)
    line = line[line[:, 0] > 1e-9]
    rings = np.empty((len(line), len(section), 3))
    rings[..., 0] = line[:, :1] * section[:, 0]
    rings[..., 1] = line[:, 1:]
    rings[..., 2] = line[:, :1] * section[:, 1]
    ends = [0, profile[0][1], 0], [0, profile[-1][1], 0]
    return loft(rings, *np.asarray(ends, dtype=np.float64))


def tube(path: Array, radii: Array, *, flatness: float = 1.0, sides: int = 24) -> trimesh.Trimesh:
    """A solid of round section along a path (N, 3) in the x-y plane, with flat ends.

    Args:
        path: centre line.
        radii: (N,) half widths in the plane of the path.
        flatness: half width across the plane divided by the one in it.
        sides: of the section.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    c, s = circle(sides).T
    across = flatness * s[None, :, None] * np.array([0.0, 0.0, 1.0])
    rings = path[:, None] + radii[:, None, None] * (c[None, :, None] * side[:, None] + across)
    return loft(rings, path[0], path[-1])


def prism(polygon: Sequence[tuple[float, float]], height: float) -> trimesh.Trimesh:
    """A prism with a polygon (x, z) as its base; the polygon is star-shaped about its first corner.

    Faces are finely divided.
    """
    corners = np.asarray(polygon, dtype=np.float64)
    if _area(corners) < 0:
        corners = np.concatenate([corners[:1], corners[:0:-1]])
    n = len(corners)
    base = np.stack([corners[:, 0], np.full(n, -height / 2), corners[:, 1]], axis=1)
    vertices = np.concatenate([base, base + np.array([0, height, 0])])
    k = np.arange(n)
    after = (k + 1) % n
    walls = [np.stack([k, k + n, after], 1), np.stack([after, k + n, after + n], 1)]
    fan = np.stack([np.zeros(n - 2, int), k[1:-1], k[2:]], axis=1)
    faces = np.concatenate([*walls, fan, fan[:, ::-1] + n])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    longest = float(mesh.edges_unique_length.max())
    for _ in range(min(6, int(np.ceil(np.log2(longest / FLAT_EDGE_M))))):
        mesh = mesh.subdivide()
    return mesh


def cuboid(width: float, height: float, depth: float) -> trimesh.Trimesh:
    """A finely divided box."""
    w, d = width / 2, depth / 2
    return prism([(-w, -d), (w, -d), (w, d), (-w, d)], height)


def shell(radius: float, height: float, foot: float, wall: float = 0.003) -> trimesh.Trimesh:
    """A thin open bowl that curves up from a flat foot of `foot` times the radius."""
    a = np.linspace(0, np.pi / 2, 10)
    outer = [(radius * (foot + (1 - foot) * np.sin(t)), height * (1 - np.cos(t))) for t in a]
    inner = [(x - wall, max(y, wall) if y < height else height) for x, y in reversed(outer)]
    return turned([(0, 0), *outer, *inner, (0, wall)])


def handle(x: float, y: float, out: float, up: float, thick: float) -> trimesh.Trimesh:
    """Half a ring whose ends are inside of a wall at (x, y +- up), metres."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 25)
    path = np.stack([x + out * np.cos(angles), y + up * np.sin(angles), 0 * angles], axis=1)
    return tube(path, np.full(25, thick), flatness=1.3)


def shoulder(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[float, float]]:
    """The smooth part of a profile between two straight ones."""
    s = np.linspace(0, 1, 9)
    x = start[0] + (end[0] - start[0]) * 0.5 * (1 - np.cos(np.pi * s))
    y = start[1] + (end[1] - start[1]) * s
    return [(float(a), float(b)) for a, b in zip(x, y, strict=True)]


def upright(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The x-z plane becomes the x-y plane: a prism stands on a side of its polygon."""
    return about_x(mesh, -np.pi / 2)


def about_x(mesh: trimesh.Trimesh, angle: float) -> trimesh.Trimesh:
    """The mesh rotated about the x axis, radians."""
    vertices = mesh.vertices @ so3_exp([angle, 0.0, 0.0]).T
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def loft(rings: Array, first: Array, last: Array) -> trimesh.Trimesh:
    """A closed surface through rings (R, N, 3), with an apex beyond the first and the last."""
    count, n = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), first[None], last[None]])
    i, j = np.meshgrid(np.arange(count - 1), np.arange(n), indexing="ij")
    a, b = i * n + j, i * n + (j + 1) % n
    c, d = a + n, b + n
    k = np.arange(n)
    after = (k + 1) % n
    top = (count - 1) * n
    faces = np.concatenate(
        [
            np.stack([a, c, b], -1).reshape(-1, 3),
            np.stack([b, c, d], -1).reshape(-1, 3),
            np.stack([np.full(n, count * n), k, after], axis=1),
            np.stack([np.full(n, count * n + 1), top + after, top + k], axis=1),
        ]
    )
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def moved(mesh: trimesh.Trimesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    """The mesh moved, metres."""
    return trimesh.Trimesh(mesh.vertices + np.array([x, y, z]), mesh.faces, process=False)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """Overlapping parts as one mesh."""
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    return trimesh.Trimesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)]),
        process=False,
    )


def of_size(mesh: trimesh.Trimesh, largest: float) -> trimesh.Trimesh:
    """The mesh centred at the origin and scaled so that its largest extent is `largest` metres."""
    low, high = mesh.bounds
    scaled = (mesh.vertices - (low + high) / 2) * (largest / (high - low).max())
    return trimesh.Trimesh(scaled, mesh.faces, process=False)


def deformed(mesh: trimesh.Trimesh, scale: Array, bulge: float = 0.0) -> trimesh.Trimesh:
    """The mesh with another size along each axis, and wider at half height.

    The centre of the bounding box stays at the origin.

    Args:
        mesh: centred.
        scale: (3,) factors.
        bulge: added to the factor across the y axis at half height, falling to 0 at both ends.
    """
    points = mesh.vertices * scale
    height = np.abs(mesh.vertices[:, 1]) / (mesh.extents[1] / 2)
    points[:, [0, 2]] *= (1 + bulge * (1 - height**2))[:, None]
    result = trimesh.Trimesh(points, mesh.faces, process=False)
    result.apply_translation(-result.bounds.mean(axis=0))
    return result


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
