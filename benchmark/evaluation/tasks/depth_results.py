"""Results of depth runs: read back, averaged, shown; speed of methods.

Tables of means over frames.

The results of a few runs as a table in the terminal.

How fast a method is, and what it costs: warm, on frames of the split it is scored on.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from benchmark.evaluation.manifest import MANIFEST, Manifest
from benchmark.evaluation.results import ERROR, INDEX, SCENE, TABLE, aligned, read_table
from benchmark.methods.protocol import Restorer, View
from benchmark.metrics.depth.tally import NAMES
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import mean_interval
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document
from std_toolkit.log import logger

SPEED = "speed.json"

# The first calls compile, allocate and fill caches.
WARM_UP = 2

FEWEST = 3

LONGEST_S = 10.0

GROUPS = ("split", "protocol", "method", "grid", "subset")

OVER_ALL = (*NAMES, "coverage")

# Column, heading, factor and format. Errors are told in millimetres, shares in percent.
_COLUMNS = (
    ("rmse", "RMSE mm", 1e3, "{:.1f}"),
    ("rel", "REL", 1.0, "{:.4f}"),
    ("mae", "MAE mm", 1e3, "{:.1f}"),
    ("d105", "d1.05 %", 1e2, "{:.2f}"),
    ("d110", "d1.10 %", 1e2, "{:.2f}"),
    ("d125", "d1.25 %", 1e2, "{:.2f}"),
    ("coverage", "answered %", 1e2, "{:.2f}"),
)

_SUBSETS = ("all", "specular+transparent")


class Speed(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cost of a method.

    Attributes:
        frames_per_s: of batches of `batch_size`, from the median time of a batch, warm; reading
            and scoring are not in it.
        batch_size: frames restored together.
        width, height: of the views.
        repeats: timed batches.
        parameters: of the network; None for a method without one.
        gmacs: 1e9 multiplications with addition per frame, element-wise work left out; None for
            a method without a network, or one that cannot be counted.
        peak_memory_mib: on a GPU what torch held at most; else the most this process ever had
            resident, with libraries and data.
        hardware: processor or GPU.
    """

    frames_per_s: float
    batch_size: int
    width: int
    height: int
    repeats: int
    parameters: int | None
    gmacs: float | None
    peak_memory_mib: float
    hardware: str


def measure_speed(
    restorer: Restorer, views: Sequence[View], *, hardware: str, repeats: int = 15
) -> Speed:
    """Time a method on a batch of views: `repeats` times, less often where it is slow."""
    device = _gpu(restorer)
    for _ in range(WARM_UP):
        restorer.restore(views)
    if device is not None:
        import torch

        torch.cuda.reset_peak_memory_stats(device)
    seconds: list[float] = []
    end = time.perf_counter() + LONGEST_S
    while len(seconds) < repeats and (len(seconds) < FEWEST or time.perf_counter() < end):
        begin = time.perf_counter()
        # The answers are arrays of this machine: a GPU has finished when they are there.
        restorer.restore(views)
        seconds.append(time.perf_counter() - begin)
    height, width = views[0].depth.shape
    return Speed(
        frames_per_s=len(views) / statistics.median(seconds),
        batch_size=len(views),
        width=width,
        height=height,
        repeats=len(seconds),
        parameters=getattr(restorer, "parameter_count", None),
        gmacs=_gmacs(restorer, views[0]),
        peak_memory_mib=_peak_memory(device),
        hardware=hardware,
    )


def _gpu(restorer: Restorer) -> Any:
    device = getattr(restorer, "device", None)
    return device if device is not None and device.type == "cuda" else None


def _gmacs(restorer: Restorer, view: View) -> float | None:
    macs = getattr(restorer, "macs", None)
    return None if macs is None else macs(view) / 1e9


def _peak_memory(device: Any) -> float:
    if device is not None:
        import torch

        return torch.cuda.max_memory_allocated(device) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


OVER_ANSWERED = tuple(f"{name}_answered" for name in NAMES)


def summarise(
    rows: pd.DataFrame, *, by: Sequence[str] | None = None, samples: int = 0, seed: int = 0
) -> pd.DataFrame:
    """Unweighted means over frames.

    A frame without pixels to compare in a subset enters no mean of that subset. One that a method
    left without any usable prediction enters all means but those of `..._answered`.

    Args:
        rows: a row for each frame, grid and subset with the columns of `Row.as_dict`, and whatever
            tells runs apart: `split`, `protocol`, `method`, `scene`, `frame`.
        by: columns that make a group; by default those of `GROUPS` that are there.
        samples: draws of scenes for 95 % intervals; 0 for none. They need the column `scene`.
        seed: of the draws.

    Returns:
        A row for each group in the order of first appearance: the columns `by`; `frames` that
        entered; `frames_empty` without pixels; `frames_unanswered` without a usable prediction
        among those that entered; `scenes` where rows have them; `pixels`; the means of
        `OVER_ALL` and `OVER_ANSWERED`; with `samples`, `NAME_low` and `NAME_high` of `OVER_ALL`.

    Raises:
        ToolkitError: a column is missing.

    >>> from benchmark.metrics.depth.depth_numpy import depth_errors
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
            # NaN of a frame that enters stays: pandas' own mean would drop that frame in silence.
            total = np.bincount(group[enters], rows[name].to_numpy()[enters], n_groups)
            with np.errstate(invalid="ignore"):
                out[name] = total / n
    if samples:
        _add_intervals(out, rows[there], group[there], samples, seed)
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


def results_table(results: Sequence[RunResult]) -> str:
    """Means over frames on the protocols' first grid, for all objects and for the hard ones."""
    blocks = []
    for (split, protocol, grid), means in _means(results):
        shown = "no frame has a pixel to compare" if means.empty else _table(means)
        blocks.append(f"{split}, protocol {protocol}, {grid}\n{shown}")
    return "\n\n".join(blocks) or "no frame could be scored"


def depth_records(results: Sequence[RunResult]) -> list[dict[str, Any]]:
    """The figures of `results_table`, in metres and shares."""
    return [
        {"split": split, "protocol": protocol, "grid": grid, **row}
        for (split, protocol, grid), means in _means(results)
        for row in means.to_dict("records")
    ]


def _means(results: Sequence[RunResult]) -> Iterator[tuple[tuple[str, str, str], pd.DataFrame]]:
    """Split, protocol and grid, and the means of each method."""
    rows = pd.concat([result.table for result in results], ignore_index=True)
    rows = rows[rows["grid"] != ""]
    for (split, protocol), part in rows.groupby(["split", "protocol"], sort=False):
        grid, first = get_protocol(str(protocol)).main
        means = summarise(part[part["grid"] == grid], by=("method", "subset"))
        means = means[means["subset"].isin((first, *_SUBSETS)) & (means["frames"] > 0)]
        yield (str(split), str(protocol), grid), means


def _table(means: pd.DataFrame) -> str:
    shown = pd.DataFrame({"method": means["method"], "objects": means["subset"]})
    shown["frames"] = means["frames"].astype(str)
    for column, heading, factor, form in _COLUMNS:
        shown[heading] = [form.format(value * factor) for value in means[column]]
    return aligned([list(shown.columns), *shown.to_numpy().tolist()])
