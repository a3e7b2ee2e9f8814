"""Results of depth runs: reading, averaging over frames, and the table for the terminal."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmark.evaluation import probes
from benchmark.evaluation.manifest import MANIFEST, Manifest
from benchmark.evaluation.results import (
    ERROR,
    FAILED,
    INDEX,
    SCENE,
    TABLE,
    Result,
    check_columns,
    check_rows_once,
    find_runs,
    read_known,
    read_table,
)
from benchmark.evaluation.submission import read_submission
from benchmark.evaluation.tasks.depth_speed import SPEED, Speed, SpeedClass, speed_class
from benchmark.metrics.depth.figures import NAMES, shown_columns
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import mean_interval
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column, text_table
from std_toolkit.io.documents import read_document

GROUPS = ("split", "protocol", "method", "grid", "subset")

OVER_ALL = (*NAMES, "coverage")

_SUBSETS = ("all", "specular+transparent")


OVER_ANSWERED = tuple(f"{name}_answered" for name in NAMES)

_ALL = frozenset((*OVER_ALL, *OVER_ANSWERED))


def summarise(
    rows: pd.DataFrame, *, by: Sequence[str] | None = None, samples: int = 0, seed: int = 0
) -> pd.DataFrame:
    """Compute unweighted means over frames.

    A frame without pixels to compare in a subset is excluded from the means of that subset. A
    frame without any usable prediction is included in all means except those of `..._answered`. A
    method that failed at every frame has no figures: NaN.

    Args:
        rows: a row for each frame, grid and subset with the columns of `Row.as_dict`, and columns
            that identify the run: `split`, `protocol`, `method`, `scene`, `frame`.
        by: columns to group by; by default those of `GROUPS` that exist.
        samples: bootstrap samples of scenes for 95 % intervals, which need the column `scene`; 0
            for none.
        seed: seed of the bootstrap.

    Returns:
        A row for each group in the order of first appearance: the columns `by`; `frames` included;
        `failed` of them, if rows tell errors;
        `frames_empty` without pixels; `frames_unanswered` without a usable prediction among those
        included; `scenes` if rows have them; `pixels`; the means of `OVER_ALL` and
        `OVER_ANSWERED`; with `samples`, `NAME_low` and `NAME_high` of `OVER_ALL`.

    Raises:
        ToolkitError: a column is missing.

    >>> from benchmark.metrics.depth.depth_metrics import depth_errors
    >>> images = [depth_errors(np.full(2, x), np.ones(2)).as_dict() for x in (1.0, 1.5)]
    >>> table = summarise(pd.DataFrame([{"method": "raw", **image} for image in images]))
    >>> table[["method", "frames", "mae"]].to_numpy().tolist()
    [['raw', 2, 0.25]]
    """
    groups = [g for g in GROUPS if g in rows] if by is None else list(by)
    needed = [*groups, "n_pixels", "n_answered", *OVER_ALL, *OVER_ANSWERED]
    needed += ["scene"] if samples else []
    absent = [name for name in needed if name not in rows]
    if absent or not groups:
        raise ToolkitError("rows lack columns", field=", ".join(absent), value=list(rows.columns))
    numbered = rows.groupby(groups, sort=False, dropna=False, observed=True)
    group = numbered.ngroup().to_numpy()
    n_groups = numbered.ngroups
    out = rows[groups].iloc[np.unique(group, return_index=True)[1]].reset_index(drop=True)
    there = rows["n_pixels"].to_numpy() > 0
    answered = rows["n_answered"].to_numpy() > 0
    out["frames"] = np.bincount(group[there], minlength=n_groups)
    out["frames_empty"] = np.bincount(group[~there], minlength=n_groups)
    out["frames_unanswered"] = np.bincount(group[there & ~answered], minlength=n_groups)
    if "scene" in rows:
        scenes = rows["scene"][there].groupby(group[there]).nunique()
        out["scenes"] = scenes.reindex(range(n_groups), fill_value=0).to_numpy()
    out["pixels"] = np.bincount(group, rows["n_pixels"].to_numpy(), n_groups).astype(np.int64)
    for names, enters in ((OVER_ALL, there), (OVER_ANSWERED, answered)):
        n = np.bincount(group[enters], minlength=n_groups)
        for name in names:
            # NaN of an included frame must propagate: the mean of pandas would skip that frame.
            total = np.bincount(group[enters], rows[name].to_numpy()[enters], n_groups)
            with np.errstate(invalid="ignore"):
                out[name] = total / n
    if samples:
        _add_intervals(out, rows[there], group[there], samples, seed)
    if ERROR in rows:
        wrong = there & (rows[ERROR] != "").to_numpy()
        out["failed"] = np.bincount(group[wrong], minlength=n_groups)
        nowhere = (out["failed"] == out["frames"]) & (out["frames"] > 0)
        out.loc[
            nowhere, [c for c in out if c.removesuffix("_low").removesuffix("_high") in _ALL]
        ] = np.nan
    return out


def _add_intervals(
    out: pd.DataFrame, rows: pd.DataFrame, group: np.ndarray, samples: int, seed: int
) -> None:
    ends = np.full((2, len(out), len(OVER_ALL)), np.nan)
    values, scenes = rows[list(OVER_ALL)].to_numpy(), rows["scene"].to_numpy()
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.searchsorted(group[order], np.arange(1, len(out))))
    for i, part in enumerate(parts):
        if len(part):
            found = mean_interval(values[part], scenes[part], samples=samples, seed=seed)
            ends[:, i] = found.low, found.high
    for j, name in enumerate(OVER_ALL):
        out[f"{name}_low"], out[f"{name}_high"] = ends[0, :, j], ends[1, :, j]


def summarise_seen(rows: pd.DataFrame, *, by: Sequence[str] = ("method",)) -> pd.DataFrame:
    """Compute means over frames of what a user sees: harm, holes, colour, trust.

    Args:
        rows: rows of runs, with the columns of `benchmark.evaluation.probes`, which the first row
            of a frame holds.
        by: columns to group by.

    Returns:
        A row for each group: the columns `by` and the means of `probes.NAMES`, each over the
        frames that have the figure; NaN where none has.
    """
    firsts = rows.drop_duplicates([*GROUPS[:3], INDEX])
    names = [name for name in probes.NAMES if name in firsts]
    means = firsts.groupby(list(by), sort=False)[names].mean().reset_index()
    return means.reindex(columns=[*by, *probes.NAMES])


def seen_columns(means: pd.DataFrame) -> list[Column]:
    """Return the columns of `summarise_seen` of which any method has a figure."""
    return [c for c in probes.COLUMNS if means[c.name].notna().any()]


@dataclass(frozen=True, eq=False)
class RunResult(Result[Manifest]):
    """A method on a split by a protocol.

    Its table has the columns `split`, `protocol` and `method` (the label) before those of
    `images.parquet`.

    Attributes:
        speed: measured speed; None if not measured.
    """

    speed: Speed | None

    @property
    def speed_class(self) -> SpeedClass:
        """Class in which the method is ranked."""
        return speed_class(self.speed, self.manifest.setup.device, self.said)

    @property
    def preset(self) -> str:
        """Size of the network; "" of methods without one."""
        setup = self.manifest.setup
        network = self.speed is not None and self.speed.parameters is not None
        return setup.preset if network or setup.weights_sha256 else ""

    @property
    def title(self) -> str:
        protocol = self.manifest.setup.protocol
        return f"{self.manifest.label} on {self.place or self.named} by {protocol}"


def read_run(folder: Path) -> RunResult:
    """Read the results of one run.

    Raises:
        ToolkitError: a file is missing or damaged.
    """
    manifest = read_document(folder / MANIFEST, Manifest)
    table = read_table(folder / TABLE)
    # Runs of 0.1.0 lack some figures, which are then unknown.
    later = [n for n in ("within", "within_answered", *probes.NAMES) if n not in table]
    table = table.reindex(columns=[*table.columns, *later])
    needed = [INDEX, SCENE, ERROR, "grid", "subset", "n_pixels", "n_answered"]
    if "grid" in table and (table["grid"] != "").any():
        needed += [*OVER_ALL, *OVER_ANSWERED, *probes.NAMES]
    check_columns(table, needed, folder / TABLE)
    check_rows_once(table, folder / TABLE)
    names = (manifest.setup.split, manifest.setup.protocol, manifest.label)
    for place, (column, value) in enumerate(
        zip(("split", "protocol", "method"), names, strict=True)
    ):
        table.insert(place, column, value)
    speed = folder / SPEED
    known = read_known(folder)
    result = RunResult(
        folder,
        manifest,
        table,
        read_document(speed, Speed) if speed.exists() else None,
        said=read_submission(folder),
        data=known,
    )
    return result.at(result.named)


def read_results(folders: Iterable[Path]) -> list[RunResult]:
    """Read all finished runs below some folders of results.

    Raises:
        ToolkitError: a folder does not exist or has no finished run, or two runs have the same
            method, split and protocol.
    """
    return find_runs(folders, MANIFEST, TABLE, read_run)


def results_table(results: Sequence[RunResult]) -> str:
    """Format means over frames on the main grid, for all and for specular and transparent objects.

    A protocol with another main subset also shows that subset. Then follows what a user sees.
    """
    blocks = []
    for (split, protocol, grid), means in _means(results):
        shown = "no frame has a pixel to compare" if means.empty else _table(means, protocol)
        blocks.append(f"{split}, protocol {protocol}, {grid}\n{shown}")
        seen = _seen(results, split, protocol)
        if columns := seen_columns(seen):
            blocks.append(
                f"{split}, protocol {protocol}, at the sensor's size\n"
                f"{_text_table(seen, ['method'], columns)}"
            )
    return "\n\n".join(blocks) or "no frame could be scored"


def depth_records(results: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Return the figures of `results_table`, in metres and fractions."""
    records = []
    for (split, protocol, grid), means in _means(results):
        joined = means.merge(_seen(results, split, protocol), on="method", how="left")
        where = {"split": split, "protocol": protocol, "grid": grid}
        records += [{**where, **row} for row in joined.to_dict("records")]
    return records


