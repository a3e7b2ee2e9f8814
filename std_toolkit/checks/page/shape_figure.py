"""The figure of the difference in shape between an object and its mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks import result
from std_toolkit.checks.measure.shape_map import ShapeMap
from std_toolkit.checks.shapes import ShapeFinding
from std_toolkit.html import page
from std_toolkit.html.plots import GRID, base_layout, figure_json

# Blue inside the mesh, red outside; suits colour-blind readers.
_SCALE = ("#2166ac", "#92c5de", "#f7f7f7", "#f4a582", "#b2182b")
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
    x, y, z = np.round(1000 * found.points, 1).T
    i, j, k = found.faces.T
    texts = [
        f"{d:+.1f} mm" if seen else "not seen" for d, seen in zip(found.mm, known, strict=True)
    ]
    surface: dict[str, Any] = {
        "type": "mesh3d",
        **{"x": x.tolist(), "y": y.tolist(), "z": z.tolist()},
        **{"i": i.tolist(), "j": j.tolist(), "k": k.tolist()},
        "vertexcolor": _colors(np.where(known, found.mm, np.nan) / largest),
        "text": texts,
        "hovertemplate": "%{text}<extra></extra>",
        "lighting": {"ambient": 0.9, "diffuse": 0.3, "specular": 0.0},
    }
    # Colours of vertices have no legend of their own: an invisible point brings it.
    legend = {
        "type": "scatter3d",
        "mode": "markers",
        **{"x": [x[0]], "y": [y[0]], "z": [z[0]]},
        "hoverinfo": "skip",
        "marker": {
            "size": 0.1,
            "color": [0.0],
            "colorscale": [[n / (len(_SCALE) - 1), c] for n, c in enumerate(_SCALE)],
            "cmin": -largest,
            "cmax": largest,
            "colorbar": {"title": {"text": "mm"}, "thickness": 14, "len": 0.8},
        },
    }
    axis = {"gridcolor": GRID, "zeroline": False, "showbackground": False, "showspikes": False}
    layout = base_layout(
        height=460,
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        scene={
            "aspectmode": "data",
            **{f"{a}axis": {**axis, "title": {"text": f"{a} (mm)"}} for a in "xyz"},
            "camera": {"eye": {"x": 1.5, "y": -1.6, "z": 1.1}},
            "dragmode": "orbit",
        },
        showlegend=False,
    )
    del layout["xaxis"], layout["yaxis"]
    return figure_json([surface, legend], layout)


def _colors(shares: Array) -> list[str]:
    """Colours of shares of the largest difference, -1 to 1; grey for NaN."""
    stops = np.array([[int(c[n : n + 2], 16) for n in (1, 3, 5)] for c in _SCALE])
    at = np.linspace(-1, 1, len(_SCALE))
    rgb = np.stack([np.interp(np.nan_to_num(shares), at, stops[:, n]) for n in range(3)], axis=1)
    names = [f"rgb({r:.0f},{g:.0f},{b:.0f})" for r, g, b in rgb]
    return [n if np.isfinite(x) else _UNSEEN for n, x in zip(names, shares, strict=True)]
