"""Collisions of a gripper with points, voxels, planes and meshes, for all grasps at once.

Boxes and triangles are tested with separating axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.gripper import Boxes, Gripper
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.se3 import SE3

if TYPE_CHECKING:
    from benchmark.metrics.grasp.points_in_boxes import PointGrid

Floats = NDArray[np.float64]


def boxes_meet_triangles(low: Floats, high: Floats, triangles: Floats) -> NDArray[np.bool_]:
    """Whether axis-aligned boxes and triangles have a point in common.

    Two convex bodies are apart exactly if their shadows are on one of these axes: the box's, the
    triangle's normal, and the products of an edge of the one and an edge of the other.

    Args:
        low, high: (B, 3) corners of the boxes.
        triangles: (F, 3, 3) corners in the frame of the boxes.

    Returns:
        (B, F). Touching counts.

    >>> unit = np.zeros((1, 3)), np.ones((1, 3))
    >>> corner = np.array([[[2, 0, 0.5], [0, 2, 0.5], [2, 2, 0.5]]])  # touches the edge x + y = 2
    >>> boxes_meet_triangles(*unit, corner).tolist()
    [[True]]
    >>> boxes_meet_triangles(*unit, corner + [0.1, 0.1, 0]).tolist()
    [[False]]
    """
    half = (high - low)[:, None] / 2
    # Corners seen from the middle of each box: (B, F, 3, 3).
    corners = triangles[None] - ((low + high) / 2)[:, None, None]
    meet = (corners.min(axis=2) <= half).all(axis=-1) & (corners.max(axis=2) >= -half).all(axis=-1)
    edges = np.roll(triangles, -1, axis=1) - triangles
    axes = [np.cross(edges[:, 0], edges[:, 1])]
    axes += [np.cross(unit, edges[:, k]) for unit in np.eye(3) for k in range(3)]
    for axis in axes:
        shadow = np.einsum("bfkj,fj->bfk", corners, axis)
        reach = (half * np.abs(axis)).sum(axis=-1)
        meet &= (shadow.min(axis=2) <= reach) & (shadow.max(axis=2) >= -reach)
    return meet


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points that grippers are tested against, with what finds the near ones.

    Args:
        points: (P, 3) metres, in the frame of the grasps.

    Raises:
        ToolkitError: not (P, 3) finite numbers.
    """

    points: Floats

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ToolkitError("a cloud is (P, 3) finite numbers", value=points.shape)
        object.__setattr__(self, "points", points)

    @cached_property
    def _grid(self) -> PointGrid:
        # Imported here, for it loads the compiler.
        from benchmark.metrics.grasp.points_in_boxes import PointGrid

        return PointGrid(self.points)

    def count_inside(
        self, grasps: Grasps, boxes: Boxes, *, margin: float = 0.0
    ) -> NDArray[np.int64]:
        """How many points lie in each box of each grasp.

        Args:
            grasps: N of them, in the frame of the points.
            boxes: B for each, in the frames of the grasps; their surface is outside.
            margin: by which the boxes grow on all sides, metres.

        Returns:
            (N, B) counts.
        """
        if not len(self.points) or not len(grasps):
            return np.zeros(boxes.low.shape[:2], dtype=np.int64)
        return self._grid.count(grasps.rotations, grasps.translations, boxes, margin=margin)

    def any_inside(self, grasps: Grasps, boxes: Boxes, *, margin: float = 0.0) -> NDArray[np.bool_]:
        """(N,) grasps with a point in any of their boxes; arguments as of `count_inside`."""
        if not len(self.points) or not len(grasps):
            return np.zeros(len(grasps), dtype=bool)
        counts = self._grid.count(
            grasps.rotations, grasps.translations, boxes, margin=margin, first_only=True
        )
        return np.asarray(counts.any(axis=1))

    def hit_by(self, grasps: Grasps, gripper: Gripper) -> NDArray[np.bool_]:
        """(N,) grasps whose open gripper has a point inside it."""
        return self.any_inside(grasps, gripper.boxes(grasps.widths, grasps.depths))

    def count_between(self, grasps: Grasps, gripper: Gripper) -> NDArray[np.int64]:
        """(N,) how many points lie between the open fingers: few of them, and it grasps air."""
        boxes = gripper.between(grasps.widths, grasps.depths)
        return self.count_inside(grasps, boxes)[:, 0]


def voxel_means(points: ArrayLike, size: float) -> Floats:
    """Thin a cloud: the mean of the points in each cell of a grid.

    Args:
        points: (P, 3) metres.
        size: metres, side of a cell; the grid begins half a cell before the smallest coordinates.

    Returns:
        (V, 3) means, ordered by cell.

    >>> voxel_means([[0.0, 0, 0], [0.002, 0, 0], [0.01, 0, 0]], 0.01).tolist()
    [[0.001, 0.0, 0.0], [0.01, 0.0, 0.0]]
    """
    p = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    # The grid begins half a cell before the smallest point, as Open3D's does.
    low = p.min(axis=0, initial=0 if not len(p) else np.inf) - size / 2
    _, cell, count = np.unique(
        np.floor((p - low) / size), axis=0, return_inverse=True, return_counts=True
    )
    cell = cell.reshape(-1)
    sums = [np.bincount(cell, weights=p[:, axis], minlength=len(count)) for axis in range(3)]
    return np.stack(sums, axis=1) / np.maximum(count, 1)[:, None]