def _seen(results: Sequence[RunResult], split: str, protocol: str) -> pd.DataFrame:
    rows = pd.concat([result.table for result in results], ignore_index=True)
    rows = rows[(rows["split"] == split) & (rows["protocol"] == protocol) & (rows["grid"] != "")]
    return summarise_seen(rows)


def _means(results: Sequence[RunResult]) -> Iterator[tuple[tuple[str, str, str], pd.DataFrame]]:
    """Yield split, protocol and grid with the means of each method."""
    rows = pd.concat([result.table for result in results], ignore_index=True)
    rows = rows[rows["grid"] != ""]
    for (split, protocol), part in rows.groupby(["split", "protocol"], sort=False):
        grid, first = get_protocol(str(protocol)).main
        means = summarise(part[part["grid"] == grid], by=("method", "subset"))
        means = means[means["subset"].isin((first, *_SUBSETS)) & (means["frames"] > 0)]
        yield (str(split), str(protocol), grid), means


def _table(means: pd.DataFrame, protocol: str) -> str:
    shown = means.rename(columns={"subset": "objects"})
    columns = shown_columns(aligned=bool(get_protocol(protocol).align))
    return _text_table(shown, ["method", "objects", "frames"], columns)


def _text_table(means: pd.DataFrame, names: list[str], columns: Sequence[Column]) -> str:
    shown = means[names].astype(str)
    for column in columns:
        heading = f"{column.heading.replace('δ', 'd')} {column.unit}".rstrip()
        shown[heading] = [column.text(value) or "-" for value in means[column.name]]
    if columns and "failed" in means:
        nowhere = (means["failed"] > 0) & (means["failed"] == means["frames"])
        shown.loc[nowhere.to_numpy(), shown.columns[len(names)]] = FAILED
    return text_table(list(shown.columns), shown.to_numpy().tolist()).terminal()
