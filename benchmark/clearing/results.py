"""Folders of results of table clearing, read back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from benchmark.clearing.manifest import GRASP_MANIFEST, GraspManifest
from benchmark.clearing.precision import PRECISION
from benchmark.clearing.rates import Rates, rates_of
from benchmark.clearing.table import ATTEMPTS, KIND
from benchmark.running.parts import INDEX, read_table
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger

# Camera, seed, planner and depth of a run, as tables have them.
RunName = tuple[str, int, str, str]


@dataclass(frozen=True, eq=False)
class GraspResult:
    """One run.

    Attributes:
        folder: where it lies.
        manifest: what it was.
        table: see `benchmark.clearing.table`.
        rates: what it came to.
    """

    folder: Path
    manifest: GraspManifest
    table: pd.DataFrame
    rates: Rates

    @property
    def name(self) -> RunName:
        setup = self.manifest.setup
        return setup.camera, setup.seed, self.manifest.planner_label, self.manifest.depth_label


def read_grasp_run(folder: Path, *, rounds: int | None = None) -> GraspResult:
    """One run's results.

    Args:
        folder: of the run.
        rounds: only the first so many; None for all that there are.

    Raises:
        ToolkitError: a file is missing or damaged, or no round is finished.
    """
    manifest = read_document(folder / GRASP_MANIFEST, GraspManifest)
    path = folder / ATTEMPTS
    table = read_table(path)
    needed = (INDEX, KIND, "fate", "outcome", "held", "found", *PRECISION)
    if absent := [c for c in needed if c not in table]:
        raise ToolkitError("the table lacks columns", path=path, field=", ".join(absent))
    if rounds is not None:
        table = table[table[INDEX] < rounds]
    if table.empty:
        raise ToolkitError("no round is finished", path=path)
    return GraspResult(folder, manifest, table, rates_of(table))


def read_grasp_results(folders: Iterable[Path]) -> list[GraspResult]:
    """All finished runs of clearing below some folders, in a fixed order.

    Raises:
        ToolkitError: there is none, a run is damaged, or two runs bear one name.
    """
    found: dict[RunName, GraspResult] = {}
    for folder in folders:
        begun = sorted(p.parent for p in folder.rglob(GRASP_MANIFEST))
        finished = [path for path in begun if (path / ATTEMPTS).exists()]
        if not finished:
            raise ToolkitError("no finished run of table clearing here", path=folder)
        for path in begun:
            if path not in finished:
                logger.warning("%s: not finished, left out", path)
        for path in finished:
            result = read_grasp_run(path)
            other = found.get(result.name)
            if other is not None and other.folder.resolve() != path.resolve():
                raise ToolkitError(
                    "two folders hold the same run", path=path, value=str(other.folder)
                )
            found[result.name] = result
    return list(found.values())
