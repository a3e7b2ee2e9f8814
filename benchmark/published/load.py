"""The figures of papers, in the names and units of this benchmark.

`published_results.csv` holds them as printed, each with the table it comes from, the protocol that
it was measured by, and its source. `published_sources.csv` says where each source can be opened and
what its figures are worth. Figures of a source without an address are kept in the file and shown
nowhere. What a paper does not print stays empty.
"""

import re
from functools import cache
from math import log10, nan
from pathlib import Path

import pandas as pd

from std_toolkit.errors import ToolkitError, check_known

_FILE = Path(__file__).with_name("published_results.csv")
_BOP_FILE = Path(__file__).with_name("published_bop.csv")
_SOURCES_FILE = Path(__file__).with_name("published_sources.csv")

# Names of data sets as printed, and of our splits.
SPLIT_OF = {
    "DREDS-CatKnown": "dreds-catknown-test",
    "DREDS-CatNovel": "dreds-catnovel",
    "STD-CatKnown": "std-catknown",
    "STD-CatNovel": "std-catnovel",
    "ClearGrasp real-known": "cleargrasp-real-known",
    "ClearGrasp real-novel": "cleargrasp-real-novel",
    "HAMMER D435": "hammer-d435-test",
    "HAMMER L515": "hammer-l515-test",
    "HAMMER ToF": "hammer-tof-test",
}

# Our subsets for the printed columns. STD-CatNovel has one column for both, since all its objects
# are specular or transparent.
SUBSETS_OF = {
    "all": ("all",),
    "specular_transparent": ("specular+transparent",),
    "all_and_specular_transparent": ("all", "specular+transparent"),
    "full frame": ("scene",),
}

# What a figure is worth.
GRADES = {
    "paper text": "printed by its authors in the paper",
    "repository table": "printed by its authors in a table of their repository",
    "package page": "printed by its authors on the page of a package",
    "independent rerun": "measured again by others",
    "secondary, page cited": "told by somebody who read it, with the page",
    "secondary": "told by somebody who read it",
}

# Pages that stay where they are and that anyone can open.
_ADDRESS = re.compile(
    r"https://(arxiv\.org/abs/\d{4}\.\d{4,5}(v\d+)?|doi\.org/10\.\S+/\S+|pypi\.org/project/[\w-]+/"
    r"|github\.com/[\w.-]+/[\w.-]+/blob/[0-9a-f]{40}/\S+)"
)

# Our metric and unit (metres, fractions) for the printed metric. δ with a threshold of 1.25^0.5,
# 1.118, is not that of 1.10.
_METRICS = {
    "rmse_m": ("rmse", 1.0),
    "rmse_cm": ("rmse", 0.01),
    "rel": ("rel", 1.0),
    "rel_pct": ("rel", 0.01),
    "mae_m": ("mae", 1.0),
    "l1_m": ("mae", 1.0),
    "delta_1.05_pct": ("d105", 0.01),
    "delta_1.10_pct": ("d110", 0.01),
    "delta_1.25^0.5_pct": ("d1118", 0.01),
    "delta_1.25_pct": ("d125", 0.01),
    "coverage_pct": ("coverage", 0.01),
    "objects_grasped": ("objects_grasped", 1.0),
    "attempts": ("attempts", 1.0),
    "success_rate": ("success_rate", 1.0),
}
# Times of a frame, in seconds; `fps` is the inverse.
_TIMES = {"ms_per_frame": 1e-3, "seconds_per_frame": 1.0}
_PERCENT = "_pct"
_DEPTH = ("rmse", "rel", "mae", "d105", "d110", "d1118", "d125")


def in_our_unit(metric: str, value: str) -> tuple[str, float]:
    """Our name of a printed metric, and the figure in metres, fractions or frames per second.

    Args:
        metric: as `published_results.csv` names it.
        value: as printed.

    >>> in_our_unit("rmse_cm", "14.02")
    ('rmse', 0.1402)
    >>> in_our_unit("ms_per_frame", "500")
    ('frames_per_s', 2.0)
    """
    number = float(value)
    if metric in _TIMES:
        return "frames_per_s", 1 / (number * _TIMES[metric])
    if metric == "fps":
        return "frames_per_s", number
    name, factor = _METRICS.get(metric, (metric.removesuffix(_PERCENT), 0.01))
    if factor == 1:
        return name, number
    return name, float(f"{number * factor:.12g}")


def printed_digits(metric: str, value: str, factor: float) -> int:
    """Decimal places that a printed figure has left in another unit.

    Args:
        metric, value: as printed.
        factor: from our unit to the shown one.

    >>> printed_digits("rmse_cm", "14.02", 1000)  # 140.2 mm
    1
    """
    if metric in _TIMES:
        return 2
    shift = log10(factor * _METRICS.get(metric, ("", 1.0 if metric == "fps" else 0.01))[1])
    return max(0, len(value.partition(".")[2]) - round(shift))


