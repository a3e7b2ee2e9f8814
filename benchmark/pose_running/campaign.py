"""Several runs of poses one after the other; one that cannot run does not keep others from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmark.data.splits import open_split
from benchmark.pose_running.pictures import PICTURES_FILE, POSE_GALLERY, make_pose_pictures
from benchmark.pose_running.run import PoseRun, run_poses
from benchmark.running.parts import told_failures
from benchmark.running.usable import UnusableMethod
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions


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
            report.failed_frames += told_failures(table, run.title, run.folder)
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
