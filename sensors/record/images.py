"""librealsense's frames as arrays of our own."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from sensors.record.frames import Image8, Units
from sensors.record.realsense import librealsense
from std_toolkit.errors import ToolkitError

# Most colour streams of the field, and what makes RGB of them.
_TO_RGB = {
    "rgb8": None,
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "yuyv": cv2.COLOR_YUV2RGB_YUYV,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
}
# The camera's mark for "no measurement" is 0; this value is what saturates.
_SATURATED = 65535


def check_formats(profiles: dict[str, Any]) -> None:
    """Refuse what `color_image` and the others cannot read, before the first image.

    Raises:
        ToolkitError: an image format that is not known.
    """
    for name, profile in profiles.items():
        form = _format(profile)
        known = {"color": tuple(_TO_RGB), "depth": ("z16",)}.get(name, ("y8",))
        if form not in known:
            raise ToolkitError(
                "an image format that is not read",
                field=name,
                value=form,
                hint=f"known: {', '.join(known)}",
            )


def color_image(frame: Any) -> Image8:
    """(H, W, 3) RGB, a copy."""
    form = _format(frame.get_profile())
    data = np.asanyarray(frame.as_video_frame().get_data())
    conversion = _TO_RGB[form]
    if conversion is None:
        return np.array(data)
    if form in ("yuyv", "uyvy") and data.ndim == 2:  # 16 bits a pixel
        data = data.view(np.uint8).reshape(*data.shape, 2)
    return np.asarray(cv2.cvtColor(data, conversion), dtype=np.uint8)


def depth_image(frame: Any) -> Units:
    """(h, w) units, a copy; 0 = none."""
    units = np.array(np.asanyarray(frame.as_video_frame().get_data()), dtype=np.uint16)
    units[units == _SATURATED] = 0
    return units


def grey_image(frame: Any) -> Image8:
    """(h, w), a copy."""
    return np.array(np.asanyarray(frame.as_video_frame().get_data()), dtype=np.uint8)


def exposure(frame: Any) -> float | None:
    """Seconds that the image was exposed, or None."""
    kind = librealsense().frame_metadata_value.actual_exposure
    if not frame.supports_frame_metadata(kind):
        return None
    return float(frame.get_frame_metadata(kind)) * 1e-6 or None


def _format(profile: Any) -> str:
    return str(profile.format()).rsplit(".", 1)[-1].lower()
