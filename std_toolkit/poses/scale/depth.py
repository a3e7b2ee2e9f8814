"""Metres from the depth sensor: z over z, never z over range.

A depth image holds z-depth: the distance along the optical axis. Dividing it by the distance of
the point from the camera centre (range) makes every ratio too small by the cosine of the angle
off the axis, 0.9-6.5 % for common fields of view.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.poses.model import Observations
from std_toolkit.poses.scale.source import ScaleContext, summarise
from std_toolkit.scene.model import ScaleEstimate

MAX_FRAMES = 60
MIN_TRACK_LENGTH = 3
MIN_RATIOS = 100
# A pixel counts if its 3x3 neighbourhood is complete and flatter than this share of its depth:
# at an edge a sub-pixel difference picks foreground or background.
MAX_STEP = 0.01
# Beyond this the error of stereo depth grows with the square of the distance.
MIN_DEPTH_M, MAX_DEPTH_M = 0.15, 4.0
MAX_REPROJECTION_PX = 1.5


class DepthScale:
    """Median of sensor z-depth over the z-depth of reconstructed points."""

    name = "depth"

    def available(self, context: ScaleContext) -> bool:
        return any(f.depth is not None for f in context.frames())

    def estimate(self, context: ScaleContext) -> ScaleEstimate:
        frames = [f for f in context.frames() if f.depth is not None]
        # Spread over the recording; reading every depth image would cost more than it tells.
        step = max(1, -(-len(frames) // MAX_FRAMES))
        ratios, groups = [], []
        for frame in frames[::step]:
            depth = context.scene.read_depth(frame)
            if depth is None:
                continue
            single = z_ratios(depth, context.observations(frame.id))
            ratios.append(single)
            groups.append(np.full(len(single), frame.id))
        found = np.concatenate(ratios) if ratios else np.zeros(0)
        if len(found) < MIN_RATIOS:
            raise ToolkitError(
                f"scale from depth needs {MIN_RATIOS} points with sensor depth",
                value=len(found),
                hint="is the depth aligned to colour? name another source with --scale",
            )
        return summarise(
            self.name,
            found,
            groups=np.concatenate(groups),
            note=f"z over z at {len(found)} points in {len(ratios)} frames; depth correction "
            f"factor {context.scene.info.depth_correction:g} applied",
        )


def z_ratios(depth: NDArray[np.floating], seen: Observations) -> NDArray[np.float64]:
    """Sensor z-depth over model z-depth at every point where both can be trusted.

    Args:
        depth: (H, W) z-depth in metres, 0 = none.
        seen: what the image of this depth sees.

    Returns:
        (N,) metres per unit of the model.
    """
    p = seen.points_cam
    uv = seen.camera.project(p)
    h, w = depth.shape
    good = (
        np.isfinite(uv).all(axis=1)
        & (seen.track_length >= MIN_TRACK_LENGTH)
        & (np.linalg.norm(uv - seen.uv, axis=1) < MAX_REPROJECTION_PX)
    )
    good[good] &= (uv[good] >= 1).all(axis=1) & (uv[good] <= [w - 3, h - 3]).all(axis=1)
    uv, z = uv[good], p[good, 2]
    if len(z) == 0:
        return np.zeros(0)
    u0, v0 = np.floor(uv).astype(int).T
    patch = np.stack(
        [depth[v0 + dv, u0 + du] for dv in (-1, 0, 1, 2) for du in (-1, 0, 1, 2)], axis=1
    ).astype(np.float64)
    complete = (patch > 0).all(axis=1)
    middle = patch[:, [5, 6, 9, 10]]
    flat = np.ptp(patch, axis=1) < 3 * MAX_STEP * np.maximum(middle.mean(axis=1), 1e-9)
    a, b = uv[:, 0] - u0, uv[:, 1] - v0
    # Inverse depth is linear in the image on a plane, depth is not: interpolate the former.
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / middle
        measured = 1 / (
            inverse[:, 0] * (1 - a) * (1 - b)
            + inverse[:, 1] * a * (1 - b)
            + inverse[:, 2] * (1 - a) * b
            + inverse[:, 3] * a * b
        )
    near = (measured > MIN_DEPTH_M) & (measured < MAX_DEPTH_M)
    keep = complete & flat & near & (z > 0)
    return np.asarray(measured[keep] / z[keep], dtype=np.float64)
