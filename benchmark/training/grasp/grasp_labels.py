"""Grasp labels on a grid, of objects and of scenes.

The labels of a scene are those of its objects whose gripper collides with nothing else. A label has
a tolerance: the distance by which the grasp may miss its point and still hold.
"""

import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.methods.grasp.graspnet.cloud import gripper_rotations
from benchmark.metrics.grasp import collision, force_closure, grasp
from benchmark.metrics.grasp.gripper import Gripper, get_gripper
from benchmark.training.grasp.pack_files import GraspPackSetup
from benchmark.training.grasp.tabletop import TableObject
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.foreign_files import read_npz

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

# Grasps that are tested at once.
_AT_ONCE = 200_000

# Metres between the points that stand for the surfaces of other objects, and by which grippers
# grow so that nothing passes between them.
_SPACING = 0.006


def tolerances(
    points: NDArray[np.floating], good: NDArray[np.bool_], most: float
) -> NDArray[np.float32]:
    """(P, ...) metres to the nearest point where the same grasp is not good.

    As published: the farthest distance around the point at which the grasp, shifted there, is
    still robust; it is known at the points alone.

    Args:
        points: (P, 3) metres.
        good: (P, ...) whether a grasp at the point is; the other axes are views, turns, depths.
        most: metres, of those that no point within limits.

    Returns:
        0 where a grasp is not good itself.
    """
    from scipy.spatial import cKDTree

    flat = good.reshape(len(points), -1)
    found = np.zeros(flat.shape, np.float32)
    tree = cKDTree(points)
    for k, near in enumerate(tree.query_ball_point(points, most)):
        # A column that is not good here needs no neighbours.
        columns = np.flatnonzero(flat[k])
        if not len(columns):
            continue
        own = np.asarray(near)
        apart = np.linalg.norm(points[own] - points[k], axis=1)
        order = np.argsort(apart, kind="stable")
        bad = ~flat[own[order]][:, columns]
        first = bad.argmax(axis=0)
        missing = ~bad[first, np.arange(len(columns))]
        found[k, columns] = np.where(missing, most, apart[order][first])
    return found.reshape(good.shape)


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

    def grasps(self, rows: NDArray[np.integer], flat: NDArray[np.integer]) -> grasp.Grasps:
        """Some of the grasps of some points.

        Args:
            rows: (r,) numbers of points.
            flat: numbers of grasps within (r, v, a, d).
        """
        shape = (len(rows), *self.friction.shape[1:])
        row, view, turn, depth = np.unravel_index(flat, shape)
        rotations = gripper_rotations(shape[1], shape[2])[view, turn]
        widths = self.widths[rows[row], view, turn, depth] * UNIT
        return grasp.Grasps.make(
            rotations,
            self.points[rows[row]],
            widths=widths,
            depths=np.asarray(self.depths)[depth],
        )


