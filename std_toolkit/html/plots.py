"""Colours and layout of plots: the same object has the same colour everywhere.

The colours are from the palettes of Okabe and Ito and of Paul Tol, which suit colour-blind
readers, the most distinct ones first. Materials have four colours of their own.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

OBJECT_COLORS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#882255",
    "#999933",
    "#6A51A3",
    "#44AA99",
)

DASHES = ("solid", "dash", "dot", "dashdot")

MATERIAL_COLORS = {
    "raw": "#7F7F7F",
    "diffuse": "#4477AA",
    "specular": "#EE7733",
    "transparent": "#AA3377",
}

INK = "#1f2933"

FAINT = "#7b8794"

GRID = "#e4e7eb"

CAMERA = "#52606d"

GOOD, MIDDLING, BAD = "#2b7a4b", "#b7791f", "#b42318"


FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def object_color(object_ids: Sequence[int], object_id: int) -> str:
    """Colour of an object, by its index among the scene's ids."""
    return OBJECT_COLORS[sorted(object_ids).index(object_id) % len(OBJECT_COLORS)]


def object_dash(object_ids: Sequence[int], object_id: int) -> str:
    """Line style that distinguishes objects of the same colour."""
    place = sorted(object_ids).index(object_id) // len(OBJECT_COLORS)
    return DASHES[place % len(DASHES)]


def base_layout(*, height: int, **more: Any) -> dict[str, Any]:
    """The layout that all figures share."""
    axis = {
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": "#cbd2d9",
        "ticks": "outside",
        "tickcolor": "#cbd2d9",
        "ticklen": 4,
        "title": {"standoff": 10},
        "automargin": True,
    }
    layout: dict[str, Any] = {
        "height": height,
        "margin": {"l": 64, "r": 16, "t": 16, "b": 52},
        "font": {"family": FONT, "size": 13, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "closest",
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "xanchor": "left"},
        "xaxis": dict(axis),
        "yaxis": dict(axis),
    }
    for key, value in more.items():
        layout[key] = layout.get(key, {}) | value if isinstance(value, dict) else value
    return layout


def error_bars(values: ArrayLike, low: ArrayLike, high: ArrayLike, *, color: str) -> dict[str, Any]:
    """Intervals around values, lists of equal length; NaN for unknown bounds."""
    middle = np.asarray(values, float)
    ends = (np.asarray(high, float) - middle, middle - np.asarray(low, float))
    up, down = (np.maximum(np.nan_to_num(end), 0).tolist() for end in ends)
    return {
        "type": "data",
        "symmetric": False,
        "array": up,
        "arrayminus": down,
        "color": color,
        "thickness": 1,
        "width": 3,
        "visible": bool(np.isfinite(ends).any()),
    }


def figure(traces: Sequence[Any], *, height: int, x: str = "", y: str = "", **layout: Any) -> str:
    """JSON of a figure in the shared style.

    Args:
        traces: Plotly traces; `line_color` is short for `{"line": {"color": ...}}`.
        height: height in pixels.
        x, y: titles of the axes.
        layout: further layout; mappings are merged into those of the shared style.
    """
    for axis, title in (("xaxis", x), ("yaxis", y)):
        if title:
            layout[axis] = {"title": {"text": title}} | layout.get(axis, {})
    return figure_json(traces, base_layout(height=height, **layout))


def figure_json(traces: Sequence[Any], layout: dict[str, Any]) -> str:
    """JSON of a figure: validated by Plotly, without its default theme, safe inside a script."""
    import plotly.graph_objects as go
    from plotly.io import to_json

    # Plotly validates and copies lists of colours one by one, which takes seconds for a cloud.
    colors = {i: c for i, t in enumerate(traces) if isinstance(c := _color_of(t), list)}
    plain = [_without_color(t) if i in colors else t for i, t in enumerate(traces)]
    layout = {**layout, "template": go.layout.Template()}
    figure = go.Figure(data=plain, layout=layout).to_dict()
    for i, found in colors.items():
        figure["data"][i].setdefault("marker", {})["color"] = found
    return str(to_json(figure, validate=False)).replace("<", "\\u003c")


def _color_of(trace: Any) -> Any:
    return trace.get("marker", {}).get("color") if isinstance(trace, dict) else None


def _without_color(trace: dict[str, Any]) -> dict[str, Any]:
    marker = {k: v for k, v in trace["marker"].items() if k != "color"}
    return {**trace, "marker": marker}
