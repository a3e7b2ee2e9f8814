"""Inputs of pose methods: the depth that poses are fitted to, frames with true poses, views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, resize_nearest
from benchmark.data.splits import DepthSource, FrameKey, saved_depth_path
from benchmark.data.true_poses import KnownBox, TruePose, known_boxes, true_poses
from benchmark.evaluation.config import plain_label
from benchmark.evaluation.frames import error_line, restore_views
from benchmark.methods.depth.full_size import at_full_size, restorer_view, view_of
from benchmark.methods.protocol import PoseAnswer, PoseEstimator, PoseView, Restorer
from benchmark.methods.registry import MethodOptions, make_restorer, restorers
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr_channel

RAW, TRUE = "raw", "gt"

Depth = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class DepthChoice:
    """One of the depths that poses are fitted to.

    Attributes:
        name: `raw`, `gt`, the name of a restorer, or the name given to a folder of depth.
        options: options of the restorer.
        folder: folder of depth written by `std-bench --save-depth`; otherwise None.
    """

    name: str
    options: MethodOptions = field(default_factory=MethodOptions)
    folder: Path | None = None

    @property
    def is_restored(self) -> bool:
        """Whether the depth comes from a restorer."""
        return self.folder is None and self.name not in (RAW, TRUE)

    @property
    def label(self) -> str:
        """Name in folders and tables."""
        return plain_label(self.name)


def depth_choice(text: str) -> DepthChoice:
    """Parse `raw`, `gt`, the name of a restorer, or `NAME=FOLDER`.

    Raises:
        ToolkitError: a folder without a name, or with the name of another depth.
    """
    name, equals, folder = text.partition("=")
    if equals:
        if name in (RAW, TRUE, *restorers.names()) or not name:
            raise ToolkitError(
                "depth in a folder needs a name of its own", field="depth", value=text
            )
        return DepthChoice(name=name, folder=Path(folder))
    return DepthChoice(name=text)


class DepthProvider:
    """Returns the depth of frames; created once in every worker.

    Raises:
        ToolkitError: the restorer cannot be created, or the folder does not exist.
    """

    def __init__(self, choice: DepthChoice, split: str) -> None:
        self.choice = choice
        self.split = split
        self.restorer: Restorer | None = None
        if choice.is_restored:
            self.restorer = make_restorer(choice.name, choice.options)
        elif choice.folder is not None and not choice.folder.is_dir():
            raise ToolkitError("no such folder of saved depth", path=choice.folder)

    def depths(self, frames: Mapping[int, DepthFrame]) -> dict[int, Depth | str]:
        """Return the depth of the frames of a batch, each of any size, or error lines."""
        if self.restorer is None:
            return {index: self._known(frame) for index, frame in frames.items()}
        method = self.restorer
        views = {index: restorer_view(frame, method) for index, frame in frames.items()}
        answers = restore_views(method, views)
        return {
            i: a if isinstance(a, str) else at_full_size(frames[i].depth_raw, a)
            for i, a in answers.items()
        }

    def _known(self, frame: DepthFrame) -> Depth | str:
        if self.choice.folder is None:
            return frame.depth_true if self.choice.name == TRUE else frame.depth_raw
        path = saved_depth_path(self.choice.folder, self.split, FrameKey(frame.scene, frame.name))
        try:
            return read_exr_channel(path).astype(np.float32)
        except ToolkitError as error:
            return error_line(error)


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
