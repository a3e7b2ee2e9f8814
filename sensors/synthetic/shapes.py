"""Table-top objects as watertight-looking surfaces: metres, centred, y up (the NOCS convention)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.scene.model import Material

SECTIONS = 96
TURN = Symmetry(continuous=(((0.0, 1.0, 0.0), (0.0, 0.0, 0.0)),))


@dataclass(frozen=True)
class Shape:
    """An object as it is put on the table.

    Attributes:
        name: unique in the recording.
        category: such as "mug".
        material: raw, diffuse, transparent or specular.
        mesh: vertices in metres, bounding box centred at the origin, y up.
        symmetry: in the mesh frame.
    """

    name: str
    category: str
    material: Material
    mesh: trimesh.Trimesh
    symmetry: Symmetry


def box(width: float, height: float, depth: float) -> trimesh.Trimesh:
    """A carton, finely divided so that vertex colours can carry its print."""
    mesh = trimesh.creation.box((width, height, depth))
    for _ in range(5):
        mesh = mesh.subdivide()
    return mesh


def lathe(profile: list[tuple[float, float]]) -> trimesh.Trimesh:
    """Surface of revolution about y of a closed (radius, height) profile, bottom first."""
    line = _finely(np.asarray(profile, dtype=np.float64), step=0.006)
    mesh = trimesh.creation.revolve(line, sections=SECTIONS)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    return _centred(mesh)


def can(radius: float, height: float) -> trimesh.Trimesh:
    r, h = radius, height
    return lathe([(0, 0), (r - 0.002, 0), (r, 0.002), (r, h - 0.002), (r - 0.002, h), (0, h)])


def bottle(radius: float, height: float) -> trimesh.Trimesh:
    r, h = radius, height
    neck = 0.42 * r
    shoulder = [
        (neck + (r - neck) * 0.5 * (1 + np.cos(a)), h * (0.58 + 0.2 * a / np.pi))
        for a in np.linspace(0, np.pi, 9)
    ]
    return lathe([(0, 0), (0.93 * r, 0), (r, 0.02 * h), *shoulder, (neck, h), (0, h)])


def bowl(radius: float, height: float, wall: float = 0.003) -> trimesh.Trimesh:
    angles = np.linspace(0.35, np.pi / 2, 10)
    outer = [(radius * np.sin(a), height * (1 - np.cos(a)) / 1.0) for a in angles]
    foot = outer[0][1]
    outer = [(r, (y - foot) * height / (outer[-1][1] - foot)) for r, y in outer]
    inner = [(max(r - wall, 0.0), y + wall * (1 - y / height)) for r, y in reversed(outer)]
    return lathe([(0, 0), *outer, *inner, (0, wall)])


def tumbler(radius: float, height: float, wall: float = 0.003) -> trimesh.Trimesh:
    foot, base = 0.75 * radius, 0.012
    return lathe(
        [
            (0, 0),
            (foot, 0),
            (radius, height),
            (radius - wall, height),
            (foot - wall, base),
            (0, base),
        ]
    )


def mug(radius: float, height: float, wall: float = 0.004) -> trimesh.Trimesh:
    r, h = radius, height
    cup = lathe([(0, 0), (r, 0), (r, h), (r - wall, h), (r - wall, wall), (0, wall)])
    # An arc from the upper to the lower part of the wall, its ends buried in the wall.
    angles = np.linspace(-1.25, 1.25, 25)
    arc = np.stack(
        [
            r - 0.2 * r + 0.9 * r * np.cos(angles),
            0.34 * h * np.sin(angles) / np.sin(1.25),
            np.zeros(25),
        ],
        axis=1,
    )
    arc[[0, -1], 0] = r - 0.5 * wall
    handle = _tube(arc, 0.1 * r + 0.001)
    vertices = np.concatenate([cup.vertices, handle.vertices])
    faces = np.concatenate([cup.faces, handle.faces + len(cup.vertices)])
    return _centred(trimesh.Trimesh(vertices, faces, process=False))


# The objects of the default recording: four that a stereo sensor sees, two that it does not.
DEFAULT_SHAPES: tuple[tuple[str, str, Material, Callable[[], trimesh.Trimesh], Symmetry], ...] = (
    ("cereal_box", "other", "diffuse", lambda: box(0.11, 0.16, 0.05), Symmetry()),
    ("soup_can", "can", "diffuse", lambda: can(0.034, 0.102), TURN),
    ("mug", "mug", "diffuse", lambda: mug(0.042, 0.095), Symmetry()),
    ("bottle", "bottle", "diffuse", lambda: bottle(0.035, 0.19), TURN),
    ("glass", "other", "transparent", lambda: tumbler(0.042, 0.115), TURN),
    ("steel_bowl", "bowl", "specular", lambda: bowl(0.068, 0.055), TURN),
)


def default_shapes() -> list[Shape]:
    """The six objects of the default recording."""
    return [Shape(n, c, m, make(), s) for n, c, m, make, s in DEFAULT_SHAPES]


def _finely(line: NDArray[np.float64], *, step: float) -> NDArray[np.float64]:
    points = [line[:1]]
    for a, b in pairwise(line):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        points.append(a + (b - a) * np.arange(1, count + 1)[:, None] / count)
    return np.concatenate(points)


def _centred(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return mesh


def _tube(path: NDArray[np.float64], radius: float) -> trimesh.Trimesh:
    """Tube of a circular section along a path (N, 3) in the x-y plane, both ends open."""
    sides = 20
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    turn = 2 * np.pi * np.arange(sides) / sides
    rings = (
        path[:, None]
        + radius * np.cos(turn)[None, :, None] * side[:, None]
        + radius * np.sin(turn)[None, :, None] * np.array([0.0, 0.0, 1.0])
    )
    i, j = np.meshgrid(np.arange(len(path) - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = a + sides, b + sides
    faces = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
    )
    return trimesh.Trimesh(rings.reshape(-1, 3), faces, process=False)
