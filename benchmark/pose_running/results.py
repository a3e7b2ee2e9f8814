"""Folders of results, read back: the tables of all runs of poses, and what the runs were."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from benchmark.pose_running.manifest import POSE_MANIFEST, PoseManifest
from benchmark.pose_running.table import COLUMNS, POSES
from benchmark.running.parts import ERROR, INDEX, read_table
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger

# Method, depth and fit of a run, as tables have them.
RunName = tuple[str, str, str]


@dataclass(frozen=True)
class PoseResult:
    """One run: a method on a split with one depth and fit.

    Attributes:
        folder: where it lies.
        manifest: what it was.
        table: see `benchmark.pose_running.table`.
    """

    folder: Path
    manifest: PoseManifest
    table: pd.DataFrame

    @property
    def split(self) -> str:
        return self.manifest.setup.split

    @property
    def name(self) -> RunName:
        """Method, depth and fit."""
        return self.manifest.label, self.manifest.depth_label, self.manifest.fit

    @property
    def failed(self) -> int:
        """Frames that could not be read, or at which the method failed."""
        return int(self.table.loc[self.table[ERROR] != "", INDEX].nunique())

    @property
    def missing(self) -> int:
        """Frames that the run has not come to."""
        return self.manifest.setup.frames - int(self.table[INDEX].nunique())


def read_pose_run(folder: Path) -> PoseResult:
    """One run's results.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    manifest = read_document(folder / POSE_MANIFEST, PoseManifest)
    table = read_table(folder / POSES)
    if absent := [name for name in COLUMNS if name not in table]:
        raise ToolkitError("the table lacks columns", path=folder / POSES, field=", ".join(absent))
    return PoseResult(folder, manifest, table)


def read_pose_results(folders: Iterable[Path]) -> list[PoseResult]:
    """All runs of poses below some folders of results that have a table.

    Raises:
        ToolkitError: a folder holds none, or two runs of one name are among them.
    """
    found: dict[tuple[str, RunName], PoseResult] = {}
    for folder in folders:
        begun = sorted(p.parent for p in folder.rglob(POSE_MANIFEST))
        paths = [path for path in begun if (path / POSES).exists()]
        if not paths:
            raise ToolkitError(
                "no finished run of poses here",
                path=folder,
                hint="run the same std-bench command again to go on",
            )
        for path in begun:
            if path not in paths:
                logger.warning("%s: not finished, left out", path)
        for path in paths:
            result = read_pose_run(path)
            key = (result.split, result.name)
            if key in found and found[key].folder.resolve() != path.resolve():
                raise ToolkitError(
                    f"{', '.join(result.name)} on {result.split} stands in two folders",
                    path=path,
                    value=str(found[key].folder),
                    hint="give one of them another name with --label",
                )
            found[key] = result
            if result.missing:
                logger.warning(
                    "%s: not finished: %d of %d frames are missing",
                    path, result.missing, result.manifest.setup.frames,
                )  # fmt: skip
    return list(found.values())
