"""Depth restoration as a task: one method over one split by one protocol."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.splits import (
    DepthSource,
    FrameKey,
    WithSavedDepth,
    open_split,
    saved_depth_path,
)
from benchmark.evaluation.config import DepthConfig, options_by_method
from benchmark.evaluation.frames import (
    Batch,
    FrameRun,
    FrameTask,
    frame_options,
    frame_setup,
    restore_views,
)
from benchmark.evaluation.manifest import MANIFEST, Manifest, Setup, circumstances
from benchmark.evaluation.results import ERROR, FRAME, INDEX, NOT_FINITE, SCENE, TABLE, UNREAD
from benchmark.evaluation.tasks.depth_results import (
    RunResult,
    depth_records,
    read_run,
    results_table,
)
from benchmark.methods.depth.filling.filler import Filler, Raw
from benchmark.methods.depth.full_size import restorer_view
from benchmark.methods.protocol import Restored, Restorer
from benchmark.methods.registry import make_restorer
from benchmark.metrics.protocols.protocol import Protocol, get_protocol
from benchmark.metrics.protocols.score import score_frame
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr

Keep = Callable[[FrameKey, Restored], None]


@dataclass(frozen=True, kw_only=True)
class Run(FrameRun):
    """What is scored, by what, how.

    Attributes:
        protocol: name of the scoring protocol.
        save_depth: keep the restored depth, in the data set's own format.
        depth_from: folder of depth saved so, which takes the place of the sensor's.
        speed: also time the method.
    """

    protocol: str
    save_depth: bool = False
    depth_from: Path | None = None
    speed: bool = True

    @property
    def folder(self) -> Path:
        """Where this run's files lie."""
        return self.out / self.split / self.label / self.protocol

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.label} on {self.split}, {self.protocol}"

    @property
    def method_title(self) -> str:
        """What the method is called."""
        return self.label

    def open(self) -> DepthSource:
        """The frames.

        Raises:
            ToolkitError: no such split, or its data is not there.
        """
        source = open_split(self.split, self.root)
        return source if self.depth_from is None else WithSavedDepth(source, self.depth_from)

    def make(self, device: str | None = None) -> Restorer:
        """The restorer, on the first of the devices unless told.

        Raises:
            ToolkitError: it cannot be made.
        """
        return make_restorer(self.method, replace(self.options, device=device or self.devices[0]))


class DepthTask(FrameTask[Run, DepthSource, Restorer]):
    """Restorers over splits."""

    manifest_name, table_name = MANIFEST, TABLE

    def plan(self, config: DepthConfig) -> list[Run]:
        """Method by method, so that each network is loaded once."""
        options = options_by_method(config, config.methods)
        return [
            Run(
                **frame_options(config, split, method, options),
                protocol=protocol,
                save_depth=config.save_depth,
                depth_from=config.depth_from,
                speed=config.speed,
            )
            for method, split, protocol in product(config.methods, config.splits, config.protocols)
        ]

    def check_data(self, runs: Sequence[Run]) -> None:
        for run in {(r.split, r.root): r for r in runs}.values():
            run.open()
        for protocol in {run.protocol for run in runs}:
            get_protocol(protocol)

    def open(self, run: Run) -> DepthSource:
        return run.open()

    def check(self, run: Run, data: DepthSource) -> None:  # noqa: ARG002
        get_protocol(run.protocol)

    def make(self, run: Run, device: str) -> Restorer:
        restorer = run.make(device)
        if run.options.weights is not None and isinstance(restorer, Filler | Raw):
            raise ToolkitError(
                "the method has no weights", field="--weights", value=str(run.options.weights)
            )
        return restorer

    def manifest(self, run: Run, data: DepthSource, methods: Restorer) -> Manifest:
        setup = Setup(
            **frame_setup(run, data, methods),
            protocol=run.protocol,
            depth_from="" if run.depth_from is None else str(run.depth_from.resolve()),
        )
        return Manifest(
            label=run.label,
            setup=setup,
            root=str(run.root),
            weights=str(run.options.weights or ""),
            **circumstances(),
        )

    def load(self, data: DepthSource, index: int) -> DepthFrame:
        return data.load(index)

    def rows(
        self,
        run: Run,
        data: DepthSource,
        methods: Restorer,
        batch: Batch,
        keys: Sequence[FrameKey],
        loaded: Sequence[DepthFrame | str],
    ) -> list[dict[str, Any]]:
        keep = partial(save_depth, run.folder, data.name) if run.save_depth else None
        return score_batch(batch, keys, loaded, methods, get_protocol(run.protocol), keep)

    def after(self, run: Run) -> None:
        """Speed, and pictures of a few frames, unless they are there."""
        if run.speed:
            from benchmark.evaluation.tasks.depth_speed import write_speed

            write_speed(run)
        if run.gallery:
            from benchmark.evaluation.tasks.depth_pictures import FOLDER, INDEX_FILE, make_gallery

            if not (run.folder / FOLDER / INDEX_FILE).exists():
                make_gallery(run)

    def read(self, folder: Path, run: Run | None = None) -> RunResult:  # noqa: ARG002
        return read_run(folder)

    def table(self, results: Sequence[RunResult], config: DepthConfig) -> str:  # noqa: ARG002
        return results_table(results)

    def records(self, results: Sequence[RunResult], config: DepthConfig) -> list[dict[str, Any]]:  # noqa: ARG002
        return depth_records(results)


