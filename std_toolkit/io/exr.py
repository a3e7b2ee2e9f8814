"""OpenEXR files through the OpenEXR package (the headless OpenCV wheel reads none)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path

# "ZIPS" compresses single scan lines; with level 1 it is as fast as no compression on sparse maps.
COMPRESSIONS = ("none", "zips", "zip", "piz")
_LARGEST_SIDE = 32768
# A compressed file of a few kilobytes can claim gigapixels; no camera of this field does.
LARGEST_PIXEL_COUNT = 64_000_000


def exr_size(path: Path | str) -> tuple[int, int]:
    """(width, height) of an EXR from its header, without decoding.

    Raises:
        ToolkitError: not found, not an EXR, or of an implausible size.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(65536)
    except OSError as error:
        raise ToolkitError("image file not found", path=path) from error
    key = b"dataWindow\x00box2i\x00"
    at = head.find(key)
    if head[:4] != b"\x76\x2f\x31\x01" or at < 0 or len(head) < at + len(key) + 20:
        raise ToolkitError("not a readable EXR file (empty, truncated or mislabelled?)", path=path)
    x0, y0, x1, y1 = struct.unpack_from("<4i", head, at + len(key) + 4)
    width, height = x1 - x0 + 1, y1 - y0 + 1
    plausible = 0 < width <= _LARGEST_SIDE and 0 < height <= _LARGEST_SIDE
    if not plausible or width * height > LARGEST_PIXEL_COUNT:
        raise ToolkitError(
            "the image claims an implausible size", path=path, value=f"{width}x{height}"
        )
    return width, height


def read_exr(path: Path | str) -> dict[str, NDArray[np.generic]]:
    """All channels of an EXR, each (H, W) in its stored type (float16, float32 or uint32).

    Raises:
        ToolkitError: unreadable or truncated.
    """
    import OpenEXR

    exr_size(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeError and worse
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error


def read_exr_depth(path: Path | str) -> NDArray[np.float32]:
    """The depth channel of an EXR (Y, Z, or R of equal channels) as stored, (H, W) float32.

    Raises:
        ToolkitError: unreadable, or no channel that could be depth.
    """
    channels = read_exr(path)
    for name in ("Y", "Z", "R", "V"):
        if name in channels:
            return channels[name].astype(np.float32)
    if len(channels) == 1:
        return next(iter(channels.values())).astype(np.float32)
    raise ToolkitError(
        "the EXR file holds no depth channel (Y, Z or R)", path=path, value=sorted(channels)
    )


def write_exr(
    path: Path | str, channels: dict[str, NDArray[np.generic]], *, compression: str = "zips"
) -> None:
    """Write channels of shape (H, W), float16 or float32, atomically and deterministically."""
    import OpenEXR

    kinds = {
        "none": OpenEXR.NO_COMPRESSION,
        "zips": OpenEXR.ZIPS_COMPRESSION,
        "zip": OpenEXR.ZIP_COMPRESSION,
        "piz": OpenEXR.PIZ_COMPRESSION,
    }
    header = {"compression": kinds[compression], "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(value) for name, value in channels.items()}
    with atomic_path(path) as temporary, OpenEXR.File(header, pixels) as file:
        file.write(str(temporary))
