"""Instance-level pose as a task: figures of result files in BOP's format."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from benchmark.metrics.bop import BopDataset, read_bop_results, score_bop
from std_toolkit.html.table import text_table
from std_toolkit.io.documents import read_document, write_document

FOLDER, FILE = "bop", "bop.json"


class BopResult(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One result file.

    Attributes:
        results: name of the file.
        data, split: folder of the data set, and of its scenes.
        targets: instances to be found.
        estimates: lines of the file.
        ar: mean of the three average recalls, shares.
        ar_vsd, ar_mssd, ar_mspd: each of them.
        seconds_per_image: that the method took; None where the file does not tell.
    """

    results: str
    data: str
    split: str
    targets: int
    estimates: int
    ar: float
    ar_vsd: float
    ar_mssd: float
    ar_mspd: float
    seconds_per_image: float | None


def bop_result(dataset: BopDataset, path: Path, *, data: str, split: str) -> BopResult:
    """Score a result file.

    Args:
        dataset: with the true poses.
        path: CSV in BOP's format.
        data, split: as in `BopResult`.

    Raises:
        ToolkitError: the file cannot be read, or does not fit the data set.
    """
    estimates = read_bop_results(path)
    scores = score_bop(dataset, estimates)
    return BopResult(
        results=path.stem,
        data=data,
        split=split,
        targets=sum(target.inst_count for target in dataset.targets),
        estimates=len(estimates),
        ar=scores.ar,
        ar_vsd=scores.vsd,
        ar_mssd=scores.mssd,
        ar_mspd=scores.mspd,
        seconds_per_image=scores.seconds_per_image,
    )


def write_bop_result(out: Path, result: BopResult) -> None:
    """Keep figures below a folder of results.

    Raises:
        ToolkitError: the file cannot be written.
    """
    folder = out / FOLDER / Path(result.data).resolve().name / result.split / result.results
    folder.mkdir(parents=True, exist_ok=True)
    write_document(folder / FILE, result)


def read_bop_figures(folders: Iterable[Path]) -> list[BopResult]:
    """All figures below some folders of results.

    Raises:
        ToolkitError: a file is damaged.
    """
    paths = sorted(path for folder in folders for path in folder.rglob(FILE))
    return [read_document(path, BopResult) for path in dict.fromkeys(paths)]


def bop_table(results: Sequence[BopResult]) -> str:
    """Figures in percent, for a terminal."""
    heads = ("results", "data", "targets", "AR", "VSD", "MSSD", "MSPD", "s/image")
    lines = []
    for r in results:
        shares = [f"{100 * x:.1f}" for x in (r.ar, r.ar_vsd, r.ar_mssd, r.ar_mspd)]
        seconds = "" if r.seconds_per_image is None else f"{r.seconds_per_image:.2f}"
        data = f"{Path(r.data).name}, {r.split}"
        lines.append([r.results, data, str(r.targets), *shares, seconds])
    return text_table(heads, lines).terminal()
