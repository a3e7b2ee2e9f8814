"""The results of a few runs as a table in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from benchmark.protocols.registry import get_protocol
from benchmark.protocols.summary import summarise
from benchmark.running.aligned import aligned
from benchmark.running.results import RunResult

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


def results_table(results: Sequence[RunResult]) -> str:
    """Means over frames on the protocols' first grid, for all objects and for the hard ones."""
    blocks = []
    rows = pd.concat([result.table for result in results], ignore_index=True)
    rows = rows[rows["grid"] != ""]
    if rows.empty:
        return "no frame could be scored"
    for (split, protocol), part in rows.groupby(["split", "protocol"], sort=False):
        grid, first = get_protocol(str(protocol)).main
        means = summarise(part[part["grid"] == grid], by=("method", "subset"))
        means = means[means["subset"].isin((first, *_SUBSETS)) & (means["frames"] > 0)]
        shown = "no frame has a pixel to compare" if means.empty else _table(means)
        blocks.append(f"{split}, protocol {protocol}, {grid}\n{shown}")
    return "\n\n".join(blocks)


def _table(means: pd.DataFrame) -> str:
    shown = pd.DataFrame({"method": means["method"], "objects": means["subset"]})
    shown["frames"] = means["frames"].astype(str)
    for column, heading, factor, form in _COLUMNS:
        shown[heading] = [form.format(value * factor) for value in means[column]]
    return aligned([list(shown.columns), *shown.to_numpy().tolist()])
