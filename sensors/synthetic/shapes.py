"""The objects of the quick recording: meshes, and random printed textures wrapped around them."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import PIL.Image
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.scene.model import Material

SECTIONS = 96

TURN = Symmetry(continuous=(((0.0, 1.0, 0.0), (0.0, 0.0, 0.0)),))

Image = NDArray[np.float32]

_WORDS = ("OATS", "SOUP", "250 g", "net", "fresh", "A4", "lab", "42", "cocoa", "R&D", "NEW", "mix")


@dataclass(frozen=True)
class Shape:
    """An object before it is placed on the table.

    Attributes:
        name: unique in the recording.
        category: such as "mug".
        material: raw, diffuse, transparent or specular.
        mesh: vertices in metres, bounding box centred at the origin, y up.
        symmetry: in the mesh frame.
        marks: number of shapes and words printed on it; 0 is plain paint.
    """

    name: str
    category: str
    material: Material
    mesh: trimesh.Trimesh
    symmetry: Symmetry
    marks: int = 200


def box(width: float, height: float, depth: float) -> trimesh.Trimesh:
    """A carton, finely divided so that vertex colours can carry its texture."""
    mesh = trimesh.creation.box((width, height, depth))
    for _ in range(5):
        mesh = mesh.subdivide()
    return mesh


def lathe(profile: list[tuple[float, float]]) -> trimesh.Trimesh:
    """Surface of revolution about y of a closed (radius, height) profile, bottom first."""
    line = finely(np.asarray(profile, dtype=np.float64), step=0.006)
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
    # An arc from the upper to the lower part of the wall, with its ends inside the wall.
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


# The objects of the default recording: four that a stereo sensor measures, two that it does not.
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


def finely(line: NDArray[np.float64], *, step: float) -> NDArray[np.float64]:
    """A polyline with more points, at most `step` apart."""
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


def label_texture(
    rng: np.random.Generator,
    *,
    width: int,
    height: int,
    base: tuple[float, float, float],
    marks: int,
    contrast: float = 1.0,
    mark_size: tuple[float, float] = (0.02, 0.1),
) -> Image:
    """(height, width, 3) float32 RGB in [0, 1]: a paper colour with shapes, words and noise.

    Args:
        base: background colour.
        marks: number of shapes and words.
        contrast: 1: marks of any colour, 0: of the background's.
        mark_size: extent of the marks as a fraction of the shorter side.
    """
    image = np.empty((height, width, 3), np.uint8)
    image[:] = np.rint(np.asarray(base) * 255)
    size = min(width, height)
    for _ in range(marks):
        ink = rng.uniform(0.05, 0.95, 3)
        # Most textures are near grey; with saturated colours everywhere no object would stand out.
        ink = ink.mean() + 0.45 * (ink - ink.mean())
        colour = tuple(int(255 * x) for x in np.asarray(base) + contrast * (ink - base))
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        extent = size * float(rng.uniform(*mark_size))
        kind = rng.integers(4)
        if kind == 0:
            cv2.circle(image, (x, y), int(extent), colour, -1, cv2.LINE_AA)
        elif kind == 1:
            w, h = extent * rng.uniform(0.4, 2, 2)
            corners = cv2.boxPoints(((x, y), (w, h), float(rng.uniform(0, 180))))
            cv2.fillConvexPoly(image, corners.astype(np.int32), colour, cv2.LINE_AA)
        elif kind == 2:
            end = (x + int(rng.uniform(-2, 2) * extent), y + int(rng.uniform(-2, 2) * extent))
            thick = max(1, int(extent * 0.15))
            cv2.line(image, (x, y), end, colour, thick, cv2.LINE_AA)
        else:
            word = _WORDS[rng.integers(len(_WORDS))]
            scale = max(0.3, extent / 22)
            cv2.putText(
                image, word, (x, y), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA
            )
    grain = sum(
        cv2.resize(
            rng.normal(0, 0.045, (height // step + 1, width // step + 1)).astype(np.float32),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for step in (2, 5, 14, 60)
    )
    textured = image.astype(np.float32) / 255 + np.asarray(grain, dtype=np.float32)[..., None]
    return np.clip(textured, 0.02, 0.98)


def sample(texture: Image, u: NDArray[np.floating], v: NDArray[np.floating]) -> Image:
    """(N, 3) colours at texture coordinates u, v (N,) in [0, 1], bilinear, wrapped around."""
    height, width = texture.shape[:2]
    x = (np.mod(u, 1) * width).astype(np.float32)
    y = (np.mod(v, 1) * height).astype(np.float32)
    # OpenCV's remap accepts at most 32767 columns: fold the list into rows.
    count = len(x)
    columns = 4096
    rows = -(-count // columns)
    grid = np.zeros((2, rows * columns), np.float32)
    grid[0, :count], grid[1, :count] = x, y
    map_x, map_y = grid.reshape(2, rows, columns)
    out = cv2.remap(texture, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(out, dtype=np.float32).reshape(-1, 3)[:count]


def wrap(
    points: NDArray[np.floating], normals: NDArray[np.floating], extents: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Texture coordinates of surface points (N, 3) of a centred object: one texture per side.

    Each of the six main directions of normals gets its own tile of the texture.
    """
    axis = np.argmax(np.abs(normals), axis=1)
    other = np.array([[2, 1], [0, 2], [0, 1]])[axis]
    rows = np.arange(len(points))
    side = 2 * axis + (normals[rows, axis] > 0)
    a = points[rows, other[:, 0]] / extents.max() + 0.5
    b = points[rows, other[:, 1]] / extents.max() + 0.5
    return (a + side % 3) / 3, (1 - b + side // 3) / 2


def textured_mesh(mesh: trimesh.Trimesh, texture: Image) -> trimesh.Trimesh:
    """The mesh with a texture wrapped around it, as a scan of the object would have it.

    Args:
        mesh: centred, vertices in metres.
        texture: (h, w, 3) linear RGB, as of `label_texture`.
    """
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    normals = np.repeat(mesh.face_normals, 3, axis=0)
    u, v = wrap(corners, normals, mesh.extents)
    height, width = texture.shape[:2]
    # `sample` has texels at integers, images have them half a texel further.
    uv = np.stack([u + 0.5 / width, 1 - (v + 0.5 / height)], axis=1)
    encoded = np.clip(texture, 0, 1) ** (1 / 2.2)
    picture = PIL.Image.fromarray(np.rint(255 * encoded).astype(np.uint8))
    faces = np.arange(len(corners)).reshape(-1, 3)
    visual = trimesh.visual.TextureVisuals(uv=uv, image=picture)
    return trimesh.Trimesh(corners, faces, visual=visual, process=False)
