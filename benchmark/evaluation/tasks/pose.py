"""The category-level pose task: one method on one split with one depth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, resize_nearest
from benchmark.data.prediction_files import FrameFiles
from benchmark.data.predictions import DepthFolder
from benchmark.data.splits import DepthSource, FrameKey
from benchmark.data.true_poses import KnownBox, TruePose, known_boxes, true_poses
from benchmark.evaluation.config import AS_FILED, PoseConfig, options_by_method
from benchmark.evaluation.depth_choice import (
    RAW,
    DepthChoice,
    DepthProvider,
    depth_choice,
)
from benchmark.evaluation.frames import (
    Base,
    FrameRun,
    answers_one_by_one,
    error_line,
    frame_options,
)
from benchmark.evaluation.manifest import POSE_MANIFEST, PoseManifest, PoseSetup, circumstances
from benchmark.evaluation.pose_predictions import PoseFolder, check_poses
from benchmark.evaluation.results import ERROR, INDEX
from benchmark.evaluation.submission import keep_submission, read_submission
from benchmark.evaluation.task_run import Task
from benchmark.evaluation.tasks import pose_results, pose_table
from benchmark.evaluation.values import check_folders, checked_label, folders_by_name
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.protocol import Estimated, PoseAnswer, PoseEstimator, PoseView
from benchmark.methods.registry import MethodOptions, make_pose_method, pose_methods
from benchmark.methods.training_data import training_data, training_seed
from benchmark.metrics.pose import PoseProtocol
from std_toolkit.errors import ToolkitError

POSE_FOLDER = "pose"

AS_INPUT = "as-input"

# Without a method where poses lie in a folder.
Methods = tuple[PoseEstimator | None, DepthProvider]


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


@dataclass(frozen=True, kw_only=True)
class PoseRun(FrameRun[Methods]):
    """A pose method on a split with one depth and fit.

    Attributes:
        depth: depth that poses are fitted to; `as-filed` for poses in its folder.
        fit: fitting method, `ransac` or `paper`, or `as-filed`.
        as_input: networks also receive that depth instead of raw depth.
    """

    manifest_name, table_name = POSE_MANIFEST, pose_table.POSES
    derived = ("gallery/pictures.json",)
    needs_nocs = True
    depth: DepthChoice
    fit: str = "ransac"
    as_input: bool = False

    @property
    def is_filed(self) -> bool:
        """Whether the poses lie in a folder."""
        return self.depth.name == AS_FILED

    @property
    def depth_label(self) -> str:
        """Name of the depth in folders and tables."""
        return f"{self.depth.label}-{AS_INPUT}" if self.as_input else self.depth.label

    @property
    def folder(self) -> Path:
        return self.out / POSE_FOLDER / self.split / self.label / self.depth_label / self.fit

    @property
    def title(self) -> str:
        return f"{self.label} on {self.split}, {self.depth_label} depth, fit {self.fit}"

    @property
    def method_title(self) -> str:
        return f"{self.label}, {self.depth_label} depth"

    @property
    def settings(self) -> dict[str, str]:
        """Settings of the method, including the fit."""
        if self.is_filed:
            return {}
        return {**self.options.settings, "fit": self.fit}

    def check(self, data: DepthSource) -> None:
        """Raise one error for a split without true poses, instead of one per frame."""
        chosen = self.chosen(data)
        for index in chosen[:1]:
            load_pose_frame(data, index)
        if self.is_filed and isinstance(answers := self.answers(data), PoseFolder):
            keys = data.keys()
            check_poses(answers, [keys[index] for index in chosen])
            read_submission(answers.folder)

    def make(self, device: str) -> Methods:
        if self.is_filed:
            return None, DepthProvider(self.depth, self.split)
        options = replace(self.options, device=device, settings=self.settings)
        depth = replace(self.depth, options=replace(self.depth.options, device=device))
        return make_pose_method(self.method, options), DepthProvider(depth, self.split)

    def parts(self, methods: Methods) -> tuple[object, ...]:
        method, depths = methods
        return method, depths.restorer

    def manifest(self, data: DepthSource, methods: Methods) -> PoseManifest:
        method, depths = methods
        setup = PoseSetup(
            **self.setup(data, method) | {"settings": self.settings},
            **depths.setup(),
            as_input=self.as_input,
            given_truth=method is not None and bool(method.needs_truth),
        )
        return PoseManifest(
            label=self.label,
            depth_label=self.depth_label,
            fit=self.fit,
            setup=setup,
            root=str(self.root),
            weights=str(self.options.weights or ""),
            depth_weights=str(self.depth.options.weights or ""),
            training_data=training_data(self.method, method, self.options),
            training_seed=training_seed(self.method, method, self.options),
            depth_training_seed=depths.training_seed,
            depth_training_data=depths.training_data,
            **circumstances(),
        )

    def answers(self, data: DepthSource) -> FrameFiles | None:
        folder, kind = self.depth.folder, PoseFolder if self.is_filed else DepthFolder
        return None if folder is None else kind(folder, self.split, data.keys())

    def load(self, data: DepthSource, index: int) -> PoseFrame:
        return load_pose_frame(data, index)

    def rows(
        self,
        data: DepthSource,
        methods: Methods,
        frames: Sequence[tuple[Base, PoseFrame | str]],
    ) -> list[dict[str, Any]]:
        there = {b[INDEX]: frame for b, frame in frames if not isinstance(frame, str)}
        method, depths = methods
        if method is None:
            answers = _filed(self.answers(data), there)
        else:
            answers = self._estimated(method, depths, there)
        rows: list[dict[str, Any]] = []
        for base, loaded in frames:
            if isinstance(loaded, str):
                rows += pose_table.rows_of_frame(
                    base | {ERROR: loaded, pose_table.READ: False}, (), None
                )
                continue
            answer = answers[base[INDEX]]
            error, found = (answer, None) if isinstance(answer, str) else ("", answer.prediction)
            rows += pose_table.rows_of_frame(
                base | {ERROR: error, pose_table.READ: True}, loaded.truths, found
            )
        return rows

    def _estimated(
        self, method: PoseEstimator, depths: DepthProvider, there: Mapping[int, PoseFrame]
    ) -> dict[int, Estimated | str]:
        """Poses by index, or error lines."""
        answers: dict[int, Estimated | str] = {}
        views: dict[int, PoseView] = {}
        for index, depth in depths.depths({i: f.frame for i, f in there.items()}).items():
            if isinstance(depth, str):
                answers[index] = depth
                continue
            frame, boxes = there[index].frame, there[index].boxes
            sensor = depth if self.as_input else None
            views[index] = pose_view(frame, depth, method, boxes=boxes, sensor=sensor)
        return answers | answers_one_by_one(method.estimate, _check_estimated, views)

    def after(self) -> None:
        """Keep what the author of poses says of them; save pictures of a few frames."""
        keep_submission(self.depth.folder if self.is_filed else None, self.folder)
        from benchmark.evaluation.tasks import pose_pictures as pictures

        there = self.folder / pictures.POSE_GALLERY / pictures.PICTURES_FILE
        if self.gallery and not there.exists():
            data = self.open()
            pictures.make_pose_pictures(self.folder, data, self.pictured(data))

    def read(self) -> pose_results.PoseResult:
        return pose_results.read_pose_run(self.folder)


def plan_runs(config: PoseConfig) -> list[PoseRun]:
    """Return the runs, grouped by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for a method that is not requested, a split without data,
            an unknown depth, or a label that cannot be the name of a folder.
    """
    _protocols(config)
    folders = folders_by_name(config.methods, pose_methods.names())
    methods = [name for name in config.methods if name not in folders]
    depths = [depth_choice(text) for text in config.depths]
    restored = [depth.name for depth in depths if depth.is_restored]
    options = options_by_method(config, [*methods, *restored])
    for place, depth in enumerate(depths):
        checked_label(depth.label)
        if depth.is_restored:
            depths[place] = replace(depth, options=options[depth.name])
    runs = [
        PoseRun(
            **frame_options(config, split, method, options),
            depth=depth,
            fit=fit,
            # For raw depth the option would change only the name.
            as_input=config.depth_as_input and depth.name != RAW,
        )
        for method, split, depth, fit in product(methods, config.splits, depths, config.fits)
    ]
    for (label, folder), split in product(folders.values(), config.splits):
        # No depth and no fit of ours is in these poses.
        known = frame_options(config, split, AS_FILED, {AS_FILED: MethodOptions(preset="")})
        depth = DepthChoice(name=AS_FILED, folder=folder)
        runs.append(PoseRun(**{**known, "label": label, "depth": depth, "fit": AS_FILED}))
    check_folders([run.folder for run in runs], [run.label for run in runs])
    return runs


def _filed(
    folder: FrameFiles | None, frames: Mapping[int, PoseFrame]
) -> dict[int, Estimated | str]:
    """Poses of a folder by index, or error lines."""
    assert isinstance(folder, PoseFolder)
    found: dict[int, Estimated | str] = {}
    for index, loaded in frames.items():
        try:
            found[index] = Estimated(folder.read(FrameKey(loaded.frame.scene, loaded.frame.name)))
        except ToolkitError as error:
            found[index] = error_line(error)
    return found


def _protocols(config: PoseConfig) -> list[PoseProtocol]:
    return pose_results.wanted_protocols(
        config.protocols, iou=config.iou, score=config.score, gates=config.gates
    )


TASK = Task(
    plan=plan_runs,
    table=lambda results, config: pose_results.poses_table(results, _protocols(config)),
    records=lambda results, config: pose_results.pose_records(results, _protocols(config)),
)


def _check_estimated(view: PoseView, answer: Estimated) -> None:  # noqa: ARG001
    if not isinstance(answer, Estimated):
        raise ToolkitError("the method must give Estimated", value=type(answer).__name__)
