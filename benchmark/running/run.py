"""One method over one split by one protocol: in batches, resumable, over many workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.data.saved import WithSavedDepth
from benchmark.data.source import DepthSource, names_digest
from benchmark.data.splits import open_split
from benchmark.methods.filling.filler import Filler
from benchmark.methods.filling.raw import Raw
from benchmark.methods.protocol import Restorer
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.protocols.registry import get_protocol
from benchmark.running.batch import Loaded, load_frames, score_batch
from benchmark.running.device import claim_device
from benchmark.running.growing import complete, told_frames
from benchmark.running.manifest import Setup, manifest_of
from benchmark.running.pieces import Batch, chosen_frames, pieces_left, write_rows
from benchmark.running.saving import save_depth
from benchmark.running.usable import making_methods, weights_digest
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions


@dataclass(frozen=True, kw_only=True)
class Run:
    """What is scored, by what, how.

    Attributes:
        split, root: name of the split and folder of the data.
        method, options: the restorer; `options.device` is ignored in favour of `devices`.
        devices: torch devices, of which each worker takes one.
        protocol: name of the scoring protocol.
        label: what the method is called in tables.
        out: folder of results.
        batch_size: frames that go through the method together.
        limit: of frames, evenly spread over the split; None for all.
        save_depth: keep the restored depth, in the data set's own format.
        depth_from: folder of depth saved so, which takes the place of the sensor's.
    """

    split: str
    root: Path
    method: str
    options: MethodOptions
    protocol: str
    label: str
    out: Path
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 8
    limit: int | None = None
    save_depth: bool = False
    depth_from: Path | None = None

    @property
    def folder(self) -> Path:
        """Where this run's files lie."""
        return self.out / self.split / self.label / self.protocol

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.label} on {self.split}, {self.protocol}"


def run_method(run: Run, jobs: JobOptions | None = None) -> pd.DataFrame:
    """Score what has not been scored yet.

    Frames are numbered by their place in the split, and batches by their frames: whatever is
    interrupted, killed or spread over machines, the table is the same in the end.

    Returns:
        One row per frame, grid and subset, as in `images.parquet`; frames that failed have a
        text in `error`.

    Raises:
        ToolkitError: data, method, weights or protocol cannot be used, or another run was begun
            in this folder.
    """
    jobs = jobs or JobOptions()
    source = source_of(run)
    chosen = chosen_frames(len(source), run.limit)
    get_protocol(run.protocol)
    # Once and at once, and not first in every worker: a wrong option is told in one line.
    restorer = _usable(run)
    manifest = manifest_of(
        _setup(run, source, restorer, chosen),
        label=run.label,
        root=run.root,
        weights=run.options.weights,
    )
    if jobs.workers is None and hasattr(restorer, "network"):
        # A network uses all of a device; a second process would only double its memory.
        jobs = replace(jobs, workers=len(run.devices))
    del restorer
    lacking = partial(pieces_left, chosen, run.batch_size, jobs.worker_count)
    return complete(
        run.folder, manifest, lacking, _Worker(run),
        title=run.title, key=told_frames, jobs=jobs, unit="pieces of work",
    )  # fmt: skip


def _usable(run: Run) -> Restorer:
    with making_methods(run.devices):
        restorer = make_restorer(run.method, replace(run.options, device=run.devices[0]))
        if run.options.weights is not None and isinstance(restorer, Filler | Raw):
            raise ToolkitError(
                "the method has no weights", field="--weights", value=str(run.options.weights)
            )
        return restorer


def source_of(run: Run) -> DepthSource:
    """The frames of a run.

    Raises:
        ToolkitError: no such split, or its data is not there.
    """
    source = open_split(run.split, run.root)
    return source if run.depth_from is None else WithSavedDepth(source, run.depth_from)


class _Worker:
    """Scores batches in a worker process, which keeps data set and network from item to item."""

    def __init__(self, run: Run) -> None:
        self.run = run

    def __call__(self, batches: Sequence[Batch]) -> int:
        source, restorer = _equipment(self.run)
        protocol = get_protocol(self.run.protocol)
        keys = source.keys()
        keep = partial(save_depth, self.run.folder, source.name) if self.run.save_depth else None

        def rows_of(batch: Batch, loaded: list[Loaded]) -> list[dict[str, Any]]:
            named = [keys[i] for i in batch]
            return score_batch(batch, named, loaded, restorer, protocol, keep)

        return write_rows(self.run.folder, batches, partial(load_frames, source), rows_of)


_kept: dict[str, tuple[DepthSource, Restorer]] = {}


def _equipment(run: Run) -> tuple[DepthSource, Restorer]:
    """Data set and method of this process; those of an earlier run make room."""
    key = repr(run)
    if key not in _kept:
        _kept.clear()
        device = claim_device(run.devices, run.folder / ".devices")
        restorer = make_restorer(run.method, replace(run.options, device=device))
        _kept[key] = (source_of(run), restorer)
    return _kept[key]


def _setup(run: Run, source: DepthSource, restorer: Restorer, chosen: Sequence[int]) -> Setup:
    keys = source.keys()
    return Setup(
        split=run.split,
        frames=len(chosen),
        frames_sha256=names_digest(keys[i] for i in chosen),
        method=run.method,
        preset=run.options.preset,
        settings=dict(run.options.settings),
        weights_sha256=weights_digest(run.method, restorer, run.options),
        precision=run.options.precision,
        compile=run.options.compile,
        device=run.devices[0].partition(":")[0],
        protocol=run.protocol,
        batch_size=run.batch_size,
        depth_from="" if run.depth_from is None else str(run.depth_from.resolve()),
    )
