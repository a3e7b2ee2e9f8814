"""Inputs of pose methods: frames with true poses, and views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, resize_nearest
from benchmark.data.splits import DepthSource
from benchmark.data.true_poses import KnownBox, TruePose, known_boxes, true_poses
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.protocol import PoseAnswer, PoseEstimator, PoseView
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, eq=False)
class PoseFrame:
    """A frame with the known boxes and true poses of its objects."""

    frame: DepthFrame
    boxes: dict[int, KnownBox]
    truths: list[TruePose]


def load_pose_frame(source: DepthSource, index: int) -> PoseFrame:
    """Load a frame with its true poses.

    Raises:
        ToolkitError: the frame cannot be read, or has no normalised coordinates.
    """
    frame = source.load(index, nocs=True)
    boxes = known_boxes(source, index)
    return PoseFrame(frame, boxes, true_poses(frame, boxes))


def pose_view(
    frame: DepthFrame,
    depth: NDArray[np.float32],
    method: PoseEstimator,
    *,
    boxes: Mapping[int, KnownBox],
    sensor: NDArray[np.float32] | None = None,
) -> PoseView:
    """Create the input of a method at its input size, or at ground truth size if it has none.

    Args:
        frame: frame with NOCS.
        depth: depth that poses are fitted to, of any size, metres. Values that are not finite or
            not positive are missing depth.
        method: the method.
        boxes: known boxes of the objects, by mask id.
        sensor: input depth of networks, of any size; by default the raw depth of the frame.

    Raises:
        ToolkitError: the method needs NOCS and the frame has none.
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
