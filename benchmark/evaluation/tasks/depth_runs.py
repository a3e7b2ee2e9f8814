"""Depth runs from the options of a user, carried out one after the other."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from itertools import product

from benchmark.evaluation.config import DepthConfig, checked_label, data_of, options_by_method
from benchmark.evaluation.engine import UnusableMethod
from benchmark.evaluation.manifest import hardware
from benchmark.evaluation.results import report_failures
from benchmark.evaluation.tasks.depth import Run, chosen_frames, frame_view, run_method, source_of
from benchmark.evaluation.tasks.depth_pictures import FOLDER, INDEX_FILE, make_gallery
from benchmark.evaluation.tasks.depth_results import SPEED, Speed, measure_speed
from benchmark.methods.registry import make_restorer
from benchmark.metrics.protocols.protocol import get_protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from std_toolkit.jobs import JobOptions


def plan_runs(config: DepthConfig) -> list[Run]:
    """The runs, method by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for a method that is not asked for, a split without
            data, or a label that cannot be a folder's name.
    """
    options = options_by_method(config, config.methods)
    return [
        Run(
            split=split,
            root=data_of(split, config.roots),
            method=method,
            options=options[method],
            protocol=protocol,
            label=checked_label(config.label or method.replace(":", ".")),
            out=config.out,
            devices=config.devices,
            batch_size=config.batch_size,
            limit=config.limit,
            save_depth=config.save_depth,
            depth_from=config.depth_from,
        )
        for method, split, protocol in product(config.methods, config.splits, config.protocols)
    ]


@dataclass
class CampaignReport:
    """What became of the runs.

    Attributes:
        finished: the runs that have a table.
        failed: an error line for each of the others.
        failed_frames: frames without a score, over all runs.
    """

    finished: list[Run] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    failed_frames: int = 0


def run_all(
    runs: Sequence[Run],
    jobs: JobOptions | None = None,
    *,
    speed: bool = True,
    gallery: bool = True,
) -> CampaignReport:
    """Run everything; see `run_method`.

    Args:
        runs: in the order that they are to run in.
        jobs: where the work runs.
        speed: also time each method.
        gallery: also keep pictures of a few frames.

    Raises:
        ToolkitError: a split's data are not there, or no such protocol; nothing has run then.
    """
    for run in {(r.split, r.root): r for r in runs}.values():
        source_of(run)  # before anything runs: data that are not there are told once
    for protocol in {run.protocol for run in runs}:
        get_protocol(protocol)
    report = CampaignReport()
    unusable: set[tuple[str, str]] = set()
    for run in runs:
        if (run.method, run.label) in unusable:
            continue
        try:
            table = run_method(run, jobs)
            report.failed_frames += report_failures(table, run.title, run.folder)
            if speed and not (run.folder / SPEED).exists():
                write_document(run.folder / SPEED, speed_of(run))
            if gallery and not (run.folder / FOLDER / INDEX_FILE).exists():
                make_gallery(run)
        except UnusableMethod as error:
            unusable.add((run.method, run.label))
            report.failed[run.label] = str(error)
        except ToolkitError as error:
            report.failed[run.title] = str(error)
        else:
            report.finished.append(run)
    return report


def speed_of(run: Run) -> Speed:
    """Time the method on a frame of the run, in a process of its own, whose memory is its own.

    Raises:
        ToolkitError: no frame can be read, or the method fails on it.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(_speed_here, run).result()
        except BrokenProcessPool as error:
            raise ToolkitError(
                "the process that times the method died (killed, or out of memory)",
                value=run.title,
                hint="--no-speed leaves the timing out",
            ) from error


def _speed_here(run: Run) -> Speed:
    source = source_of(run)
    restorer = make_restorer(run.method, replace(run.options, device=run.devices[0]))
    protocol = get_protocol(run.protocol)
    index = chosen_frames(len(source), 1)[0]
    view = frame_view(source.load(index), restorer, protocol)
    where = hardware()
    on_gpu = run.devices[0].startswith("cuda")
    return measure_speed(restorer, [view], hardware=where["gpus" if on_gpu else "processor"])
