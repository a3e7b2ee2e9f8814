"""Tables of means over frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from benchmark.metrics.bootstrap import mean_interval
from benchmark.metrics.tally import NAMES
from std_toolkit.errors import ToolkitError

GROUPS = ("split", "protocol", "method", "grid", "subset")
OVER_ALL = (*NAMES, "coverage")
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

    >>> from benchmark.metrics.depth import depth_errors
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
