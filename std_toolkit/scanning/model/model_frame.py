"""Frame of a scanned model: upright, turned by a rule of its category, centred; its symmetry.

z is up, as the board says, and the origin is the centre of the bounding box, as NOCS has it. The
handle of a mug is on the side of +x. Other objects turn so that the smallest upright box around
them is along the axes, its longer side along x.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3
from std_toolkit.geometry.symmetry import symmetry_words
from std_toolkit.geometry.symmetry_search import DetectedSymmetry
from std_toolkit.io.documents import write_document
from std_toolkit.scanning.model.bake import Texture
from std_toolkit.settings import NOT_RECORDED, Settings, limit

SYMMETRY_FILE = "symmetry.json"

# Heights, in parts of the whole, between which a handle joins the body.
_BODY = (0.2, 0.8)


@dataclass(frozen=True, kw_only=True)
class HandleSettings(Settings):
    """When a vessel has a handle."""

    handle: float = limit(1.15, source=NOT_RECORDED)
    """the handle is what is farther from the axis than this many radii of the body"""
    smallest_handle: float = limit(0.02, source=NOT_RECORDED)
    """smallest share of the surface of a handle"""


def model_frame(vertices: Array, faces: NDArray[np.int64], category: str = "other") -> SE3:
    """T_model_world of an object that stands upright in the world.

    Args:
        vertices: (V, 3) world, z up, metres.
        faces: (F, 3).
        category: category, such as "mug".
    """
    angle = None
    if category == "mug":
        angle = _handle_angle(vertices, faces)
    if angle is None:
        angle = _box_angle(vertices)
    c, s = np.cos(-angle), np.sin(-angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = vertices @ turn.T
    return SE3(turn, -(turned.min(axis=0) + turned.max(axis=0)) / 2)


def _box_angle(vertices: Array) -> float:
    """Angle of the longer side of the smallest rectangle around the vertices from above."""
    points = (1000 * (vertices[:, :2] - vertices[:, :2].mean(axis=0))).astype(np.float32)
    corners = cv2.boxPoints(cv2.minAreaRect(points))
    sides = np.diff(corners[:3], axis=0)
    long = sides[np.argmax(np.linalg.norm(sides, axis=1))]
    angle = float(np.arctan2(long[1], long[0]))
    # The smallest turn of those that fit: opposite directions are the same side.
    return (angle + np.pi / 2) % np.pi - np.pi / 2


def _handle_angle(vertices: Array, faces: NDArray[np.int64]) -> float | None:
    """Direction of what stands out from a round body; None if nothing does."""
    limits = HandleSettings.current()
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points = np.asarray(trimesh.sample.sample_surface(mesh, 20_000, seed=0)[0])
    low, high = points[:, 2].min(), points[:, 2].max()
    share = (points[:, 2] - low) / (high - low)
    xy = points[(share > _BODY[0]) & (share < _BODY[1]), :2]
    centre = np.median(xy, axis=0)
    radius = 0.0
    body = np.ones(len(xy), bool)
    for _ in range(20):
        x, y = xy[body].T
        # (x - a)^2 + (y - b)^2 = r^2 is linear in a, b and r^2 - a^2 - b^2.
        solved = np.linalg.lstsq(
            np.stack([2 * x, 2 * y, np.ones(len(x))], axis=1), x**2 + y**2, rcond=None
        )[0]
        centre = solved[:2]
        radius = float(np.sqrt(max(solved[2] + (centre**2).sum(), 1e-12)))
        off = np.linalg.norm(xy - centre, axis=1) - radius
        body = np.abs(off) <= np.percentile(np.abs(off), 80)
    away = xy - centre
    out = np.linalg.norm(away, axis=1) > limits.handle * radius
    if out.mean() < limits.smallest_handle:
        return None
    middle = away[out].mean(axis=0)
    if np.linalg.norm(middle) < 0.5 * radius:
        return None
    return float(np.arctan2(middle[1], middle[0]))


def find_symmetry(
    vertices: Array, faces: NDArray[np.int64], texture: Texture
) -> tuple[DetectedSymmetry, dict[str, str]]:
    """Symmetries of the model, and what the report says of them."""
    import trimesh

    from std_toolkit.geometry.symmetry_search import detect_symmetry
    from std_toolkit.scanning.model.bake import vertex_colors

    mesh = trimesh.Trimesh(
        vertices, faces, vertex_colors=vertex_colors(len(vertices), faces, texture),
        process=False,
    )  # fmt: skip
    found = detect_symmetry(mesh)
    words = {
        "symmetry of the shape": symmetry_words(found.shape),
        "symmetry with colours": symmetry_words(found.appearance),
    }
    return found, words


def write_symmetry(folder: Path, found: DetectedSymmetry) -> None:
    """Write `symmetry.json`: that of shape and colours, as objects.json has it."""
    from std_toolkit.labels.entry.symmetry_argument import symmetry_model

    write_document(folder / SYMMETRY_FILE, symmetry_model(found.appearance))
