"""The figures of papers, in the names and units of this benchmark.

`published_results.csv` holds them as printed, each with the table it comes from. What a paper does
not print is not here, and stays empty wherever it is shown.

Source: Dai et al., "Domain Randomization-Enhanced Depth Simulation and Restoration for Perceiving
and Grasping Specular and Transparent Objects", ECCV 2022, main paper and supplement.

Category-level poses as the paper prints them, in the names and units of this benchmark.
"""

from functools import cache
from pathlib import Path

import pandas as pd

from std_toolkit.errors import check_known

_FILE = Path(__file__).with_name("published_results.csv")
_BOP_FILE = Path(__file__).with_name("published_bop.csv")

# Names of data sets as printed, and of our splits.
SPLIT_OF = {
    "DREDS-CatKnown": "dreds-catknown-test",
    "DREDS-CatNovel": "dreds-catnovel",
    "STD-CatKnown": "std-catknown",
    "STD-CatNovel": "std-catnovel",
    "ClearGrasp real-known": "cleargrasp-real-known",
    "ClearGrasp real-novel": "cleargrasp-real-novel",
}

# Our subsets for the printed columns. STD-CatNovel has one column for both, since all its objects
# are specular or transparent.
SUBSETS_OF = {
    "all": ("all",),
    "specular_transparent": ("specular+transparent",),
    "all_and_specular_transparent": ("all", "specular+transparent"),
}

# Our column and unit for the printed metric.
_METRICS = {
    "rmse_m": ("rmse", 1.0),
    "rel": ("rel", 1.0),
    "mae_m": ("mae", 1.0),
    "delta_1.05_pct": ("d105", 0.01),
    "delta_1.10_pct": ("d110", 0.01),
    "delta_1.25_pct": ("d125", 0.01),
}

_PERCENT = "_pct"


@cache
def published_rows() -> pd.DataFrame:
    """All figures as printed: table, task, dataset, subset, method, training_data, metric, value,
    note; empty text where nothing is said."""
    return pd.read_csv(_FILE, dtype={"value": str}, keep_default_na=False)


def published_depth() -> pd.DataFrame:
    """Depth restoration by method and split.

    Returns:
        The columns split, subset, method, training_data, table (where it is printed), and rmse,
        mae (metres), rel, d105, d110, d125 (shares); NaN where nothing is printed. By the protocol
        `paper`.
    """
    rows = published_rows()
    rows = rows[(rows["task"] == "depth_restoration") & rows["dataset"].isin(SPLIT_OF)]
    return _wide(rows.assign(split=rows["dataset"].map(SPLIT_OF)), "split")


def published_table(table: str) -> pd.DataFrame:
    """One table of depth restoration, by the paper's own names of data sets.

    Returns:
        The columns of `published_depth`, with `dataset` in place of `split`, in the order of the
        table.

    Raises:
        ToolkitError: no such table.
    """
    rows = published_rows()
    tables = rows.loc[rows["task"] == "depth_restoration", "table"]
    problem = "no such table of depth restoration"
    check_known(table, tables, problem, path=_FILE, field="table", told="it has")
    rows = rows[(rows["task"] == "depth_restoration") & (rows["table"] == table)]
    wide = _wide(rows, "dataset")
    # As printed, not by the alphabet.
    first = {key: place for place, key in reversed(list(enumerate(_keys_of(rows))))}
    order = [first[key] for key in _keys_of(wide)]
    return wide.iloc[sorted(range(len(wide)), key=order.__getitem__)].reset_index(drop=True)


def _keys_of(rows: pd.DataFrame) -> list[tuple[str, ...]]:
    return list(rows[["dataset", "method", "training_data"]].itertuples(index=False, name=None))


def _wide(rows: pd.DataFrame, place: str) -> pd.DataFrame:
    long = [
        {
            place: getattr(row, place),
            "subset": subset,
            "method": row.method,
            "training_data": row.training_data,
            "table": row.table,
            "metric": _METRICS[row.metric][0],
            "value": float(row.value) * _METRICS[row.metric][1],
        }
        for row in rows.itertuples()
        for subset in SUBSETS_OF[row.subset]
    ]
    keys = [place, "subset", "method", "training_data", "table"]
    wide = pd.DataFrame(long).pivot(index=keys, columns="metric", values="value").reset_index()
    wide.columns.name = None
    return wide[[*keys, *(name for name, _ in _METRICS.values())]]


def published_speed() -> dict[str, float]:
    """Frames per second by method, as printed, on an RTX 3090."""
    rows = published_rows()
    return {r.method: float(r.value) for r in rows[rows["metric"] == "fps"].itertuples()}


def published_poses() -> pd.DataFrame:
    """Poses by method and split.

    Returns:
        The columns split, subset, method, training_data, table (where it is printed), and iou25,
        ..., 10deg10cm (shares); NaN where nothing is printed. In the order of print. By the
        protocol `paper`.
    """
    rows = published_rows()
    rows = rows[(rows["task"] == "category_pose") & rows["dataset"].isin(SPLIT_OF)]
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in rows.itertuples():
        for subset in SUBSETS_OF[row.subset]:
            key = (SPLIT_OF[row.dataset], subset, row.method, row.training_data, row.table)
            metric = row.metric.removesuffix(_PERCENT)
            found.setdefault(key, {})[metric] = float(row.value) / 100
    keys = ("split", "subset", "method", "training_data", "table")
    return pd.DataFrame(
        [dict(zip(keys, key, strict=True)) | figures for key, figures in found.items()]
    )


def published_bop() -> pd.DataFrame:
    """Instance-level poses on data sets of BOP, by method and data set.

    Returns:
        The columns dataset (BOP's short name), method, source, ar, ar_vsd, ar_mssd, ar_mspd, ap,
        ap_mssd, ap_mspd (shares) and seconds_per_image; NaN where nothing is printed.
    """
    return pd.read_csv(_BOP_FILE)
