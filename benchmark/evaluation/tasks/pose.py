"""Category-level pose as a task: one method over one split with one depth.

Frames through a pose method; one that fails is told, not fatal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.data.frame import DepthFrame
from benchmark.data.splits import DepthSource, FrameKey, names_digest, open_split
from benchmark.data.true_poses import KnownBox, TruePose, known_boxes, true_poses
from benchmark.evaluation.engine import (
    Batch,
    as_unusable_method,
    chosen_frames,
    claim_device,
    complete,
    describe_frames,
    pieces_left,
    weights_digest,
    write_rows,
)
from benchmark.evaluation.manifest import POSE_MANIFEST, PoseSetup, pose_manifest
from benchmark.evaluation.results import ERROR, FRAME, INDEX, SCENE
from benchmark.evaluation.tasks.depth import error_line
from benchmark.evaluation.tasks.pose_inputs import DepthChoice, DepthProvider, pose_view
from benchmark.evaluation.tasks.pose_table import POSES, READ, rows_of_frame
from benchmark.methods.protocol import Estimated, PoseEstimator, PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions

POSE_FOLDER = "pose"

AS_INPUT = "as-input"


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
            loaded.append(error_line(error))
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
    depths: DepthProvider,
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
            return {next(iter(views)): error_line(error)}
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


@dataclass(frozen=True, kw_only=True)
class PoseRun:
    """What is estimated, by what, how.

    Attributes:
        split, root: name of the split and folder of the data.
        method, options: the pose method; `options.device` is ignored in favour of `devices`.
        depth: what poses are fitted to.
        fit: how they are fitted, `ransac` or `paper`.
        as_input: networks look at that depth, too, and not at raw depth.
        devices: torch devices, of which each worker takes one.
        label: what the method is called in tables.
        out: folder of results.
        batch_size: frames that go through the method together.
        limit: of frames, evenly spread over the split; None for all.
    """

    split: str
    root: Path
    method: str
    options: MethodOptions
    depth: DepthChoice
    label: str
    out: Path
    fit: str = "ransac"
    as_input: bool = False
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 8
    limit: int | None = None

    @property
    def depth_label(self) -> str:
        """What the depth is called in folders and tables."""
        return f"{self.depth.label}-{AS_INPUT}" if self.as_input else self.depth.label

    @property
    def folder(self) -> Path:
        """Where this run's files lie."""
        return self.out / POSE_FOLDER / self.split / self.label / self.depth_label / self.fit

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.label} on {self.split}, {self.depth_label} depth, fit {self.fit}"

    @property
    def settings(self) -> dict[str, str]:
        """The method's, the fit among them."""
        return {**self.options.settings, "fit": self.fit}


def run_poses(run: PoseRun, jobs: JobOptions | None = None) -> pd.DataFrame:
    """Estimate the poses of frames that have not been done yet.

    Frames are numbered by their place in the split, and batches by their frames: whatever is
    interrupted, killed or spread over machines, the table is the same in the end.

    Returns:
        The rows of `benchmark.evaluation.tasks.pose_table`; frames that failed have a text in
        `error`.

    Raises:
        ToolkitError: data, method, weights or depth cannot be used, or another run was begun in
            this folder.
    """
    jobs = jobs or JobOptions()
    source = open_split(run.split, run.root)
    chosen = chosen_frames(len(source), run.limit)
    _check_truth(source, chosen)
    # Once and at once, and not first in every worker: a wrong option is told in one line.
    method, depths = _usable(run)
    manifest = pose_manifest(
        _setup(run, source, method, depths, chosen),
        label=run.label,
        depth_label=run.depth_label,
        fit=run.fit,
        root=run.root,
        weights=run.options.weights,
        depth_weights=run.depth.options.weights,
    )
    if jobs.workers is None and _has_network(method, depths):
        # A network uses all of a device; a second process would only double its memory.
        jobs = replace(jobs, workers=len(run.devices))
    del method, depths
    remaining = partial(pieces_left, chosen, run.batch_size, jobs.worker_count)
    return complete(
        run.folder, manifest, remaining, _Worker(run),
        title=run.title, key=describe_frames, jobs=jobs, unit="pieces of work",
        table=POSES, manifest_name=POSE_MANIFEST,
    )  # fmt: skip


def _check_truth(source: DepthSource, chosen: Sequence[int]) -> None:
    """Tell at once where a split has no true poses at all, and not once per frame."""
    for index in chosen[:1]:
        load_pose_frame(source, index)


def _usable(run: PoseRun) -> tuple[PoseEstimator, DepthProvider]:
    with as_unusable_method(run.devices):
        return _make(run, run.devices[0])


def _make(run: PoseRun, device: str) -> tuple[PoseEstimator, DepthProvider]:
    method = make_pose_method(
        run.method, replace(run.options, device=device, settings=run.settings)
    )
    options = replace(run.depth.options, device=device)
    return method, DepthProvider(replace(run.depth, options=options), run.split)


def _has_network(method: PoseEstimator, depths: DepthProvider) -> bool:
    return any(hasattr(part, "network") for part in (method, depths.restorer))


class _Worker:
    """Estimates batches in a worker process, which keeps data set and networks."""

    def __init__(self, run: PoseRun) -> None:
        self.run = run

    def __call__(self, batches: Sequence[Batch]) -> int:
        source, method, depths = _equipment(self.run)
        keys = source.keys()

        def rows_of(batch: Batch, loaded: list[PoseFrame | str]) -> list[dict[str, Any]]:
            named, as_input = [keys[i] for i in batch], self.run.as_input
            return estimate_batch(batch, named, loaded, method, depths, as_input=as_input)

        return write_rows(self.run.folder, batches, partial(load_pose_frames, source), rows_of)


_kept: dict[str, tuple[DepthSource, PoseEstimator, DepthProvider]] = {}


def _equipment(run: PoseRun) -> tuple[DepthSource, PoseEstimator, DepthProvider]:
    """Data set, method and depth of this process; those of an earlier run make room."""
    key = repr(run)
    if key not in _kept:
        _kept.clear()
        device = claim_device(run.devices, run.folder / ".devices")
        _kept[key] = (open_split(run.split, run.root), *_make(run, device))
    return _kept[key]


def _setup(
    run: PoseRun,
    source: DepthSource,
    method: PoseEstimator,
    depths: DepthProvider,
    chosen: Sequence[int],
) -> PoseSetup:
    keys = source.keys()
    folder = run.depth.folder
    return PoseSetup(
        split=run.split,
        frames=len(chosen),
        frames_sha256=names_digest(keys[i] for i in chosen),
        method=run.method,
        preset=run.options.preset,
        settings=run.settings,
        weights_sha256=weights_digest(run.method, method, run.options),
        precision=run.options.precision,
        compile=run.options.compile,
        device=run.devices[0].partition(":")[0],
        batch_size=run.batch_size,
        depth=run.depth.name,
        depth_preset=run.depth.options.preset if run.depth.is_restored else "",
        depth_settings=dict(run.depth.options.settings),
        depth_weights_sha256=weights_digest(run.depth.name, depths.restorer, run.depth.options),
        depth_folder="" if folder is None else str(folder.resolve()),
        as_input=run.as_input,
    )
