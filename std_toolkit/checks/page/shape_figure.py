"""The figure of the difference in shape between an object and its mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from std_toolkit.checks import result
from std_toolkit.checks.measure.shape_map import ShapeMap
from std_toolkit.checks.shapes import ShapeFinding
from std_toolkit.html import page
from std_toolkit.html.plots import GRID, base_layout, figure_json

# Blue inside the mesh, red outside; suits colour-blind readers.
_SCALE = [
    [0.0, "#2166ac"],
    [0.25, "#92c5de"],
    [0.5, "#f7f7f7"],
    [0.75, "#f4a582"],
    [1.0, "#b2182b"],
]
_UNSEEN = "#c8ced6"


def shape_blocks(
    objects: Sequence[result.ObjectCheck], found: Mapping[int, ShapeFinding]
) -> list[page.Block]:
    """The section of the report; empty without an object that differs from its mesh."""
    blocks: list[page.Block] = []
    for item in objects:
        finding = found.get(item.object)
        if finding is None or finding.map is None:
            continue
        blocks += [
            page.Heading(f"{item.name}: {finding.map.sentence()}"),
            page.Plot(f"shape-{item.object}", _figure(finding.map)),
        ]
    if blocks:
        text = (
            "Distance of the object's surface from that of its mesh: red where the object is "
            "larger, blue where it is smaller, grey where no contour was seen. "
            "Axes are those of the mesh, in millimetres. Drag to rotate."
        )
        blocks.insert(0, page.Paragraph(text))
    return blocks


def _figure(found: ShapeMap) -> str:
    known = np.isfinite(found.mm)
    largest = max(float(np.abs(found.mm[known]).max()), 1.0)
    xyz = 1000 * found.points
    traces: list[dict[str, Any]] = [
        _points(xyz[~known], "not seen", {"color": _UNSEEN, "size": 2.5}),
        _points(
            xyz[known],
            "seen",
            {
                "size": 5,
                "color": np.round(found.mm[known], 2).tolist(),
                "colorscale": _SCALE,
                "cmin": -largest,
                "cmax": largest,
                "line": {"width": 0},
                "colorbar": {"title": {"text": "mm"}, "thickness": 14, "len": 0.8},
            },
            hover="%{marker.color:.1f} mm<extra></extra>",
        ),
    ]
    axis = {"gridcolor": GRID, "zeroline": False, "showbackground": False, "showspikes": False}
    layout = base_layout(
        height=440,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={
            "aspectmode": "data",
            **{f"{a}axis": {**axis, "title": {"text": a}} for a in "xyz"},
            "dragmode": "orbit",
        },
        showlegend=False,
    )
    del layout["xaxis"], layout["yaxis"]
    return figure_json(traces, layout)


def _points(
    xyz: np.ndarray[Any, Any], name: str, marker: dict[str, Any], *, hover: str = ""
) -> dict[str, Any]:
    x, y, z = np.round(xyz, 1).T
    trace = {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        "x": x.tolist(),
        "y": y.tolist(),
        "z": z.tolist(),
        "marker": marker,
    }
    return {**trace, **({"hovertemplate": hover} if hover else {"hoverinfo": "skip"})}
