"""The figures of the page, as Plotly JSON."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmark.report.leaderboard import MEASURED, METRICS, PUBLISHED, Board, one_of_each
from std_toolkit.html.plots import FAINT, GRID, INK, OBJECT_COLORS, error_bars, figure
from std_toolkit.html.table import Column

RMSE = METRICS[0]
DEPTH_PREFIX = "depth:"
_DASHES = ("solid", "dash", "dot")
_MARKERS = ("circle", "square", "diamond", "cross", "triangle-up")
_BAR_PX, _LEAST_PX = 26, 180
# More overlapping polygons are not distinguishable.
_MOST_POLYGONS = 8
_LONGEST_NAME = 34


def method_colors(board: Board) -> dict[str, str]:
    """Return the colour of each method, the same in all figures."""
    methods = board.rows.loc[board.rows["kind"] == MEASURED, "method"].drop_duplicates()
    return {m: OBJECT_COLORS[i % len(OBJECT_COLORS)] for i, m in enumerate(methods)}


def bars(rows: pd.DataFrame, colors: dict[str, str], column: Column = RMSE) -> str | None:
    """Plot a bar per method with its 95 % interval, best on top; published ones hollow, below."""
    rows = one_of_each(rows.dropna(subset=[column.name])).iloc[::-1]  # drawn from the bottom
    if rows.empty:
        return None
    printed = rows["kind"] == PUBLISHED
    # By number: Plotly would stack bars of the same name.
    rows = rows.assign(place=range(len(rows)))
    traces = []
    for part, hollow in ((rows[~printed], False), (rows[printed], True)):
        value, low, high = (
            part[f"{column.name}{end}"] * column.factor for end in ("", "_low", "_high")
        )
        fill = [colors.get(m, FAINT) for m in part["method"]]
        traces.append(
            {
                "type": "bar",
                "orientation": "h",
                "y": part["place"].tolist(),
                "customdata": [f"{m} (published)" if hollow else m for m in part["method"]],
                "x": value.tolist(),
                "marker": {
                    "color": "rgba(0,0,0,0)" if hollow else fill,
                    "line": {"color": FAINT, "width": int(hollow)},
                },
                "error_x": error_bars(value, low, high, color=INK),
                "hovertemplate": f"%{{customdata}}: %{{x:.{column.digits}f}} {column.unit}"
                "<extra></extra>",
            }
        )
    return figure(
        traces,
        height=max(_LEAST_PX, 90 + _BAR_PX * len(rows)),
        x=column.title,
        xaxis={"rangemode": "tozero"},
        yaxis={
            "tickvals": list(range(len(rows))),
            "ticktext": [
                f"{short(m)} (published)" if p else short(m)
                for m, p in zip(rows["method"], printed, strict=True)
            ],
            "range": [-0.6, len(rows) - 0.4],
        },
        showlegend=False,
        barmode="overlay",
    )


def radar(rows: pd.DataFrame, colors: dict[str, str]) -> str | None:
    """Plot the best methods as polygons over six metrics; the rim is the best measured figure."""
    rows = rows[rows["kind"] == MEASURED].dropna(subset=[c.name for c in METRICS])
    if len(rows) < 2:
        return None
    rows = rows.head(_MOST_POLYGONS)
    angles = [c.heading for c in METRICS]
    scores = np.stack([_relative(rows[c.name].to_numpy(), c) for c in METRICS], axis=1)
    traces = [
        {
            "type": "scatterpolar",
            "name": short(method),
            "r": [*score.tolist(), score[0]],
            "theta": [*angles, angles[0]],
            "line": {"color": colors[method], "width": 2, "dash": dash},
            "opacity": 0.9,
            "hovertemplate": f"{method}, %{{theta}}: %{{r:.2f}} of the best<extra></extra>",
        }
        for method, score, dash in zip(
            rows["method"], scores, _dashes(rows["method"].tolist(), colors), strict=True
        )
    ]
    return figure(
        traces,
        height=460,
        margin={"l": 40, "r": 40, "t": 30, "b": 30},
        polar={
            "radialaxis": {"range": [0, 1], "tickvals": [0.25, 0.5, 0.75, 1], "gridcolor": GRID},
            "angularaxis": {"gridcolor": GRID},
            "bgcolor": "rgba(0,0,0,0)",
        },
        legend={"y": -0.1, "yanchor": "auto"},
    )


def depth_curves(rows: pd.DataFrame, colors: dict[str, str], column: Column = RMSE) -> str | None:
    """Plot error against true depth, a line per method."""
    rows = rows[rows["subset"].str.startswith(DEPTH_PREFIX) & (rows["kind"] == MEASURED)]
    if rows.empty:
        return None
    traces = []
    dashes = _dashes(rows["method"].drop_duplicates().tolist(), colors)
    for dash, (method, part) in zip(dashes, rows.groupby("method", sort=False), strict=True):
        ends = part["subset"].str.removeprefix(DEPTH_PREFIX).str.split("-", expand=True)
        middle = ends.astype(float).mean(axis=1)
        order = np.argsort(middle.to_numpy())
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": short(str(method)),
                "x": middle.to_numpy()[order].tolist(),
                "y": (part[column.name].to_numpy() * column.factor)[order].tolist(),
                "line": {"color": colors[str(method)], "dash": dash},
                "hovertemplate": f"{method}<br>%{{x:.2f}} m: %{{y:.1f}} {column.unit}"
                "<extra></extra>",
            }
        )
    return figure(
        traces,
        height=380,
        x="true depth [m]",
        y=column.title,
        yaxis={"rangemode": "tozero"},
    )


def speed_against_error(rows: pd.DataFrame, colors: dict[str, str]) -> str | None:
    """Plot frames per second against RMSE; the best corner is the lower right."""
    rows = one_of_each(rows.dropna(subset=["frames_per_s", "rmse"]))
    if rows.empty:
        return None
    traces: list[dict[str, Any]] = []
    for i, row in enumerate(rows.itertuples()):
        printed = row.kind == PUBLISHED
        color = FAINT if printed else colors[row.method]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers+text",
                "x": [row.frames_per_s],
                "y": [row.rmse * 1e3],
                "text": [f"{short(row.method)} (published)" if printed else short(row.method)],
                "textposition": "top center",
                "marker": {
                    "color": "rgba(0,0,0,0)" if printed else color,
                    "size": 11,
                    "symbol": _MARKERS[i // len(OBJECT_COLORS) % len(_MARKERS)],
                    "line": {"color": color, "width": 2},
                },
                "hovertemplate": f"{row.method}<br>%{{x:.1f}} frames/s, %{{y:.1f}} mm"
                f"<br>{row.hardware}<extra></extra>",
                "showlegend": False,
            }
        )
    axis = {"type": "log", "dtick": "D2", "minor": {"showgrid": False}}
    title = "frames/s, warm, one at a time"
    return figure(traces, height=420, x=title, y=RMSE.title, xaxis=axis, yaxis=axis)


def short(name: str) -> str:
    """Shorten a name to leave room for the figure next to it."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


def _dashes(methods: Sequence[str], colors: dict[str, str]) -> list[str]:
    """Dash patterns that distinguish methods of one colour."""
    like = [colors[m] for m in methods]
    return [_DASHES[like[:i].count(color) % len(_DASHES)] for i, color in enumerate(like)]


def _relative(values: np.ndarray, column: Column) -> Sequence[float]:
    """1 for the best, less for worse."""
    floor = 1e-9
    if column.lower_is_better:
        return (values.min() + floor) / (values + floor)
    return values / max(values.max(), floor)
