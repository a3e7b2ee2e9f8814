"""The depth restoration task: one method on one split by one protocol."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data import splits
from benchmark.data.dreds_std import LayoutScenes
from benchmark.data.frame import DepthFrame
from benchmark.data.infrared import InfraredSource
from benchmark.data.predictions import (
    DepthFolder,
    WithSavedDepth,
    check_predictions,
    unit_of,
)
from benchmark.data.splits import FrameKey, Inputs
from benchmark.evaluation.batches import Batch
from benchmark.evaluation.config import DepthConfig, options_by_method
from benchmark.evaluation.frames import Base, FrameRun, frame_options, restore_views
from benchmark.evaluation.manifest import MANIFEST, Manifest, Setup, circumstances
from benchmark.evaluation.results import (
    ERROR,
    FRAME,
    INDEX,
    NOT_FINITE,
    SCENE,
    TABLE,
)
from benchmark.evaluation.submission import keep_submission, read_submission
from benchmark.evaluation.task_run import Task
from benchmark.evaluation.tasks import depth_results
from benchmark.evaluation.tasks.depth_clips import (
    clips_left,
    save_depth,
    score_clip,
)
from benchmark.evaluation.tasks.depth_seen import figures_seen, rows_unanswered
from benchmark.evaluation.values import check_folders, folders_by_name
from benchmark.methods.depth.filling.filler import Filler, Raw
from benchmark.methods.depth.full_size import restorer_view
from benchmark.methods.protocol import Restored, Restorer
from benchmark.methods.registry import make_restorer, restorers
from benchmark.methods.training_data import training_data, training_seed
from benchmark.metrics.protocols.alignment import Line
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.protocols.score import score_frame
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger
from std_toolkit.settings import changed


@dataclass(frozen=True, kw_only=True)
class Run(FrameRun[Restorer]):
    """A depth method on a split by a protocol.

    Attributes:
        protocol: name of the scoring protocol.
        save_depth: save the restored depth in the format of the data set.
        depth_from: folder of predicted depth; replaces the sensor depth.
        depth_unit: metres per number of its files; None: by their type.
        speed: also time the method.
        released_loader: batch size of the authors' loader, to read frames as it does; None for all
            frames with their ids.
    """

    manifest_name, table_name = MANIFEST, TABLE
    derived = ("gallery/gallery.json",)
    protocol: str
    save_depth: bool = False
    depth_from: Path | None = None
    depth_unit: float | None = None
    speed: bool = True
    released_loader: int | None = None
    probes: tuple[str, ...] = ()

    @property
    def folder(self) -> Path:
        return self.out / self.split / self.label / self.protocol

    @property
    def title(self) -> str:
        return f"{self.label} on {self.split}, {self.protocol}"

    @property
    def method_title(self) -> str:
        return self.label

    @property
    def data_key(self) -> object:
        return self.split, self.root, self.protocol, self.depth_from

    def check_data(self) -> None:
        self._check_frames(self.open())

    def open(self) -> splits.DepthSource:
        source = super().open()
        if self.released_loader is not None and isinstance(source, LayoutScenes):
            source = replace(source, truncated_ids=True)
        answers = self.answers(source)
        return source if answers is None else WithSavedDepth(source, answers)

    def chosen(self, data: splits.DepthSource) -> list[int]:
        chosen = super().chosen(data)
        return chosen[: len(chosen) // (self.released_loader or 1) * (self.released_loader or 1)]

    @property
    def needs_infrared(self) -> bool:
        """Whether the method asks for the infrared pair."""
        return bool(getattr(restorers.get(self.method), "needs_infrared", False))

    def check(self, data: splits.DepthSource) -> None:
        self._check_frames(data)
        if self.needs_infrared:
            if not isinstance(data, InfraredSource):
                raise ToolkitError(
                    "the method needs the infrared pair, which this split does not have",
                    field="--method", value=f"{self.method} on {self.split}",
                )  # fmt: skip
            data.infrared(self.chosen(data)[0])  # one that is missing fails before any work
        if isinstance(data, WithSavedDepth):
            read_submission(data.answers.folder)
            metric = not get_protocol(self.protocol).align
            told = check_predictions(data, self.chosen(data), metric=metric)
            logger.info("%s: %s of %s", self.title, told, data.answers.folder)

    def _check_frames(self, data: splits.DepthSource) -> None:
        if get_protocol(self.protocol).align and self.probes:
            raise ToolkitError(
                "needs metric depth, and the protocol aligns it",
                field="--probe",
                value=self.protocol,
            )
        if not self.chosen(data):
            raise ToolkitError(
                "the split has fewer frames than a batch",
                field="released_loader",
                value=self.released_loader,
            )

    def make(self, device: str | None = None) -> Restorer:
        """Create the restorer, on the first of `devices` by default.

        Raises:
            ToolkitError: it cannot be created, or weights are given to a method without weights.
        """
        options = replace(self.options, device=device or self.devices[0])
        restorer = make_restorer(self.method, options)
        if options.weights is not None and isinstance(restorer, Filler | Raw):
            raise ToolkitError(
                "the method has no weights", field="--weights", value=str(options.weights)
            )
        return restorer

    def manifest(self, data: splits.DepthSource, methods: Restorer) -> Manifest:
        setup = Setup(
            **self.setup(data, methods),
            protocol=self.protocol,
            depth_from="" if self.depth_from is None else str(self.depth_from.resolve()),
            depth_unit=self.depth_unit or 0.0,
            released_loader=self.released_loader or 0,
            probes=sorted(self.probes),
            limits=changed("benchmark.restoring.restorer.", "benchmark.metrics."),
            backend=getattr(methods, "backend", ""),
        )
        return Manifest(
            label=self.label,
            setup=setup,
            root=str(self.root),
            weights=str(self.options.weights or ""),
            training_data=training_data(self.method, methods, self.options),
            training_seed=training_seed(self.method, methods, self.options),
            **circumstances(),
        )

    def answers(self, data: splits.DepthSource) -> DepthFolder | None:
        if self.depth_from is None:
            return None
        return DepthFolder(self.depth_from, self.split, unit=self.depth_unit, keys=data.keys())

    def inputs(self, data: splits.DepthSource) -> Iterator[tuple[int, FrameKey, Inputs]]:
        for index, key, found in super().inputs(data):
            more = {}
            if self.needs_infrared and isinstance(data, InfraredSource):
                more = data.infrared_files(index)
            yield index, key, {**found, **more}

    def load(self, data: splits.DepthSource, index: int) -> DepthFrame:
        frame = data.load(index)
        if self.needs_infrared and isinstance(data, InfraredSource):
            return replace(frame, infrared=data.infrared(index))
        return frame

    def rows(
        self,
        data: splits.DepthSource,
        methods: Restorer,
        frames: Sequence[tuple[Base, DepthFrame | str]],
    ) -> list[dict[str, Any]]:
        """Return the rows of the protocol for each frame, each a clip of its own.

        The first row of a frame has the figures of `benchmark.evaluation.probes`, too. A frame
        that cannot be read has one row with a text in `error`. A frame at which the method failed,
        or for which there is no saved depth, has that text in the rows of an empty prediction.
        """
        answers = self.restored(methods, frames)
        self.keep(data, frames, answers)
        return self.scored(data, methods, frames, answers)

    def restored(
        self, restorer: Restorer, frames: Sequence[tuple[Base, DepthFrame | str]]
    ) -> dict[int, Restored | str]:
        """Return restored depth by index of the frames that could be read, or error lines."""
        size = get_protocol(self.protocol).view_size
        return restore_views(
            restorer,
            {
                base[INDEX]: restorer_view(frame, restorer, size)
                for base, frame in frames
                if not isinstance(frame, str)
            },
        )

    def keep(
        self,
        data: splits.DepthSource,
        frames: Sequence[tuple[Base, DepthFrame | str]],
        answers: Mapping[int, Restored | str],
    ) -> None:
        """Save restored depth, if it is wanted."""
        for base, _ in frames:
            answer = answers.get(base[INDEX])
            if self.save_depth and isinstance(answer, Restored):
                key = splits.FrameKey(base[SCENE], base[FRAME])
                save_depth(self.folder, data.name, key, answer)

    def scored(
        self,
        data: splits.DepthSource,
        methods: Restorer,
        frames: Sequence[tuple[Base, DepthFrame | str]],
        answers: Mapping[int, Restored | str],
        line: Line | None = None,
    ) -> list[dict[str, Any]]:
        """Return the rows of frames, given the answers; `line` aligns those of a clip."""
        protocol = get_protocol(self.protocol)
        there = {b[INDEX]: frame for b, frame in frames if not isinstance(frame, str)}
        seen = figures_seen(data, self.chosen(data), methods, there, answers, protocol, self.probes)
        rows: list[dict[str, Any]] = []
        for base, frame in frames:
            if isinstance(frame, str):
                found = rows_unanswered(data, base[INDEX], methods, frame, protocol)
                rows += [base | {ERROR: frame} | row for row in found]
                continue
            answer = answers[base[INDEX]]
            error, depth = (answer, None) if isinstance(answer, str) else ("", answer.depth)
            status = {ERROR: error, NOT_FINITE: _not_finite(depth)}
            found = [
                base | status | row.as_dict() for row in score_frame(depth, frame, protocol, line)
            ]
            found[0] |= seen[base[INDEX]]
            rows += found
        return rows

    def items(
        self, data: splits.DepthSource, done: set[int], workers: int
    ) -> list[tuple[Batch, ...]]:
        if get_protocol(self.protocol).align != "clip":
            return super().items(data, done, workers)
        return clips_left(data.keys(), self.chosen(data), self.batch_size, done)

    def work(self, data: splits.DepthSource, methods: Restorer, item: Sequence[Batch]) -> int:
        if get_protocol(self.protocol).align != "clip":
            return super().work(data, methods, item)
        return score_clip(self, data, methods, item)

    def after(self) -> None:
        """Measure speed and save pictures of a few frames, unless they exist; keep what the author
        of predictions says of them."""
        keep_submission(self.depth_from, self.folder)
        if self.speed:
            from benchmark.evaluation.tasks.depth_speed import write_speed

            write_speed(self, self.protocol)
        if self.gallery and not get_protocol(self.protocol).align:
            from benchmark.evaluation.tasks.depth_pictures import make_gallery, shows

            if not shows(self.folder, self.gallery_frames):
                make_gallery(self, self.protocol)

    def read(self) -> depth_results.RunResult:
        return depth_results.read_run(self.folder)


_OF_CONFIG = ("save_depth", "speed", "released_loader", "probes")


def plan_runs(config: DepthConfig) -> list[Run]:
    """Return the runs, grouped by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for a method that is not requested, a split without
            data, two methods of one name, no unit, or a label that cannot be the name of a folder.
    """
    folders = folders_by_name(config.methods, restorers.names())
    if folders and (config.probes or config.depth_from is not None):
        option = "--probe" if config.probes else "--depth-from"
        raise ToolkitError(
            "needs methods that run, and these are predictions in a folder",
            field=option,
            value=next(iter(folders)),
        )
    names = list(dict.fromkeys("raw" if m in folders else m for m in config.methods))
    options = options_by_method(config, names)
    units = units_by_name(config.depth_units, [name for name, _ in folders.values()])
    runs = []
    for method, split, protocol in product(config.methods, config.splits, config.protocols):
        name, folder = folders.get(method, ("", config.depth_from))
        known = frame_options(config, split, "raw" if name else method, options)
        known |= {k: getattr(config, k) for k in _OF_CONFIG}
        if name:  # nothing is timed where only files are read
            known |= {"label": name, "speed": False}
        unit = units.get(name)
        runs.append(Run(**known, protocol=protocol, depth_from=folder, depth_unit=unit))
    check_folders([run.folder for run in runs], [run.label for run in runs])
    return runs


def units_by_name(texts: Sequence[str], names: Sequence[str]) -> dict[str, float]:
    """Return metres per number by name of the predictions; "" is that of `--depth-from`.

    Args:
        texts: `NAME=UNIT`, or `UNIT` for all.
        names: of all predictions in folders.

    Raises:
        ToolkitError: no unit, or the name of none of them.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, equals, unit = text.rpartition("=")
        if equals and name not in names:
            raise ToolkitError(
                "names no predictions", field="--depth-unit", value=text, hint=", ".join(names)
            )
        found |= dict.fromkeys([name] if equals else ["", *names], unit_of(unit))
    return found


TASK = Task(
    plan=plan_runs,
    table=lambda results, _: depth_results.results_table(results),
    records=lambda results, _: depth_results.depth_records(results),
)


def _not_finite(depth: NDArray[np.float32] | None) -> int:
    return 0 if depth is None else int(depth.size - np.isfinite(depth).sum())
