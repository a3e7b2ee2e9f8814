"""Figures of poses, as Plotly JSON."""

from __future__ import annotations

import pandas as pd

from benchmark.pose_running.depths import RAW, TRUE
from benchmark.report.board import MEASURED
from benchmark.report.pose_board import FIGURES
from std_toolkit.checks.figures import base_layout, figure_json
from std_toolkit.checks.palette import FAINT, OBJECT_COLORS

_RAW_COLOR, _TRUE_COLOR = FAINT, "#2b7a4b"


def depth_colors(depths: list[str]) -> dict[str, str]:
    """The colour of each depth: raw grey, true green, restored ones of their own."""
    restored = [d for d in dict.fromkeys(depths) if d not in (RAW, TRUE)]
    colors = [c for c in OBJECT_COLORS if c != _TRUE_COLOR]
    found = {depth: colors[i % len(colors)] for i, depth in enumerate(restored)}
    return {RAW: _RAW_COLOR, **found, TRUE: _TRUE_COLOR}


def columns_by_depth(rows: pd.DataFrame, method: str, fit: str) -> str | None:
    """Bars of all figures of a method, one colour for each depth, with intervals.

    Args:
        rows: of one split, protocol and subset.
        method, fit: whose.
    """
    chosen = rows[(rows["kind"] == MEASURED) & (rows["method"] == method) & (rows["fit"] == fit)]
    if len(chosen) < 2:
        return None
    colors = depth_colors(rows.loc[rows["kind"] == MEASURED, "depth"].tolist())
    headings = [column.heading for column in FIGURES]
    traces = []
    for _, row in chosen.iterrows():
        values = [100 * row[c.name] for c in FIGURES]
        trace = {
            "type": "bar",
            "name": f"{row['depth']} depth",
            "x": headings,
            "y": values,
            "marker": {"color": colors[row["depth"]]},
            "hovertemplate": "%{x}: %{y:.1f} %<extra>" + row["depth"] + "</extra>",
        }
        if chosen[f"{FIGURES[0].name}_low"].notna().all():
            up = [100 * row[f"{c.name}_high"] - v for c, v in zip(FIGURES, values, strict=True)]
            down = [v - 100 * row[f"{c.name}_low"] for c, v in zip(FIGURES, values, strict=True)]
            trace["error_y"] = {
                "type": "data",
                "array": [max(0.0, x) for x in up],
                "arrayminus": [max(0.0, x) for x in down],
                "thickness": 1,
                "width": 3,
                "color": "#52606d",
            }
        traces.append(trace)
    layout = base_layout(
        height=320,
        yaxis={"title": {"text": "right [%]"}, "range": [0, 103]},
        barmode="group",
        bargap=0.25,
    )
    return figure_json(traces, layout)
