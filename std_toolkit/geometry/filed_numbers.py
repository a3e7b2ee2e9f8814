"""Numbers, image size and depth unit in the fields of a camera of a foreign document."""

import math
import re
from collections.abc import Mapping
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.intrinsics import Intrinsics

_WIDTH = ("width", "w", "xres", "imagewidth", "imgwidth", "resx", "cols", "colorwidth")
_HEIGHT = ("height", "h", "yres", "imageheight", "imgheight", "resy", "rows", "colorheight")
_BOTH = (
    "resolution",
    "imagesize",
    "imgsize",
    "imageresolution",
    "imageshape",
    "imgshape",
    "shape",
    "size",
)
_DECIMAL = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_SIDES = re.compile(r"(\d{1,6}) *[x*×,] *(\d{1,6})")
# Metres per unit below 1, units per metre above 50; others are not clear.
_DEPTH_UNIT = (
    "depthmapfactor",
    "pngdepthscale",
    "depthscale",
    "depthfactor",
    "depthscaling",
    "depthunitscalefactor",
    "integerdepthscale",
    "depthunits",
    "depthshift",
    "scale",
)


def number(value: Any, field: str) -> float:
    """A finite number of a document.

    Raises:
        ToolkitError: something else.
    """
    if isinstance(value, str) and _DECIMAL.fullmatch(value.strip()):
        value = float(value)
    if not isinstance(value, bool) and isinstance(value, int | float):
        try:
            found = float(value)
        except OverflowError:  # an integer of hundreds of digits
            found = math.inf
        if math.isfinite(found):
            return found
    shown = str(value)[:40] if isinstance(value, int) else value
    raise ToolkitError("must be a finite number", field=field, value=shown)


def filed_size(
    plain: Mapping[str, tuple[str, Any]], found: Intrinsics | None = None
) -> tuple[int, int] | None:
    """The image size (width, height) that is stated.

    Args:
        plain: plain key -> key as filed, value.
        found: the intrinsics, whose centre tells height and width of `[480, 640]` apart.
    """
    for name in _BOTH:
        key, value = plain.get(name, ("", None))
        sides = None
        if isinstance(value, str):
            sides = _SIDES.fullmatch(value.strip().lower())
            value = None if sides is None else [int(w) for w in sides.groups()]
        if not isinstance(value, list) or any(isinstance(v, list | Mapping) for v in value):
            continue
        if name.endswith("shape") and len(value) == 3:
            value = value[:2]
        if len(value) != 2:
            continue
        width, height = (int(number(v, key)) for v in value)
        if found is None or width <= 0 or height <= 0 or sides is not None:
            return width, height
        off = [
            abs(found.cx / w - 0.5) + abs(found.cy / h - 0.5)
            for w, h in ((width, height), (height, width))
        ]
        if name in ("size", "shape") and min(off) > 0.3:
            continue  # that of something else
        return (width, height) if off[0] <= off[1] else (height, width)
    pair = [next((plain[a] for a in names if a in plain), None) for names in (_WIDTH, _HEIGHT)]
    if pair[0] is None or pair[1] is None:
        return None
    stated = [int(number(value, key)) for key, value in filter(None, pair)]
    return stated[0], stated[1]


def filed_depth_unit(
    plain: Mapping[str, tuple[str, Any]], *, of_depth: bool = False
) -> tuple[float, str] | None:
    """Metres per unit of depth images, and the key, if one states it clearly.

    Args:
        plain: plain key -> key as filed, value.
        of_depth: whether the fields are those of a depth camera.
    """
    for name in _DEPTH_UNIT:
        key, value = plain.get(name, ("", None))
        if isinstance(value, str) and _DECIMAL.fullmatch(value.strip()):
            value = float(value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if 50 <= value <= 1e6:
            return 1 / value, key
        if name == "scale" and not of_depth:
            continue
        if 0 < value <= 0.02:
            return float(value), key
        # BOP's depth_scale is in millimetres per unit.
        if name == "depthscale" and {"fx", "fy", "cx", "cy"} <= plain.keys() and value <= 1:
            return float(f"{value / 1000:.12g}"), key
    return None
