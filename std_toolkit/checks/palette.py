"""Colours of the report: the same object has the same colour everywhere.

Chosen from the palettes of Okabe and Ito and of Paul Tol, which people with colour-blindness can
tell apart; the order puts the most distinct ones first. Materials have their own four.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def object_color(object_ids: Sequence[int], object_id: int) -> str:
    """Colour of an object, by its place among the scene's ids."""
    return OBJECT_COLORS[sorted(object_ids).index(object_id) % len(OBJECT_COLORS)]


def object_dash(object_ids: Sequence[int], object_id: int) -> str:
    """Line style that tells objects apart once the colours are used up."""
    place = sorted(object_ids).index(object_id) // len(OBJECT_COLORS)
    return DASHES[place % len(DASHES)]
