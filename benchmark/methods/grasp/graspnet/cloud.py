"""GraspNet's configuration, input cloud, approach views and rotations; without torch."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.methods.protocol import GraspView
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import pixel_rays

Floats = NDArray[np.float32]

Float64s = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class GraspNetConfig:
    """GraspNet (Fang et al., CVPR 2020); the defaults are the published network.

    Attributes:
        points: of the cloud that the network sees; a larger cloud is thinned out, of a smaller one
            points are repeated.
        level_points: points of the backbone's four levels; those of the second are the seeds.
        level_radii: metres, of the balls around them.
        level_neighbours: points of a ball, at most.
        width: channels of the backbone: of its first level half as many, of its features and of
            those of the cylinders twice as many.
        views: approach directions.
        angles: turns about the approach direction, over half a turn.
        depths: metres that the fingers reach beyond the seed; cylinders end there.
        cylinder_radius, cylinder_behind: metres; cylinders begin so far before the seed.
        cylinder_points: points of a cylinder, at most.
        max_width: metres, the widest grasp.
        max_tolerance: metres, the largest tolerance.
        width_margin: how much wider than predicted the fingers open.
        voxel: metres; the cloud that the network sees has at most one point per such cube, 0 for
            all points.
        margin: metres around the objects that are looked at too.
        lowest, highest: metres above the table that are looked at, where it is known.
        standing: metres above the table from which on something is an object, where no mask tells.
        gripper: the one that is to grasp: its opening and size, not the network's.
        collision: whether grasps are left out that would touch the cloud.
        collision_voxel: metres, side of the cubes that the cloud is thinned to for that.
        collision_share: of the gripper's volume that may be taken.
        nms_distance, nms_angle: metres and degrees; of two grasps nearer than both the better one
            is kept.
        most: grasps that are kept.

    Raises:
        ToolkitError: a number that makes no sense.
    """

    points: int = 20_000
    level_points: tuple[int, int, int, int] = (2048, 1024, 512, 256)
    level_radii: tuple[float, float, float, float] = (0.04, 0.1, 0.2, 0.3)
    level_neighbours: tuple[int, int, int, int] = (64, 32, 16, 16)
    width: int = 128
    views: int = 300
    angles: int = 12
    depths: tuple[float, ...] = (0.01, 0.02, 0.03, 0.04)
    cylinder_radius: float = 0.05
    cylinder_behind: float = 0.02
    cylinder_points: int = 64
    max_width: float = 0.1
    max_tolerance: float = 0.05
    width_margin: float = 1.2
    voxel: float = 0.0
    margin: float = 0.1
    lowest: float = -0.02
    highest: float = 0.4
    standing: float = 0.01
    gripper: Literal["panda", "graspnet"] = "panda"
    collision: bool = True
    collision_voxel: float = 0.01
    collision_share: float = 0.01
    nms_distance: float = 0.03
    nms_angle: float = 30.0
    most: int = 50

    def __post_init__(self) -> None:
        for name in ("points", "width", "views", "angles", "cylinder_points", "most"):
            if getattr(self, name) < 1:
                raise ToolkitError("must be at least 1", field=name, value=getattr(self, name))
        sizes = (self.points, *self.level_points)
        if any(later > earlier for earlier, later in pairwise(sizes)):
            raise ToolkitError(
                "a level cannot have more points than the one before it, nor the first more than "
                f"the cloud, {self.points}",
                field="level_points",
                value=self.level_points,
            )
        if not self.depths or min(self.depths) <= -self.cylinder_behind:
            raise ToolkitError("must end beyond the cylinder", field="depths", value=self.depths)


PRESETS = {
    "published": GraspNetConfig(),
    "compact": GraspNetConfig(
        points=6000,
        level_points=(1024, 384, 128, 64),
        level_neighbours=(32, 32, 16, 16),
        width=48,
        cylinder_points=32,
    ),
}


def measured_pixels(view: GraspView) -> NDArray[np.bool_]:
    """(h, w) pixels that have depth, and a ray through the lens."""
    rays = pixel_rays(view.camera)
    return np.isfinite(view.depth) & (view.depth > 0) & np.isfinite(rays).all(axis=-1)


def scene_cloud(view: GraspView) -> Floats:
    """(n, 3) points of the pixels that are `measured_pixels`, camera frame, metres, row by row."""
    there = measured_pixels(view)
    rays = pixel_rays(view.camera)[there]
    return (rays * view.depth[there, None]).astype(np.float32)


def workspace(view: GraspView, cloud: Floats, config: GraspNetConfig) -> NDArray[np.bool_]:
    """(n,) which points of a cloud the network is shown.

    Those in the box around the objects, with a margin, as published. Objects are what the mask
    tells of, or else what stands out of the table; where nothing is known, all points are shown.

    Args:
        view: what is seen.
        cloud: all of `scene_cloud(view)`.
        config: how large the margin is, and which heights above the table count.
    """
    if view.mask is None and view.T_cam_table is None:
        return np.ones(len(cloud), bool)
    # The box stands upright on the table where that is known.
    T = np.eye(4) if view.T_cam_table is None else np.linalg.inv(view.T_cam_table)
    points = cloud @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
    kept = np.ones(len(cloud), bool)
    inside = kept if view.mask is None else view.mask[measured_pixels(view)]
    if view.T_cam_table is not None:
        kept = (points[:, 2] > config.lowest) & (points[:, 2] < config.highest)
        inside = kept & (inside if view.mask is not None else points[:, 2] > config.standing)
    if not inside.any():
        return np.zeros(len(cloud), bool)
    # Single wrong depths, as at outlines, must not stretch the box over half the room.
    low, high = np.percentile(points[inside], (0.5, 99.5), axis=0)
    around = (points > low - config.margin) & (points < high + config.margin)
    # How far up and down is said by the table, where that is known.
    return kept & (around if view.T_cam_table is None else around[:, :2]).all(axis=1)


def thinned(points: NDArray[np.floating], voxel: float) -> NDArray[np.intp]:
    """Indices of one point of each cube of side `voxel`, the first, in rising order."""
    if not voxel or not len(points):
        return np.arange(len(points))
    cubes = np.floor(points / voxel).astype(np.int64)
    cubes -= cubes.min(axis=0)
    size = cubes.max(axis=0) + 1
    flat = (cubes[:, 0] * size[1] + cubes[:, 1]) * size[2] + cubes[:, 2]
    return np.sort(np.unique(flat, return_index=True)[1])


def sampled(count: int, wanted: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """`wanted` of `count` indices in random order; each at least once where they are fewer."""
    if count >= wanted:
        return rng.permutation(count)[:wanted]
    more = rng.integers(count, size=wanted - count)
    return rng.permutation(np.concatenate([np.arange(count), more]))


def fibonacci_views(count: int) -> Float64s:
    """(count, 3) unit vectors, evenly spread over the sphere; a gripper comes from there."""
    turn = np.arange(count) * np.pi * (np.sqrt(5) - 1)
    z = (2 * np.arange(count) + 1) / count - 1
    around = np.sqrt(1 - z * z)
    return np.stack([around * np.cos(turn), around * np.sin(turn), z], axis=1)


def rotation_of(approaches: ArrayLike, turns: ArrayLike = 0.0) -> Float64s:
    """(..., 3, 3) gripper rotations: x along the approach, y level before the turn about x.

    Args:
        approaches: (..., 3) unit vectors.
        turns: (...,) radians.
    """
    x = np.asarray(approaches, dtype=np.float64)
    y = np.stack([-x[..., 1], x[..., 0], np.zeros_like(x[..., 0])], axis=-1)
    length = np.linalg.norm(y, axis=-1, keepdims=True)
    # Straight up or down every y is level.
    y = np.where(length > 1e-9, y / np.maximum(length, 1e-9), [0.0, 1.0, 0.0])
    z = np.cross(x, y)
    c, s = (f(np.asarray(turns, dtype=np.float64))[..., None] for f in (np.cos, np.sin))
    return np.stack([np.broadcast_to(x, (c * y).shape), c * y + s * z, c * z - s * y], axis=-1)


def gripper_rotations(views: int, angles: int) -> Float64s:
    """(views, angles, 3, 3) rotations of all views, turned by equal steps over half a turn."""
    turns = np.arange(angles) * np.pi / angles
    return rotation_of(-fibonacci_views(views)[:, None], turns[None])
