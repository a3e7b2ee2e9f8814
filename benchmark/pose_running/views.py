"""A frame as a pose method may see it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.true_poses import KnownBox
from benchmark.metrics.resize import resize_nearest
from benchmark.pose_methods.protocol import PoseAnswer, PoseEstimator, PoseView
from benchmark.running.views import view_of
from std_toolkit.errors import ToolkitError


def pose_view(
    frame: DepthFrame,
    depth: NDArray[np.float32],
    method: PoseEstimator,
    *,
    boxes: Mapping[int, KnownBox],
    sensor: NDArray[np.float32] | None = None,
) -> PoseView:
    """Everything at the method's size, or the ground truth's for a method of any size.

    Args:
        frame: with NOCS.
        depth: of any size, metres: what poses are fitted to. What is not finite or not positive is
            no depth.
        method: that will see it.
        boxes: what the data set knows of the objects, by mask id.
        sensor: of any size, what networks look at; the frame's raw depth by default.

    Raises:
        ToolkitError: the method must be told NOCS and the frame has none.
    """
    seen = view_of(frame, method.input_size)
    size = seen.camera.size
    answer = None
    if method.needs_truth:
        if frame.nocs is None:
            raise ToolkitError("the frame has no normalised coordinates", path=frame.key)
        answer = PoseAnswer(
            resize_nearest(frame.mask, size),
            frame.instances,
            resize_nearest(frame.nocs, size),
            {mask_id: box.sides for mask_id, box in boxes.items()},
        )
    looked_at = seen.depth if sensor is None else _resized(sensor, size)
    return PoseView(seen.color, looked_at, _resized(depth, size), seen.camera, answer)


def _resized(depth: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    resized = resize_nearest(np.asarray(depth, np.float32), size)
    resized[~(np.isfinite(resized) & (resized > 0))] = 0
    return resized
