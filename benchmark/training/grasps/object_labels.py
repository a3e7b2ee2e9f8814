"""All grasps of an object on a grid: which hold, how wide they open and how far they may miss."""

from __future__ import annotations

import hashlib
import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.grasp_methods.graspnet.views import gripper_rotations
from benchmark.grasping.force_closure import FRICTIONS, GraspedMesh, friction_scores
from benchmark.grasping.grasp import Grasps
from benchmark.grasping.gripper import Gripper, get_gripper
from benchmark.grasping.surface import even_points
from benchmark.training.grasps.pack_files import GraspPackSetup
from benchmark.training.grasps.tabletop import TableObject
from benchmark.training.grasps.tolerance import tolerances
from std_toolkit.io.atomic import write_bytes_atomic

# Widths and tolerances are kept in half millimetres: a byte reaches 12.7 cm.
UNIT = 0.0005
# Between the opened fingers and what they close on, both sides together, metres.
CLEARANCE = 0.01
# A grasp is robust, as published, with a score 1.1 - friction above 0.5.
_ROBUST = 0.6
MOST_TOLERANCE = 0.05
# Metres between the points that stand for the surface where a gripper must not be.
_SURFACE = 0.004
_EDITION = 1


@dataclass(frozen=True, eq=False)
class ObjectLabels:
    """Grasps of P points, v views, a turns about them and d depths, in the object's frame.

    Attributes:
        points: (P, 3) metres, on the surface.
        friction: (P, v, a, d) uint8: 1 for a grasp that holds with a friction of 0.2, 2 for 0.4,
            ...; 0 for none, or one whose gripper touches the object before it closes.
        widths: (P, v, a, d) uint8 half millimetres of the opened jaw.
        tolerances: (P, v, a, d) uint8 half millimetres.
        depths: (d,) metres.
    """

    points: NDArray[np.float64]
    friction: NDArray[np.uint8]
    widths: NDArray[np.uint8]
    tolerances: NDArray[np.uint8]
    depths: tuple[float, ...]

    def grasps(self, rows: NDArray[np.integer], flat: NDArray[np.integer]) -> Grasps:
        """Some of the grasps of some points.

        Args:
            rows: (r,) numbers of points.
            flat: numbers of grasps within (r, v, a, d).
        """
        shape = (len(rows), *self.friction.shape[1:])
        row, view, turn, depth = np.unravel_index(flat, shape)
        rotations = gripper_rotations(shape[1], shape[2])[view, turn]
        widths = self.widths[rows[row], view, turn, depth] * UNIT
        return Grasps.make(
            rotations,
            self.points[rows[row]],
            widths=widths,
            depths=np.asarray(self.depths)[depth],
        )


def kept_labels(folder: Path, thing: TableObject, setup: GraspPackSetup) -> ObjectLabels:
    """The labels of an object, made once and kept in a folder."""
    digest = hashlib.sha256(f"{_EDITION} {setup.gripper} {setup.spacing} ".encode())
    digest.update(f"{setup.views} {setup.angles} {setup.depths}".encode())
    digest.update(np.asarray(thing.vertices, "<f8").tobytes())
    digest.update(np.asarray(thing.faces, "<i8").tobytes())
    path = folder / f"{thing.name}-{digest.hexdigest()[:16]}.npz"
    names = ("points", "friction", "widths", "tolerances")
    try:
        with np.load(path, allow_pickle=False) as kept:
            points, friction, widths, tolerance = (kept[name] for name in names)
            return ObjectLabels(points, friction, widths, tolerance, setup.depths)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass  # not there, or damaged: made anew
    made = object_labels(
        thing.vertices,
        thing.faces,
        get_gripper(setup.gripper),
        spacing=setup.spacing,
        views=setup.views,
        angles=setup.angles,
        depths=setup.depths,
    )
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{name: getattr(made, name) for name in names})
    folder.mkdir(parents=True, exist_ok=True)
    write_bytes_atomic(path, buffer.getvalue())
    return made


def object_labels(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    gripper: Gripper,
    *,
    spacing: float = 0.008,
    views: int = 300,
    angles: int = 12,
    depths: tuple[float, ...] = (0.01, 0.02, 0.03, 0.04),
) -> ObjectLabels:
    """Try all grasps of an object.

    Args:
        vertices, faces: of its mesh, metres.
        gripper: its opening and sizes.
        spacing: metres between points.
        views, angles, depths: of the grasps of a point.
    """
    from benchmark.training.grasps.hits import any_inside

    mesh = GraspedMesh(vertices, faces)
    points = even_points(vertices, faces, spacing)
    surface = even_points(vertices, faces, _SURFACE)
    rotations = gripper_rotations(views, angles)
    grid = (len(points), views, angles, len(depths))
    friction, widths = np.zeros(grid, np.uint8), np.zeros(grid, np.uint8)
    count = views * angles * len(depths)
    for number, point in enumerate(points):
        x, y = (np.repeat(rotations[..., k].reshape(-1, 3), len(depths), 0) for k in range(2))
        reach = np.tile(depths, views * angles)
        tips = point + reach[:, None] * x
        contacts = mesh.contacts_of(tips, y, np.full(count, gripper.max_width))
        scores = friction_scores(contacts)
        good = np.flatnonzero(scores > 0)
        if not len(good):
            continue
        off = np.abs(np.einsum("nki,ni->nk", contacts.points[good] - tips[good, None], y[good]))
        opening = np.minimum(2 * off.max(axis=1) + CLEARANCE, gripper.max_width)
        # Rounded to what is kept before the gripper is tried with it.
        code = np.minimum(np.floor(opening / UNIT + 1e-6), 255).astype(np.uint8)
        R = rotations.reshape(-1, 3, 3)[good // len(depths)]
        boxes = gripper.boxes(code * UNIT, reach[good])
        places = np.broadcast_to(point, (len(good), 3))
        free = ~any_inside(surface, R, places, boxes, margin=0.0)
        kept = good[free]
        friction[number].reshape(-1)[kept] = 1 + np.rint(
            (scores[kept] - FRICTIONS[0]) / (FRICTIONS[1] - FRICTIONS[0])
        )
        widths[number].reshape(-1)[kept] = code[free]
    robust = (friction > 0) & (friction < round(_ROBUST / FRICTIONS[0]))
    found = tolerances(points, robust, MOST_TOLERANCE)
    return ObjectLabels(points, friction, widths, np.rint(found / UNIT).astype(np.uint8), depths)
