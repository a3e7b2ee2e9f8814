"""Figures over frames, directions and materials, as Plotly JSON in one style."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.result import CheckReport, MaterialDepth, ObjectCheck, ObjectFrameCheck
from std_toolkit.html import plots

SKIES_PER_ROW = 4


def registration_figure(report: CheckReport, *, limit_px: float) -> str | None:
    """Reprojection error per frame; frames without a pose as crosses below the axis."""
    rows = report.frames
    there = [f for f in rows if f.status == "registered"]
    lost = [f for f in rows if f.status == "unregistered"]
    if not lost and all(f.reprojection_px is None for f in there):
        return None
    traces: list[dict[str, Any]] = [
        {
            "type": "bar",
            "name": "registered",
            "x": [f.frame for f in there],
            "y": [f.reprojection_px or 0 for f in there],
            "marker_color": plots.CAMERA,
            "customdata": [[f.name, f.points] for f in there],
            "hovertemplate": "frame %{x} (%{customdata[0]})<br>%{y:.2f} px, "
            "%{customdata[1]} points<extra></extra>",
        }
    ]
    if lost:
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "no camera pose",
                "x": [f.frame for f in lost],
                "y": [0.0] * len(lost),
                "marker": {"symbol": "x", "size": 9, "color": plots.BAD},
                "cliponaxis": False,
                "hovertext": [f.name for f in lost],
                "hovertemplate": "frame %{x} (%{hovertext})<br>no pose<extra></extra>",
            }
        )
    top = max([limit_px * 1.1, *(f.reprojection_px or 0 for f in there)])
    return plots.figure(
        traces,
        height=260,
        x="frame",
        y="reprojection error (px)",
        yaxis={"range": [0, top * 1.05]},
        bargap=0.15,
        showlegend=bool(lost),
        shapes=[_limit_line(limit_px)],
    )


def frames_figure(
    objects: Sequence[ObjectCheck],
    value: Callable[[ObjectFrameCheck], float | None],
    *,
    title: str,
    unit: str,
    limits: Sequence[float] = (),
    from_zero: bool = True,
) -> str | None:
    """One line per object over the frames; None if no object has the value."""
    ids = [o.object for o in objects]
    traces: list[dict[str, Any]] = []
    for item in objects:
        points = [
            (f.frame, v if v is None else round(v, 3)) for f in item.frames for v in [value(f)]
        ]
        if all(v is None for _, v in points):
            continue
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": item.name,
                "x": [p[0] for p in points],
                "y": [p[1] for p in points],
                "line_color": plots.object_color(ids, item.object),
                "line_dash": plots.object_dash(ids, item.object),
                "line_width": 1.5,
                "marker_size": 4,
                "hovertemplate": f"{item.name}<br>frame %{{x}}: %{{y:.2f}} {unit}<extra></extra>",
            }
        )
    if not traces:
        return None
    values = [v for t in traces for v in t["y"] if v is not None]
    low, high = min([*values, *limits]), max([*values, *limits])
    # A single outlier must not compress the scale of all other frames.
    reach = 3 * float(np.percentile(np.abs(values), 90))
    high, low = min(high, max([reach, *limits])), max(low, min([-reach, *limits]))
    pad = 0.08 * max(high - min(low, 0), 1e-3)
    return plots.figure(
        traces,
        height=320,
        x="frame",
        y=f"{title} ({unit})",
        yaxis={"range": [0 if from_zero else low - pad, high + pad]},
        shapes=[_limit_line(x) for x in limits],
        showlegend=True,
    )


def visibility_figure(objects: Sequence[ObjectCheck]) -> str | None:
    """Visible fraction as a map of objects over frames."""
    rows = [o for o in objects if o.frames]
    if not rows:
        return None
    frames = sorted({f.frame for o in rows for f in o.frames})
    table: list[list[float | None]] = []
    for item in rows:
        seen = {f.frame: f.visible_fraction for f in item.frames}
        table.append([seen.get(f) for f in frames])
    trace = {
        "type": "heatmap",
        "x": frames,
        "y": [o.name for o in rows],
        "z": table,
        "zmin": 0,
        "zmax": 1,
        "colorscale": [[0, "#f1f3f5"], [0.5, "#8fb8d8"], [1, "#0b4a7a"]],
        "colorbar_title": {"text": "visible", "side": "right"},
        "colorbar_tickformat": ".0%",
        "colorbar_thickness": 12,
        "colorbar_outlinewidth": 0,
        "xgap": 0,
        "ygap": 2,
        "hovertemplate": "%{y}<br>frame %{x}: %{z:.0%} visible<extra></extra>",
    }
    return plots.figure(
        [trace],
        height=110 + 30 * len(rows),
        x="frame",
        xaxis={"showgrid": False},
        yaxis={"autorange": "reversed", "showgrid": False, "ticks": ""},
    )


def sky_figure(
    views: dict[int, tuple[NDArray[np.float64], NDArray[np.float64], list[ObjectFrameCheck]]],
    objects: Sequence[ObjectCheck],
) -> str | None:
    """View directions of every object on a hemisphere: centre = from above, rim = horizontal.

    Args:
        views: by object id: azimuth, elevation (N,) in degrees, and the frames they belong to.
        objects: all objects, for names and colours.
    """
    shown = [o for o in objects if o.object in views]
    if not shown:
        return None
    ids = [o.object for o in objects]
    columns = min(SKIES_PER_ROW, len(shown))
    rows = -(-len(shown) // columns)
    height = 60 + 290 * rows
    traces: list[dict[str, Any]] = []
    layout = plots.base_layout(
        height=height, showlegend=False, margin={"l": 10, "r": 10, "t": 10, "b": 10}
    )
    del layout["xaxis"], layout["yaxis"]
    small = {"size": 10, "color": plots.FAINT}
    axis = {"gridcolor": plots.GRID, "linecolor": plots.GRID, "tickfont": small, "ticks": ""}
    notes = []
    for place, item in enumerate(shown):
        azimuth, elevation, frames = views[item.object]
        name = "polar" if place == 0 else f"polar{place + 1}"
        row, column = divmod(place, columns)
        x0, x1 = (column + 0.08) / columns, (column + 0.92) / columns
        y1 = 1 - (row + 0.22) / rows
        y0 = 1 - (row + 0.92) / rows
        deepest = max(90.0, 90 - float(elevation.min()))
        layout[name] = {
            "domain": {"x": [x0, x1], "y": [max(y0, 0), y1]},
            "bgcolor": "rgba(0,0,0,0)",
            "radialaxis": axis
            | {
                "range": [0, deepest],
                "tickvals": [0, 30, 60, 90],
                "ticktext": ["", "60°", "30°", "0°"],
                "angle": 157.5,
                "tickangle": 157.5,
            },
            "angularaxis": axis
            | {
                "tickvals": list(range(0, 360, 45)),
                "direction": "counterclockwise",
                "rotation": -90,
                "linecolor": "#cbd2d9",
            },
        }
        annotated = [f.frame == item.annotated_frame for f in frames]
        traces.append(
            {
                "type": "scatterpolar",
                "subplot": name,
                "mode": "markers",
                "theta": [round(float(a), 1) for a in azimuth],
                "r": [round(90 - float(e), 1) for e in elevation],
                "marker_color": plots.object_color(ids, item.object),
                "marker_size": [13 if a else 7 for a in annotated],
                "marker_symbol": ["star" if a else "circle" for a in annotated],
                "marker_opacity": [round(0.25 + 0.75 * f.visible_fraction, 2) for f in frames],
                "marker_line": {"width": 0.5, "color": "white"},
                "customdata": [
                    [f.frame, round(float(e), 1), f.visible_fraction]
                    for f, e in zip(frames, elevation, strict=True)
                ],
                "hovertemplate": f"{item.name}<br>frame %{{customdata[0]}}<br>azimuth %{{theta}}°, "
                "elevation %{customdata[1]}°<br>%{customdata[2]:.0%} visible<extra></extra>",
            }
        )
        angle = item.value("azimuth_span_deg")
        span = f"{angle:.0f}°" if angle is not None else "–"
        notes.append(
            {
                "text": f"<b>{item.name}</b><br>{len(frames)} views over {span}",
                "x": (x0 + x1) / 2,
                "y": 1 - row / rows,
                "xref": "paper",
                "yref": "paper",
                "xanchor": "center",
                "yanchor": "top",
                "showarrow": False,
                "font": {"size": 13},
            }
        )
    layout["annotations"] = notes
    return plots.figure_json(traces, layout)


def error_figure(materials: Sequence[MaterialDepth]) -> str | None:
    """Distribution of raw minus ground-truth depth per material."""
    rows = [m for m in materials if m.histogram_mm]
    if not rows:
        return None
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": m.material,
            "x": m.histogram_mm,
            # A logarithmic axis has no 0: empty bins become gaps.
            "y": [100 * s or None for s in m.histogram_share],
            "line": {"color": plots.MATERIAL_COLORS[m.material], "width": 2, "shape": "hvh"},
            "hovertemplate": f"{m.material}<br>%{{x}} mm: %{{y:.2f}} % of the readings"
            "<extra></extra>",
        }
        for m in rows
    ]
    limit = max(abs(x) for x in rows[0].histogram_mm)
    ticks = [0.01, 0.1, 1, 10, 100]
    zero = {"type": "line", "x0": 0, "x1": 0, "yref": "paper", "y0": 0, "y1": 1}
    return plots.figure(
        traces,
        height=340,
        x="raw minus ground-truth depth (mm); outermost bins include the rest",
        y="readings per 2 mm (%)",
        xaxis={"range": [-limit - 2, limit + 2]},
        yaxis={"type": "log", "range": [-2, 2], "tickvals": ticks, "ticktext": [*map(str, ticks)]},
        shapes=[zero | {"line": {"color": plots.FAINT, "width": 1, "dash": "dot"}}],
        showlegend=True,
    )


def _limit_line(y: float) -> dict[str, Any]:
    line = {"color": plots.BAD, "width": 1, "dash": "dash"}
    return {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y, "line": line}