def filled_share(
    grasps: Grasps, gripper: Gripper, points: ArrayLike, *, voxel: float = 0.01
) -> Floats:
    """Share of the gripper's volume that occupied voxels fill, as cells per volume.

    GraspNet's post-processing drops grasps by it: more than 1 % of the hand (`GRASPNET_SWEPT`)
    inside the measured cloud.

    Args:
        grasps: N grasps.
        gripper: its boxes.
        points: (P, 3) cloud in the frame of the grasps.
        voxel: metres, side of a cell.

    Returns:
        (N,) shares.

    >>> from benchmark.metrics.grasp import PANDA
    >>> grasp = Grasps.make(np.eye(3)[None], [[0, 0, 0]], widths=0.06, depths=0.02)
    >>> filled_share(grasp, PANDA, [[1.0, 0, 0]]).tolist()  # a point far away
    [0.0]
    """
    boxes = gripper.boxes(grasps.widths, grasps.depths)
    counts = Cloud(voxel_means(points, voxel)).count_inside(grasps, boxes).sum(axis=1)
    volume = (boxes.high - boxes.low).prod(axis=-1).sum(axis=1)
    return counts / (volume / voxel**3)


def lowest_points(grasps: Grasps, gripper: Gripper, T_plane: SE3 | ArrayLike) -> Floats:
    """Height of the open gripper's lowest corner above a plane.

    Args:
        grasps: N grasps.
        gripper: its boxes.
        T_plane: pose of the plane in the frame of the grasps: its z = 0, z points up.

    Returns:
        (N,) metres, negative below the plane.

    >>> from benchmark.metrics.grasp import PANDA
    >>> down = np.array([[[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]])  # x, the approach, points down
    >>> grasp = Grasps.make(down, [[0, 0, 0.1]], widths=0.06, depths=0.02)
    >>> lowest_points(grasp, PANDA, SE3.identity()).round(3).tolist()  # fingertips 2 cm deeper
    [0.08]
    """
    pose = T_plane if isinstance(T_plane, SE3) else SE3.from_matrix(T_plane)
    up = pose.R[:, 2]
    boxes = gripper.boxes(grasps.widths, grasps.depths)
    # The lowest corner of a box lies where each axis that points down is at its largest.
    slope = np.einsum("nji,j->ni", grasps.rotations, up)[:, None]
    corner = np.where(slope > 0, boxes.low, boxes.high)
    heights = (corner * slope).sum(axis=-1).min(axis=1)
    return heights + (grasps.translations - pose.t) @ up


def hits_plane(
    grasps: Grasps, gripper: Gripper, T_plane: SE3 | ArrayLike, *, clearance: float = 0.0
) -> NDArray[np.bool_]:
    """Which open grippers come nearer to a plane than a clearance, or through it.

    Args:
        grasps: N grasps.
        gripper: its boxes.
        T_plane: pose of the plane in the frame of the grasps: its z = 0, z points up.
        clearance: metres.

    Returns:
        (N,) bool.

    >>> from benchmark.metrics.grasp import PANDA
    >>> down = np.array([[[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]])
    >>> grasp = Grasps.make(down, [[0, 0, 0.1]], widths=0.06, depths=0.02)
    >>> [hits_plane(grasp, PANDA, SE3.identity(), clearance=c).item() for c in (0.07, 0.09)]
    [False, True]
    """
    return lowest_points(grasps, gripper, T_plane) < clearance


def hits_mesh(
    grasps: Grasps, gripper: Gripper, vertices: ArrayLike, faces: ArrayLike
) -> NDArray[np.bool_]:
    """Which open grippers touch a triangle, exactly, or are within a closed mesh.

    Args:
        grasps: N grasps.
        gripper: its boxes.
        vertices: (V, 3) metres, in the frame of the grasps.
        faces: (F, 3).

    Returns:
        (N,) bool.

    >>> from benchmark.metrics.grasp import PANDA
    >>> grasp = Grasps.make(np.eye(3)[None], [[0, 0, 0]], widths=0.06, depths=0.02)
    >>> triangle = np.array([[0, -0.01, -0.01], [0, 0.01, -0.01], [0, 0, 0.01]])
    >>> hits_mesh(grasp, PANDA, triangle, [[0, 1, 2]]).tolist()  # between the fingers
    [False]
    >>> hits_mesh(grasp, PANDA, triangle + [0, 0.035, 0], [[0, 1, 2]]).tolist()  # in a finger
    [True]
    """
    import trimesh

    triangles = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
    boxes = gripper.boxes(grasps.widths, grasps.depths)
    hit = np.zeros(len(grasps), dtype=bool)
    reach = np.linalg.norm(triangles - triangles.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    middles = triangles.mean(axis=1)
    for n in range(len(grasps)):
        R, t = grasps.rotations[n], grasps.translations[n]
        low, high = boxes.low[n], boxes.high[n]
        local = (middles - t) @ R
        near = (local + reach[:, None] > low.min(axis=0)) & (
            local - reach[:, None] < high.max(axis=0)
        )
        close = (triangles[near.all(axis=1)] - t) @ R
        hit[n] = boxes_meet_triangles(low, high, close).any()
    if len(grasps) and trimesh.Trimesh(vertices, faces, process=False).is_volume:
        middle = (boxes.low + boxes.high) / 2
        places = np.einsum("nij,nbj->nbi", grasps.rotations, middle) + grasps.translations[:, None]
        hit |= RayCaster(vertices, faces, threads=1).inside(places).any(axis=1)
    return hit
