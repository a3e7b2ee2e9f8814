"""Kinds of runs: their files, and how they are read. `verify` and the site know no others."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.evaluation.manifest import (
    BOP_MANIFEST,
    DUMP_MANIFEST,
    GRASP_MANIFEST,
    MANIFEST,
    ORDER_MANIFEST,
    POSE_MANIFEST,
)
from benchmark.evaluation.results import TABLE, finished_folders
from benchmark.evaluation.tasks import bop_results, depth_results, grasp_results, pose_results
from benchmark.evaluation.tasks.grasp_dump import PRECISIONS, read_dump_run
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS
from benchmark.evaluation.tasks.order_run import ORDERS, read_order_run
from benchmark.evaluation.tasks.pose_table import POSES
from benchmark.evaluation.verification import run_digest


@dataclass(frozen=True)
class RunKind:
    """A kind of run.

    Attributes:
        manifest, table: its files.
        read: returns the result of a folder.
    """

    manifest: str
    table: str
    read: Callable[[Path], Any]

    def folders(self, top: Path) -> list[Path]:
        """Folders of finished runs below a folder of results; others are named."""
        return finished_folders(top, self.manifest, self.table)

    def digest(self, folder: Path) -> str:
        """See `run_digest`."""
        return run_digest(folder, self.manifest, self.table)


DEPTH = RunKind(MANIFEST, TABLE, depth_results.read_run)
POSE = RunKind(POSE_MANIFEST, POSES, pose_results.read_pose_run)
GRASP = RunKind(GRASP_MANIFEST, ATTEMPTS, grasp_results.read_grasp_run)
DUMP = RunKind(DUMP_MANIFEST, PRECISIONS, read_dump_run)
ORDER = RunKind(ORDER_MANIFEST, ORDERS, read_order_run)
BOP = RunKind(BOP_MANIFEST, bop_results.ERRORS, bop_results.read_bop_run)
KINDS = (DEPTH, POSE, GRASP, DUMP, ORDER, BOP)
