"""Folders of results, read back: the rows of all runs, what the runs were, how fast they are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from benchmark.protocols.summary import OVER_ALL, OVER_ANSWERED
from benchmark.running.manifest import MANIFEST, Manifest
from benchmark.running.parts import ERROR, INDEX, SCENE, TABLE, read_table
from benchmark.running.speed import SPEED, Speed
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger


@dataclass(frozen=True)
class RunResult:
    """One run: a method on a split by a protocol.

    Attributes:
        folder: where it lies.
        manifest: what it was.
        table: its rows, with the columns `split`, `protocol` and `method` (the label) before
            those of `images.parquet`.
        speed: None where it was not measured.
    """

    folder: Path
    manifest: Manifest
    table: pd.DataFrame
    speed: Speed | None

    @property
    def missing(self) -> int:
        """Frames that the run has not come to: it was interrupted, or a worker failed."""
        return self.manifest.setup.frames - int(self.table[INDEX].nunique())


def read_run(folder: Path) -> RunResult:
    """One run's results.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    manifest = read_document(folder / MANIFEST, Manifest)
    table = read_table(folder / TABLE)
    needed = [INDEX, SCENE, ERROR, "grid", "subset", "n_pixels", "n_answered"]
    if "grid" in table and (table["grid"] != "").any():
        needed += [*OVER_ALL, *OVER_ANSWERED]
    if absent := [name for name in needed if name not in table]:
        raise ToolkitError("the table lacks columns", path=folder / TABLE, field=", ".join(absent))
    names = (manifest.setup.split, manifest.setup.protocol, manifest.label)
    for place, (column, value) in enumerate(
        zip(("split", "protocol", "method"), names, strict=True)
    ):
        table.insert(place, column, value)
    speed = folder / SPEED
    return RunResult(
        folder, manifest, table, read_document(speed, Speed) if speed.exists() else None
    )


def read_results(folders: Iterable[Path]) -> list[RunResult]:
    """All finished runs below some folders of results.

    Raises:
        ToolkitError: a folder is not there or holds none, or two runs of one method, split and
            protocol are among them.
    """
    found: dict[tuple[str, str, str], RunResult] = {}
    for folder in folders:
        begun = sorted(p.parent for p in folder.rglob(MANIFEST))
        paths = [path for path in begun if (path / TABLE).exists()]
        if not paths:
            problem = "no finished run here" if begun else "no results of std-bench here"
            hint = "run the same std-bench command again to go on" if begun else None
            raise ToolkitError(problem, path=folder, hint=hint)
        for path in begun:
            if path not in paths:
                logger.warning("%s: not finished, left out", path)
        for path in paths:
            result = read_run(path)
            setup = result.manifest.setup
            key = (setup.split, setup.protocol, result.manifest.label)
            if key in found and found[key].folder.resolve() != path.resolve():
                raise ToolkitError(
                    f"{key[2]} on {key[0]} by {key[1]} stands in two folders",
                    path=path,
                    value=str(found[key].folder),
                    hint="give one of them another name with --label",
                )
            found[key] = result
            if result.missing:
                logger.warning(
                    "%s: not finished: %d of %d frames are missing",
                    path, result.missing, setup.frames,
                )  # fmt: skip
    return list(found.values())
