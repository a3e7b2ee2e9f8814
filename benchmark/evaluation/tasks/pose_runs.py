"""Pose runs from the options of a user, carried out one after the other.

Pose protocols as a user asks for them: by name, with single choices changed.

Several runs of poses one after the other; one that cannot run does not keep others from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from benchmark.data.splits import open_split
from benchmark.evaluation.config import PoseConfig, checked_label, data_of, options_by_method
from benchmark.evaluation.engine import UnusableMethod
from benchmark.evaluation.results import report_failures
from benchmark.evaluation.tasks.pose import PoseRun, run_poses
from benchmark.evaluation.tasks.pose_inputs import RAW, TRUE, DepthChoice
from benchmark.evaluation.tasks.pose_pictures import PICTURES_FILE, POSE_GALLERY, make_pose_pictures
from benchmark.methods.registry import MethodOptions, restorers
from benchmark.metrics.pose import BoxIoU, PoseProtocol, PoseScoring, get_pose_protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions

# What both published evaluations ask for before angle and distance count.
FOUND_MEANS_OVERLAP = 0.1


def plan_pose_runs(config: PoseConfig) -> list[PoseRun]:
    """The runs, method by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for what is not asked for, a split without data, a depth
            that nobody knows, or a label that cannot be a folder's name.
    """
    depths = [_depth(text) for text in config.depths]
    restored = [depth.name for depth in depths if depth.is_restored]
    names = [*config.methods, *restored]
    options = options_by_method(config, names)
    chosen = [
        DepthChoice(
            name=depth.name,
            options=options[depth.name] if depth.is_restored else MethodOptions(),
            folder=depth.folder,
        )
        for depth in depths
    ]
    for depth in chosen:
        checked_label(depth.label)
    return [
        PoseRun(
            split=split,
            root=data_of(split, config.roots),
            method=method,
            options=options[method],
            depth=depth,
            label=checked_label(config.label or method.replace(":", ".")),
            out=config.out,
            fit=fit,
            # Of raw depth nothing would change but the name.
            as_input=config.depth_as_input and depth.name != RAW,
            devices=config.devices,
            batch_size=config.batch_size,
            limit=config.limit,
        )
        for method, split, depth, fit in product(config.methods, config.splits, chosen, config.fits)
    ]


def _depth(text: str) -> DepthChoice:
    name, equals, folder = text.partition("=")
    if equals:
        if name in (RAW, TRUE, *restorers.names()) or not name:
            raise ToolkitError(
                "depth in a folder needs a name of its own", field="depth", value=text
            )
        return DepthChoice(name=name, folder=Path(folder))
    return DepthChoice(name=text)


def wanted_protocols(
    names: Sequence[str],
    *,
    iou: str | None = None,
    score: str | None = None,
    gates: str | None = None,
) -> list[PoseProtocol]:
    """Protocols with some of their choices changed, which their names then tell.

    Args:
        names: of `pose_protocols`.
        iou: `oriented`, `aabb` or `nocs2019`, instead of the protocol's own.
        score: `ap` or `accuracy`.
        gates: whether angle and distance count of `all` predictions, or of `found` ones, which
            overlap a true box.

    Raises:
        ToolkitError: no such protocol.

    >>> [p.name for p in wanted_protocols(["strict"], iou="aabb", score="ap")]
    ['strict, iou aabb']
    """
    found = []
    for name in names:
        protocol = get_pose_protocol(name)
        told = [name]
        if iou is not None and BoxIoU(iou) is not protocol.iou:
            protocol = replace(protocol, iou=BoxIoU(iou))
            told.append(f"iou {iou}")
        if score is not None and PoseScoring(score) is not protocol.score:
            protocol = replace(protocol, score=PoseScoring(score))
            told.append(f"score {score}")
        if gates is not None and (gates == "found") != (protocol.pose_needs_iou is not None):
            least = FOUND_MEANS_OVERLAP if gates == "found" else None
            protocol = replace(protocol, pose_needs_iou=least)
            told.append(f"gates {gates}")
        found.append(replace(protocol, name=", ".join(told)))
    return found


@dataclass
class PoseCampaignReport:
    """What became of the runs.

    Attributes:
        finished: the runs that have a table.
        failed: an error line for each of the others.
        failed_frames: frames that could not be read, or at which a method failed, over all runs.
    """

    finished: list[PoseRun] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    failed_frames: int = 0


def run_all_poses(
    runs: Sequence[PoseRun], jobs: JobOptions | None = None, *, gallery: bool = True
) -> PoseCampaignReport:
    """Run everything; see `run_poses`.

    Args:
        runs: in the order that they are to run in.
        jobs: where the work runs.
        gallery: also keep pictures of a few frames.

    Raises:
        ToolkitError: a split's data are not there; nothing has run then.
    """
    for run in {(r.split, r.root): r for r in runs}.values():
        open_split(run.split, run.root)  # before anything runs: told once
    report = PoseCampaignReport()
    unusable: set[tuple[str, str]] = set()
    for run in runs:
        if (run.label, run.depth_label) in unusable:
            continue
        try:
            table = run_poses(run, jobs)
            report.failed_frames += report_failures(table, run.title, run.folder)
            if gallery and not (run.folder / POSE_GALLERY / PICTURES_FILE).exists():
                make_pose_pictures(run)
        except UnusableMethod as error:
            unusable.add((run.label, run.depth_label))
            report.failed[f"{run.label}, {run.depth_label} depth"] = str(error)
        except ToolkitError as error:
            report.failed[run.title] = str(error)
        else:
            report.finished.append(run)
    return report
