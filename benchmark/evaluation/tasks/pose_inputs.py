"""Input of pose methods: the depth that poses are fitted to, frames with true poses, views."""

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
        name: `raw`, `gt`, a restorer's name, or what depth in a folder is called.
        options: of the restorer.
        folder: of depth that `std-bench --save-depth` kept; None for the others.
    """

    name: str
    options: MethodOptions = field(default_factory=MethodOptions)
    folder: Path | None = None

    @property
    def is_restored(self) -> bool:
        """Whether a restorer has to make it."""
        return self.folder is None and self.name not in (RAW, TRUE)

    @property
    def label(self) -> str:
        """As folders and tables have it."""
        return plain_label(self.name)


def depth_choice(text: str) -> DepthChoice:
    """The depth that a user means by `raw`, `gt`, a restorer's name, or `NAME=FOLDER`.

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
    """Gives the depth of frames; made once in every worker.

    Raises:
        ToolkitError: the restorer cannot be made, or there is no such folder.
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
        """Depth of the frames of a batch, each of any size, or why there is none."""
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
    """A frame with what is known of its objects."""

    frame: DepthFrame
    boxes: dict[int, KnownBox]
    truths: list[TruePose]


def load_pose_frame(source: DepthSource, index: int) -> PoseFrame:
    """A frame with its true poses.

    Raises:
        ToolkitError: it cannot be read, or has no normalised coordinates.
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
