"""From objects with coordinates at every pixel to their poses in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.frames import PosePrediction
from benchmark.pose_methods.fitting import FitMethod, FitOptions, FittedPose, fit_pose
from benchmark.pose_methods.protocol import Estimated, PoseView
from benchmark.pose_methods.segmented import Segmented
from std_toolkit.errors import ToolkitError

_LEAST_POINTS = 4  # three points leave a fit nothing to be checked by


def posed(
    found: Segmented,
    coordinates: NDArray[np.float32],
    view: PoseView,
    options: FitOptions | None = None,
) -> Estimated:
    """Fit a pose to every object.

    Args:
        found: objects, at the view's size.
        coordinates: (h, w, 3) of all objects together, or (N, h, w, 3), normalised coordinates in
            [0, 1] at the pixels of the masks.
        view: whose depth the poses are fitted to.
        options: how outliers are met. `FitMethod.PAPER` answers what cannot be fitted with the
            identity; RANSAC leaves it out.
    """
    options = options or FitOptions()
    measured = np.isfinite(view.depth) & (view.depth > 0)
    rays = view.camera.rays()
    fits: list[FittedPose] = []
    kept: list[int] = []
    for number, mask in enumerate(found.masks):
        chosen = mask & measured
        nocs = coordinates if coordinates.ndim == 3 else coordinates[number]
        points = rays[chosen] * view.depth[chosen][:, None]
        fitted = _fit(nocs[chosen] - 0.5, points, options)
        if fitted is not None:
            fits.append(fitted)
            kept.append(number)
    prediction = PosePrediction(
        found.class_ids[kept],
        np.array([f.RT for f in fits]).reshape(-1, 4, 4),
        np.array([f.size for f in fits]).reshape(-1, 3),
        found.scores[kept],
    )
    return Estimated(prediction, found.masks[kept])


def _fit(
    coordinates: NDArray[np.floating], points: NDArray[np.floating], options: FitOptions
) -> FittedPose | None:
    if options.fit is not FitMethod.PAPER and len(points) < _LEAST_POINTS:
        return None
    try:
        return fit_pose(coordinates, points, options)
    except ToolkitError:
        return None  # points that no pose explains: the object is found, and counts as missed