@cache
def published_sources() -> pd.DataFrame:
    """Where the figures come from.

    Returns:
        The columns source (its key), citation, address (empty if a reader cannot open it) and trust
        (one of `GRADES`).

    Raises:
        ToolkitError: an address that does not stay, or an unknown grade.
    """
    rows = pd.read_csv(_SOURCES_FILE, keep_default_na=False)
    for row in rows.itertuples():
        check_known(row.trust, tuple(GRADES), "unknown grade", path=_SOURCES_FILE, field=row.source)
        if row.address and not _ADDRESS.fullmatch(row.address):
            raise ToolkitError(
                "is no address that a reader can open",
                path=_SOURCES_FILE,
                field=row.source,
                value=row.address,
                hint="arXiv, DOI, PyPI, or a file of GitHub at a commit; leave it empty to hide it",
            )
    return rows


@cache
def every_row() -> pd.DataFrame:
    """All figures as printed, also the hidden ones: table, task, dataset, subset, protocol,
    method, year, training_data, metric, value, source, note, citation, address, trust; empty text
    where nothing is said.

    Raises:
        ToolkitError: a figure without a source.
    """
    rows = pd.read_csv(_FILE, dtype=str, keep_default_na=False)
    for key in rows["source"].unique():
        check_known(key, published_sources()["source"], "no such source", path=_FILE)
    return rows.merge(published_sources(), on="source", how="left", validate="many_to_one")


def published_rows() -> pd.DataFrame:
    """All figures whose source a reader can open, as printed; columns as in `every_row`."""
    rows = every_row()
    return rows[rows["address"] != ""].reset_index(drop=True)


def published_depth() -> pd.DataFrame:
    """Depth restoration and monocular depth by method, split and protocol.

    Returns:
        The columns split, protocol, subset, method, training_data, table (where it is printed),
        source and trust, and rmse, mae (metres), rel, d105, d110, d1118, d125 (shares); NaN where
        nothing is printed. Figures of two protocols cannot be compared.
    """
    rows = published_rows()
    depth = rows["task"].isin(("depth_restoration", "monocular_depth"))
    rows = rows[depth & rows["dataset"].isin(SPLIT_OF)]
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
    keys = [place, "protocol", "subset", "method", "training_data", "table", "source", "trust"]
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in rows.to_dict("records"):
        name, value = in_our_unit(row["metric"], row["value"])
        if name not in _DEPTH:
            continue
        for subset in SUBSETS_OF.get(row["subset"], (row["subset"],)):
            key = tuple((row | {"subset": subset})[k] for k in keys)
            found.setdefault(key, dict.fromkeys(_DEPTH, nan))[name] = value
    wide = [dict(zip(keys, key, strict=True)) | figures for key, figures in found.items()]
    made = pd.DataFrame(wide, columns=[*keys, *_DEPTH])
    return made.sort_values(keys, kind="stable", ignore_index=True)


def published_speed() -> dict[str, float]:
    """Frames per second by method, as the paper of DREDS prints them, on an RTX 3090."""
    rows = published_rows()
    return {r.method: float(r.value) for r in rows[rows["metric"] == "fps"].itertuples()}


def published_poses() -> pd.DataFrame:
    """Poses by method, split and protocol.

    Returns:
        The columns split, protocol, subset, method, training_data, table (where it is printed),
        source and trust, and iou25, ..., 10deg10cm (shares); NaN where nothing is printed. In the
        order of print.
    """
    rows = published_rows()
    rows = rows[(rows["task"] == "category_pose") & rows["dataset"].isin(SPLIT_OF)]
    keys = ("split", "protocol", "subset", "method", "training_data", "table", "source", "trust")
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for row in rows.to_dict("records"):
        metric, value = in_our_unit(row["metric"], row["value"])
        for subset in SUBSETS_OF[row["subset"]]:
            own = row | {"split": SPLIT_OF[row["dataset"]], "subset": subset}
            found.setdefault(tuple(own[k] for k in keys), {})[metric] = value
    return pd.DataFrame(
        [dict(zip(keys, key, strict=True)) | figures for key, figures in found.items()]
    )


def published_bop() -> pd.DataFrame:
    """Instance-level poses on data sets of BOP, by method and data set.

    Returns:
        The columns dataset (BOP's short name), method, source (keys of `published_sources`,
        separated by `;`), ar, ar_vsd, ar_mssd, ar_mspd, ap, ap_mssd, ap_mspd (shares) and
        seconds_per_image; NaN where nothing is printed.
    """
    return pd.read_csv(_BOP_FILE)


def cited(sources: list[str]) -> str:
    """What is to be read of some sources: citation, grade and address.

    Args:
        sources: keys of `published_sources`, each once.

    >>> cited(["cdm"])
    'Manipulation as in Simulation (Camera Depth Models) (paper text), https://arxiv.org/abs/2509.02530'
    """
    known = published_sources().set_index("source")
    rows = [known.loc[key] for key in sources]
    return "; ".join(f"{r['citation']} ({r['trust']}), {r['address']}" for r in rows)