TASK = DepthTask()


def score_batch(
    indices: Sequence[int],
    keys: Sequence[FrameKey],
    loaded: Sequence[DepthFrame | str],
    restorer: Restorer,
    protocol: Protocol,
    keep: Keep | None = None,
) -> list[dict[str, Any]]:
    """The rows of a batch for the table.

    Args:
        indices: of the frames in the split.
        keys: their scenes and names.
        loaded: the frames, or why there is none.
        restorer: the method.
        protocol: how it is scored.
        keep: is given each frame's key and restored depth, to save it.

    Returns:
        For each frame the rows of the protocol. A frame that cannot be read has one row with a text
        in `error`; one at which the method failed has that text in the rows of an empty answer.
    """
    frames = {i: f for i, f in zip(indices, loaded, strict=True) if isinstance(f, DepthFrame)}
    views = {i: restorer_view(f, restorer, protocol.view_size) for i, f in frames.items()}
    answers = restore_views(restorer, views)
    rows: list[dict[str, Any]] = []
    for index, key, frame in zip(indices, keys, loaded, strict=True):
        base: dict[str, Any] = {INDEX: index, SCENE: key.scene, FRAME: key.name}
        if isinstance(frame, str):
            rows.append({**base, ERROR: frame, **UNREAD})
            continue
        answer = answers[index]
        error = answer if isinstance(answer, str) else ""
        depth = None if isinstance(answer, str) else answer.depth
        base |= {ERROR: error, NOT_FINITE: _not_finite(depth)}
        rows += [base | row.as_dict() for row in score_frame(depth, frame, protocol)]
        if keep is not None and not isinstance(answer, str):
            keep(key, answer)
    return rows


def _not_finite(depth: NDArray[np.float32] | None) -> int:
    return 0 if depth is None else int(depth.size - np.isfinite(depth).sum())


def save_depth(folder: Path, split: str, key: FrameKey, restored: Restored) -> None:
    """Write restored depth as the data set keeps the sensor's: FOLDER/depth/SCENE/NAME + suffix.

    It has the size that the method answered at, three equal channels of float32 metres as the
    public data sets have them, and 0 where there is no answer.

    Raises:
        ToolkitError: the file cannot be written.
    """
    depth = restored.depth
    channel = depth.astype("float32")
    channel[~(channel > 0) | (channel == float("inf"))] = 0.0
    path = saved_depth_path(folder / "depth", split, key)
    write_exr(path, dict.fromkeys("RGB", channel))
