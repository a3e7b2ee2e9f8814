"""Frames through a pose method; one that fails is told, not fatal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmark.data.frame import DepthFrame
from benchmark.data.source import DepthSource, FrameKey
from benchmark.data.true_poses import KnownBox, TruePose, known_boxes, true_poses
from benchmark.pose_methods.protocol import Estimated, PoseEstimator, PoseView
from benchmark.pose_running.depths import DepthGiver
from benchmark.pose_running.table import READ, rows_of_frame
from benchmark.pose_running.views import pose_view
from benchmark.running.batch import told
from benchmark.running.parts import ERROR, FRAME, INDEX, SCENE
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, eq=False)
class PoseFrame:
    """A frame with what is known of its objects."""

    frame: DepthFrame
    boxes: dict[int, KnownBox]
    truths: list[TruePose]


def load_pose_frames(source: DepthSource, indices: Sequence[int]) -> list[PoseFrame | str]:
    """The frames of a batch; for one that cannot be read, the error as one line."""
    loaded: list[PoseFrame | str] = []
    for index in indices:
        try:
            loaded.append(load_pose_frame(source, index))
        except Exception as error:  # a damaged file can raise anything in the libraries below
            loaded.append(told(error))
    return loaded


def load_pose_frame(source: DepthSource, index: int) -> PoseFrame:
    """A frame with its true poses.

    Raises:
        ToolkitError: it cannot be read, or has no normalised coordinates.
    """
    frame = source.load(index, nocs=True)
    boxes = known_boxes(source, index)
    return PoseFrame(frame, boxes, true_poses(frame, boxes))


def estimate_batch(
    indices: Sequence[int],
    keys: Sequence[FrameKey],
    loaded: Sequence[PoseFrame | str],
    method: PoseEstimator,
    depths: DepthGiver,
    *,
    as_input: bool = False,
) -> list[dict[str, Any]]:
    """The rows of a batch for the table.

    Args:
        indices: of the frames in the split.
        keys: their scenes and names.
        loaded: the frames, or why there is none.
        method: that finds poses.
        depths: what they are fitted to.
        as_input: networks look at that depth too, and not at raw depth.
    """
    there = {i: f for i, f in zip(indices, loaded, strict=True) if isinstance(f, PoseFrame)}
    answers: dict[int, Estimated | str] = {}
    views: dict[int, PoseView] = {}
    for index, depth in depths.depths({i: f.frame for i, f in there.items()}).items():
        if isinstance(depth, str):
            answers[index] = depth
            continue
        frame, boxes = there[index].frame, there[index].boxes
        sensor = depth if as_input else None
        views[index] = pose_view(frame, depth, method, boxes=boxes, sensor=sensor)
    answers |= _estimate(method, views)
    rows: list[dict[str, Any]] = []
    for index, key, frame_or_error in zip(indices, keys, loaded, strict=True):
        base: dict[str, Any] = {INDEX: index, SCENE: key.scene, FRAME: key.name}
        if isinstance(frame_or_error, str):
            rows += rows_of_frame(base | {ERROR: frame_or_error, READ: False}, (), None)
            continue
        answer = answers[index]
        error = answer if isinstance(answer, str) else ""
        found = None if isinstance(answer, str) else answer.prediction
        rows += rows_of_frame(base | {ERROR: error, READ: True}, frame_or_error.truths, found)
    return rows


def _estimate(method: PoseEstimator, views: dict[int, PoseView]) -> dict[int, Estimated | str]:
    """Answers by index, or why there is none; what fails together is tried one by one."""
    if not views:
        return {}
    try:
        return dict(zip(views, _checked(method, list(views.values())), strict=True))
    except (KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:
        if len(views) == 1:
            return {next(iter(views)): told(error)}
    found: dict[int, Estimated | str] = {}
    for index, view in views.items():
        found |= _estimate(method, {index: view})
    return found


def _checked(method: PoseEstimator, views: list[PoseView]) -> list[Estimated]:
    answers = method.estimate(views)
    if len(answers) != len(views):
        raise ToolkitError(f"the method gave {len(answers)} answers to {len(views)} views")
    for answer in answers:
        if not isinstance(answer, Estimated):
            raise ToolkitError("the method must give Estimated", value=type(answer).__name__)
    return answers
