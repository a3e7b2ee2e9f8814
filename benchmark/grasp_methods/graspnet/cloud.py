"""From a depth image to the points that the network looks at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.grasp_methods.graspnet.config import GraspNetConfig
from benchmark.grasp_methods.protocol import GraspView
from std_toolkit.geometry.camera import pixel_rays

Floats = NDArray[np.float32]


def seen(view: GraspView) -> NDArray[np.bool_]:
    """(h, w) pixels that have depth, and a ray through the lens."""
    rays = pixel_rays(view.camera)
    return np.isfinite(view.depth) & (view.depth > 0) & np.isfinite(rays).all(axis=-1)


def scene_cloud(view: GraspView) -> Floats:
    """(n, 3) points of the pixels that are `seen`, camera frame, metres, row by row."""
    there = seen(view)
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
    inside = kept if view.mask is None else view.mask[seen(view)]
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
