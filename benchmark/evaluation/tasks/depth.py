"""Depth restoration as a task: one method over one split by one protocol.

Restored depth kept on disk, for pose and grasping, and to be scored again.

Frames through a method and its scoring; a frame that cannot be scored is told, not fatal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame
from benchmark.data.splits import (
    DepthSource,
    FrameKey,
    WithSavedDepth,
    names_digest,
    open_split,
    saved_depth_path,
)
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
from benchmark.evaluation.manifest import Setup, manifest_of
from benchmark.evaluation.results import ERROR, FRAME, INDEX, NOT_FINITE, SCENE, UNREAD
from benchmark.methods.depth.filling.filler import Filler, Raw
from benchmark.methods.depth.full_size import view_of
from benchmark.methods.protocol import Restored, Restorer, View
from benchmark.methods.registry import MethodOptions, make_restorer
from benchmark.metrics.protocols.protocol import Protocol, get_protocol
from benchmark.metrics.protocols.score import score_frame
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import write_exr
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.options import error_of

Loaded = DepthFrame | str  # the frame, or why there is none

Keep = Callable[[FrameKey, Restored], None]


def load_frames(source: DepthSource, indices: Sequence[int], *, nocs: bool = False) -> list[Loaded]:
    """The frames of a batch; for one that cannot be read, the error as one line."""
    loaded: list[Loaded] = []
    for index in indices:
        try:
            loaded.append(source.load(index, nocs=nocs))
        except Exception as error:  # a damaged file can raise anything in the libraries below
            loaded.append(error_line(error))
    return loaded


def score_batch(
    indices: Sequence[int],
    keys: Sequence[FrameKey],
    loaded: Sequence[Loaded],
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
    views = {i: frame_view(f, restorer, protocol) for i, f in frames.items()}
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


def frame_view(frame: DepthFrame, restorer: Restorer, protocol: Protocol) -> View:
    """What a method sees of a frame under a protocol."""
    return view_of(
        frame,
        restorer.input_size or protocol.view_size,
        with_mask=restorer.needs_mask,
        # Where the protocol makes the views, it makes them as the released evaluation does.
        color_nearest=protocol.view_size is not None,
    )


def restore_views(restorer: Restorer, views: dict[int, View]) -> dict[int, Restored | str]:
    """Answers by index, or why there is none.

    If the batch fails as a whole, its frames are tried one by one.
    """
    if not views:
        return {}
    try:
        return dict(zip(views, _checked(restorer, list(views.values())), strict=True))
    except (KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:
        if len(views) == 1:
            return {next(iter(views)): error_line(error)}
    found: dict[int, Restored | str] = {}
    for index, view in views.items():
        found |= restore_views(restorer, {index: view})
    return found


def _checked(restorer: Restorer, views: list[View]) -> list[Restored]:
    answers = restorer.restore(views)
    if len(answers) != len(views):
        raise ToolkitError(f"the method gave {len(answers)} answers to {len(views)} views")
    for view, answer in zip(views, answers, strict=True):
        if not isinstance(answer, Restored):
            raise ToolkitError("the method must give Restored(depth)", value=type(answer).__name__)
        if answer.depth.shape != view.depth.shape:
            raise ToolkitError(
                f"the method was given a view of {view.depth.shape}",
                field="Restored.depth",
                value=answer.depth.shape,
            )
    return answers


def error_line(error: Exception) -> str:
    """An error as one line."""
    return error_of(error).error or type(error).__name__


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
    remaining = partial(pieces_left, chosen, run.batch_size, jobs.worker_count)
    return complete(
        run.folder, manifest, remaining, _Worker(run),
        title=run.title, key=describe_frames, jobs=jobs, unit="pieces of work",
    )  # fmt: skip


def _usable(run: Run) -> Restorer:
    with as_unusable_method(run.devices):
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
