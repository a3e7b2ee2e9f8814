"""Category-level pose as a task: one method over one split with one depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

from benchmark.data.splits import DepthSource, FrameKey, open_split
from benchmark.evaluation.config import PoseConfig, checked_label, options_by_method
from benchmark.evaluation.engine import weights_digest
from benchmark.evaluation.frames import (
    Batch,
    FrameRun,
    FrameTask,
    answers_one_by_one,
    frame_options,
    frame_setup,
)
from benchmark.evaluation.manifest import POSE_MANIFEST, PoseManifest, PoseSetup, circumstances
from benchmark.evaluation.results import ERROR, FRAME, INDEX, SCENE
from benchmark.evaluation.tasks.pose_inputs import (
    RAW,
    DepthChoice,
    DepthProvider,
    PoseFrame,
    depth_choice,
    load_pose_frame,
    pose_view,
)
from benchmark.evaluation.tasks.pose_results import (
    PoseResult,
    pose_records,
    poses_table,
    read_pose_run,
    wanted_protocols,
)
from benchmark.evaluation.tasks.pose_table import POSES, READ, rows_of_frame
from benchmark.methods.protocol import Estimated, PoseEstimator, PoseView
from benchmark.methods.registry import make_pose_method
from benchmark.metrics.pose import PoseProtocol
from std_toolkit.errors import ToolkitError

POSE_FOLDER = "pose"

AS_INPUT = "as-input"

Methods = tuple[PoseEstimator, DepthProvider]


@dataclass(frozen=True, kw_only=True)
class PoseRun(FrameRun):
    """What is estimated, by what, how.

    Attributes:
        depth: what poses are fitted to.
        fit: how they are fitted, `ransac` or `paper`.
        as_input: networks look at that depth, too, and not at raw depth.
    """

    depth: DepthChoice
    fit: str = "ransac"
    as_input: bool = False

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
    def method_title(self) -> str:
        """What method and depth are called."""
        return f"{self.label}, {self.depth_label} depth"

    @property
    def settings(self) -> dict[str, str]:
        """The method's, the fit among them."""
        return {**self.options.settings, "fit": self.fit}


class PoseTask(FrameTask[PoseRun, DepthSource, Methods]):
    """Pose methods over splits."""

    manifest_name, table_name = POSE_MANIFEST, POSES

    def plan(self, config: PoseConfig) -> list[PoseRun]:
        """Method by method, so that each network is loaded once."""
        _protocols(config)
        depths = [depth_choice(text) for text in config.depths]
        restored = [depth.name for depth in depths if depth.is_restored]
        options = options_by_method(config, [*config.methods, *restored])
        for place, depth in enumerate(depths):
            checked_label(depth.label)
            if depth.is_restored:
                depths[place] = replace(depth, options=options[depth.name])
        return [
            PoseRun(
                **frame_options(config, split, method, options),
                depth=depth,
                fit=fit,
                # Of raw depth nothing would change but the name.
                as_input=config.depth_as_input and depth.name != RAW,
            )
            for method, split, depth, fit in product(
                config.methods, config.splits, depths, config.fits
            )
        ]

    def check_data(self, runs: Sequence[PoseRun]) -> None:
        for run in {(r.split, r.root): r for r in runs}.values():
            self.open(run)

    def open(self, run: PoseRun) -> DepthSource:
        return open_split(run.split, run.root)

    def check(self, run: PoseRun, data: DepthSource) -> None:
        """Tell at once where a split has no true poses at all, and not once per frame."""
        for index in run.chosen(data)[:1]:
            load_pose_frame(data, index)

    def make(self, run: PoseRun, device: str) -> Methods:
        options = replace(run.options, device=device, settings=run.settings)
        depth = replace(run.depth, options=replace(run.depth.options, device=device))
        return make_pose_method(run.method, options), DepthProvider(depth, run.split)

    def parts(self, methods: Methods) -> tuple[object, ...]:
        method, depths = methods
        return method, depths.restorer

    def manifest(self, run: PoseRun, data: DepthSource, methods: Methods) -> PoseManifest:
        method, depths = methods
        depth, folder = run.depth.options, run.depth.folder
        setup = PoseSetup(
            **frame_setup(run, data, method) | {"settings": run.settings},
            depth=run.depth.name,
            depth_preset=depth.preset if run.depth.is_restored else "",
            depth_settings=dict(depth.settings),
            depth_weights_sha256=weights_digest(run.depth.name, depths.restorer, depth),
            depth_folder="" if folder is None else str(folder.resolve()),
            as_input=run.as_input,
        )
        return PoseManifest(
            label=run.label,
            depth_label=run.depth_label,
            fit=run.fit,
            setup=setup,
            root=str(run.root),
            weights=str(run.options.weights or ""),
            depth_weights=str(depth.weights or ""),
            **circumstances(),
        )

    def load(self, data: DepthSource, index: int) -> PoseFrame:
        return load_pose_frame(data, index)

    def rows(
        self,
        run: PoseRun,
        data: DepthSource,  # noqa: ARG002
        methods: Methods,
        batch: Batch,
        keys: Sequence[FrameKey],
        loaded: Sequence[PoseFrame | str],
    ) -> list[dict[str, Any]]:
        return estimate_batch(batch, keys, loaded, *methods, as_input=run.as_input)

    def after(self, run: PoseRun) -> None:
        """Pictures of a few frames, unless they are there."""
        from benchmark.evaluation.tasks import pose_pictures as pictures

        there = run.folder / pictures.POSE_GALLERY / pictures.PICTURES_FILE
        if run.gallery and not there.exists():
            pictures.make_pose_pictures(run.folder, self.open(run))

    def read(self, folder: Path, run: PoseRun | None = None) -> PoseResult:  # noqa: ARG002
        return read_pose_run(folder)

    def table(self, results: Sequence[PoseResult], config: PoseConfig) -> str:
        return poses_table(results, _protocols(config))

    def records(self, results: Sequence[PoseResult], config: PoseConfig) -> list[dict[str, Any]]:
        return pose_records(results, _protocols(config))


TASK = PoseTask()


def _protocols(config: PoseConfig) -> list[PoseProtocol]:
    return wanted_protocols(
        config.protocols, iou=config.iou, score=config.score, gates=config.gates
    )


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
    estimated = answers_one_by_one(method.estimate, _check_estimated, views)
    answers |= estimated
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


def _check_estimated(view: PoseView, answer: Estimated) -> None:  # noqa: ARG001
    if not isinstance(answer, Estimated):
        raise ToolkitError("the method must give Estimated", value=type(answer).__name__)
