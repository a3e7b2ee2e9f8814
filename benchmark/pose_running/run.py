"""One pose method over one split with one depth: in batches, resumable, over many workers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.data.source import DepthSource, names_digest
from benchmark.data.splits import open_split
from benchmark.methods.registry import MethodOptions
from benchmark.pose_methods.protocol import PoseEstimator
from benchmark.pose_methods.registry import make_pose_method
from benchmark.pose_running.batch import (
    PoseFrame,
    estimate_batch,
    load_pose_frame,
    load_pose_frames,
)
from benchmark.pose_running.depths import DepthChoice, DepthGiver
from benchmark.pose_running.manifest import POSE_MANIFEST, PoseSetup, pose_manifest
from benchmark.pose_running.table import POSES
from benchmark.running.device import claim_device
from benchmark.running.growing import complete, told_frames
from benchmark.running.pieces import Batch, chosen_frames, pieces_left, write_rows
from benchmark.running.usable import making_methods, weights_digest
from std_toolkit.jobs import JobOptions

POSE_FOLDER = "pose"
AS_INPUT = "as-input"


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
        The rows of `benchmark.pose_running.table`; frames that failed have a text in `error`.

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
    lacking = partial(pieces_left, chosen, run.batch_size, jobs.worker_count)
    return complete(
        run.folder, manifest, lacking, _Worker(run),
        title=run.title, key=told_frames, jobs=jobs, unit="pieces of work",
        table=POSES, manifest_name=POSE_MANIFEST,
    )  # fmt: skip


def _check_truth(source: DepthSource, chosen: Sequence[int]) -> None:
    """Tell at once where a split has no true poses at all, and not once per frame."""
    for index in chosen[:1]:
        load_pose_frame(source, index)


def _usable(run: PoseRun) -> tuple[PoseEstimator, DepthGiver]:
    with making_methods(run.devices):
        return _make(run, run.devices[0])


def _make(run: PoseRun, device: str) -> tuple[PoseEstimator, DepthGiver]:
    method = make_pose_method(
        run.method, replace(run.options, device=device, settings=run.settings)
    )
    options = replace(run.depth.options, device=device)
    return method, DepthGiver(replace(run.depth, options=options), run.split)


def _has_network(method: PoseEstimator, depths: DepthGiver) -> bool:
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


_kept: dict[str, tuple[DepthSource, PoseEstimator, DepthGiver]] = {}


def _equipment(run: PoseRun) -> tuple[DepthSource, PoseEstimator, DepthGiver]:
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
    depths: DepthGiver,
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