def kept_labels(folder: Path, obj: TableObject, setup: GraspPackSetup) -> ObjectLabels:
    """The labels of an object, made once and kept in a folder."""
    digest = hashlib.sha256(f"{_EDITION} {setup.gripper} {setup.spacing} ".encode())
    digest.update(f"{setup.views} {setup.angles} {setup.depths}".encode())
    digest.update(np.asarray(obj.vertices, "<f8").tobytes())
    digest.update(np.asarray(obj.faces, "<i8").tobytes())
    path = folder / f"{obj.name}-{digest.hexdigest()[:16]}.npz"
    names = ("points", "friction", "widths", "tolerances")
    try:
        kept = read_npz(path)
        points, friction, widths, tolerance = (kept[name] for name in names)
        return ObjectLabels(points, friction, widths, tolerance, setup.depths)
    except (ToolkitError, KeyError):
        pass  # missing or damaged: computed again
    made = object_labels(
        obj.vertices,
        obj.faces,
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
    from benchmark.metrics.grasp.points_in_boxes import PointGrid

    mesh = force_closure.GraspedMesh(vertices, faces)
    points = force_closure.even_points(vertices, faces, spacing)
    surface = PointGrid(force_closure.even_points(vertices, faces, _SURFACE))
    rotations = gripper_rotations(views, angles)
    grid = (len(points), views, angles, len(depths))
    friction, widths = np.zeros(grid, np.uint8), np.zeros(grid, np.uint8)
    count = views * angles * len(depths)
    for number, point in enumerate(points):
        x, y = (np.repeat(rotations[..., k].reshape(-1, 3), len(depths), 0) for k in range(2))
        reach = np.tile(depths, views * angles)
        tips = point + reach[:, None] * x
        contacts = mesh.contacts_of(tips, y, np.full(count, gripper.max_width))
        scores = force_closure.friction_scores(contacts)
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
        free = ~surface.count(R, places, boxes, first_only=True).any(axis=1)
        kept = good[free]
        friction[number].reshape(-1)[kept] = 1 + np.rint(
            (scores[kept] - force_closure.FRICTIONS[0])
            / (force_closure.FRICTIONS[1] - force_closure.FRICTIONS[0])
        )
        widths[number].reshape(-1)[kept] = code[free]
    robust = (friction > 0) & (friction < round(_ROBUST / force_closure.FRICTIONS[0]))
    found = tolerances(points, robust, MOST_TOLERANCE)
    return ObjectLabels(points, friction, widths, np.rint(found / UNIT).astype(np.uint8), depths)


@dataclass(frozen=True, eq=False)
class SceneLabels:
    """Rows of grasps, a row for each point of an object that some view of the scene sees.

    Attributes:
        object: (R,) number of the object.
        point: (R,) number of the point of its labels.
        friction: (R, v, a, d) uint8: 1 for a friction of 0.2, 2 for 0.4, ...; 0 for no grasp, or
            one that hits something.
        widths, tolerances: (R, v, a, d) uint8 half millimetres.
    """

    object: NDArray[np.uint8]
    point: NDArray[np.int32]
    friction: NDArray[np.uint8]
    widths: NDArray[np.uint8]
    tolerances: NDArray[np.uint8]


def scene_labels(
    objects: Sequence[TableObject],
    labels: Sequence[ObjectLabels],
    visible: Sequence[NDArray[np.integer]],
    gripper: Gripper,
) -> SceneLabels:
    """Labels of the points that are seen.

    Args:
        objects: of the scene; the table is z = 0.
        labels: of each object.
        visible: numbers of each object's points that are, in rising order.
        gripper: what must not hit the table and the other objects.
    """
    surfaces = [
        o.T_world_obj @ force_closure.even_points(o.vertices, o.faces, _SPACING) for o in objects
    ]
    numbers, points, friction, widths, tolerances = [], [], [], [], []
    for number, (obj, own, rows) in enumerate(zip(objects, labels, visible, strict=True)):
        if not len(rows):
            continue
        around = [s for other, s in enumerate(surfaces) if other != number]
        others = np.concatenate(around) if around else np.zeros((0, 3))
        codes = own.friction[rows].copy()
        codes[_hits(obj, own, rows, gripper, others)] = 0
        numbers.append(np.full(len(rows), number, np.uint8))
        points.append(np.asarray(rows, np.int32))
        friction.append(codes)
        widths.append(own.widths[rows])
        tolerances.append(own.tolerances[rows])
    if not numbers:
        grid = labels[0].friction.shape[1:] if labels else (0, 0, 0)
        none = np.zeros((0, *grid), np.uint8)
        return SceneLabels(np.zeros(0, np.uint8), np.zeros(0, np.int32), none, none, none)
    return SceneLabels(
        *(np.concatenate(p) for p in (numbers, points, friction, widths, tolerances))
    )


def _hits(
    obj: TableObject,
    labels: ObjectLabels,
    rows: NDArray[np.integer],
    gripper: Gripper,
    others: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(r, v, a, d) grasps of the rows that hit the table or other objects."""
    around = collision.Cloud(others)
    codes = labels.friction[rows]
    hit = np.zeros(codes.shape, bool)
    good = np.flatnonzero(codes)
    for begin in range(0, len(good), _AT_ONCE):
        part = good[begin : begin + _AT_ONCE]
        grasps = labels.grasps(rows, part).transformed(obj.T_world_obj)
        wrong = collision.hits_plane(grasps, gripper, SE3.identity())
        free = np.flatnonzero(~wrong)
        boxes = gripper.boxes(grasps.widths[free], grasps.depths[free])
        wrong[free] = around.any_inside(grasps[free], boxes, margin=_SPACING / 2)
        hit.reshape(-1)[part] = wrong
    return hit
