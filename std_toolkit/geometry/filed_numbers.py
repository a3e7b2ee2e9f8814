"""Numbers, image size and depth unit in the fields of a camera of a foreign document."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.filed_lens import plain_key
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
_DECIMAL = re.compile(r"[-+]?(\d+(?:\.\d*)?|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
_SIDES = re.compile(r"(\d{1,6}) *[x*×,] *(\d{1,6})")
# Metres per unit below 1, units per metre above 50; others are not clear.
_DEPTH_UNIT = (
    "depthmapfactor",
    "mdepthshift",
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


def y_down(found: Intrinsics) -> tuple[Intrinsics, str]:
    """Intrinsics of a camera whose y points down, and what was changed.

    A negative fy, as ICL-NUIM states it, means axes of x right, y up, z forward; the images are as
    ever.
    """
    if found.fy >= 0 or found.fx <= 0:
        return found, ""
    note = (
        f"fy is {found.fy:g}: y points up, axes are left-handed; {-found.fy:g} is taken, and poses "
        "beside it need --cameras-convention camera-to-world-unity"
    )
    return replace(found, fy=-found.fy), note


def of_region(
    found: Intrinsics, plain: Mapping[str, tuple[str, Any]], size: tuple[int, int] | None
) -> tuple[Intrinsics, str]:
    """Intrinsics of the image that `roi` and `binning_x`, `binning_y` of ROS leave of the full one.

    The definition of sensor_msgs/CameraInfo: K is that of the full image; the region, in its
    pixels, is cut out first, and squares of its pixels are then combined to one.

    Args:
        found: those of the full image.
        plain: plain key -> key as filed, value.
        size: image size, if it is known.

    Returns:
        Intrinsics, and what was done; "" where the fields are those of the full image.

    Raises:
        ToolkitError: a field is no number, or the region is not within the image.
    """
    across, down = (max(1, _whole(plain, k)) for k in ("binningx", "binningy"))
    key, roi = plain.get("roi", ("roi", None))
    fields = roi if isinstance(roi, Mapping) else {}
    inner = {plain_key(k): (f"{key}.{k}", v) for k, v in fields.items()}
    x, y = _whole(inner, "xoffset"), _whole(inner, "yoffset")
    full = found.size or (0, 0)
    w, h = (_whole(inner, k) or n for k, n in zip(("width", "height"), full, strict=True))
    if (across, down, x, y) == (1, 1, 0, 0) and (w, h) == full:
        return found, ""
    if min(w, h) <= 0 or (found.size and (x + w > full[0] or y + h > full[1])):
        raise ToolkitError(
            "the region is not within the image", field=key, value=[x, y, w, h],
            hint="give --intrinsics fx,fy,cx,cy of the images as they are",
        )  # fmt: skip
    told = f"region {x},{y} {w}x{h} and binning {across}x{down} of {full[0]}x{full[1]}"
    if size is not None and size == found.size:
        return found, f"{told} are not applied: the images have the full size"
    left = (w // across, h // down)
    # Halves of squares at the border are kept by some drivers.
    if size and abs(size[0] - w / across) < 1 and abs(size[1] - h / down) < 1:
        left = size
    cx, cy = (found.cx - x + 0.5) / across - 0.5, (found.cy - y + 0.5) / down - 0.5
    changed = replace(
        found, fx=found.fx / across, fy=found.fy / down, cx=cx, cy=cy, size=left, is_cropped=True
    )
    return changed, f"{told} are applied"


def _whole(fields: Mapping[str, tuple[str, Any]], name: str) -> int:
    key, value = fields.get(name, (name, 0))
    found = number(value, key)
    if found < 0 or found != int(found):
        raise ToolkitError("must be a whole number from 0", field=key, value=value)
    return int(found)


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
        # BOP's depth_scale is in millimetres per unit.
        if name == "depthscale" and "camk" in plain and 0 < value <= 10:
            return float(f"{value / 1000:.12g}"), key
        if 50 <= value <= 1e6:
            return 1 / value, key
        if name == "scale" and not of_depth:
            continue
        if 0 < value <= 0.02:
            return float(value), key
        if name == "depthscale" and {"fx", "fy", "cx", "cy"} <= plain.keys() and value <= 1:
            return float(f"{value / 1000:.12g}"), key
    return None
