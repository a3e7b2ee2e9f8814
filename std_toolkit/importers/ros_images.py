"""Image messages of ROS: raw, compressed, and compressed depth; pairs of the same time."""

import struct
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_png

# Channels of an encoding, and its conversion to RGB.
_RGB: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2RGB_UYVY),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
}
COLOR_ENCODINGS = (*(e for e in _RGB if e not in ("mono8", "8UC1")), "jpeg", "png")
DEPTH_ENCODINGS = ("16UC1", "32FC1", "64FC1", "16UC1 compressed", "32FC1 compressed")
GREY_ENCODINGS = ("mono8", "8UC1")
_TYPES = {"16UC1": "u2", "32FC1": "f4", "64FC1": "f8"}
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG"

# Largest difference of the stamps of a pair, as a fraction of the slower stream's period.
_WITHIN = 0.55


@dataclass(frozen=True)
class RosImage:
    """An image message.

    Attributes:
        topic: of the message.
        frame_id: coordinate frame of the camera.
        encoding: of ROS, `jpeg` or `png` of compressed colour, or `16UC1 compressed` or
            `32FC1 compressed` of compressed depth; others are kept as they are named.
        size: (width, height); None of compressed images.
        data: bytes.
        step: bytes of a row, of raw images.
        big_endian: order of the bytes of raw images.
    """

    topic: str
    frame_id: str
    encoding: str
    size: tuple[int, int] | None
    data: NDArray[np.uint8]
    step: int = 0
    big_endian: bool = False

    def decoded_size(self, source: Path) -> tuple[int, int]:
        """(width, height); a compressed image is decoded."""
        if self.size is not None:
            return self.size
        shape = _decoded(self, source).shape
        return shape[1], shape[0]


def image_of(message: Any, topic: str) -> RosImage:
    """The image of a `sensor_msgs/Image` or `CompressedImage` message."""
    data, frame = np.asarray(message.data, np.uint8), str(message.header.frame_id)
    if hasattr(message, "encoding"):
        size = (int(message.width), int(message.height))
        big = bool(message.is_bigendian)
        encoding = str(message.encoding)
        # Some cameras file depth as mono16.
        if encoding == "mono16" and "depth" in topic:
            encoding = "16UC1"
        return RosImage(topic, frame, encoding, size, data, int(message.step), big)
    form = str(message.format)
    if "compressedDepth" in form:
        kind = form.partition(";")[0].strip() or "16UC1"
        return RosImage(topic, frame, f"{kind} compressed", None, data)
    head = data[:4].tobytes()
    if head.startswith(_JPEG):
        encoding = "jpeg"
    elif head == _PNG:
        # PNG of 16 bits is depth that was compressed without its transport.
        encoding = "16UC1 compressed" if form.startswith("16UC1") else "png"
    else:
        encoding = form
    if encoding == "jpeg" and form.startswith("mono"):
        encoding = "mono8"
    return RosImage(topic, frame, encoding, None, data)


def write_image(image: RosImage, stem: Path, source: Path) -> Path:
    """Write an image, JPEG and PNG as recorded; returns the file.

    Args:
        stem: path without suffix.
        source: recording, for errors.

    Raises:
        ToolkitError: its encoding or its data cannot be decoded.
    """
    if image.encoding in ("jpeg", "png"):
        path = stem.with_suffix(".jpg" if image.encoding == "jpeg" else ".png")
        write_bytes_atomic(path, image.data.tobytes())
        return path
    pixels = _decoded(image, source)
    if image.encoding in DEPTH_ENCODINGS:
        if pixels.dtype == np.uint16:
            path = stem.with_suffix(".png")
            write_png(path, pixels)
        else:
            path = stem.with_suffix(".exr")
            metres = np.where(np.isfinite(pixels) & (pixels > 0), pixels, 0)
            write_exr(path, {"Y": metres.astype(np.float32)})
        return path
    path = stem.with_suffix(".png")
    write_color(path, pixels.astype(np.uint8, copy=False))
    return path


def _decoded(image: RosImage, source: Path) -> NDArray[Any]:
    """(h, w, 3) uint8 RGB, or depth as uint16 units or float32 metres."""
    if image.encoding in ("jpeg", "png"):
        return _unpacked(image, source, image.data, cv2.IMREAD_COLOR)
    if image.encoding in _TYPES:
        kind = np.dtype(_TYPES[image.encoding])
        rows = _rows(image, source, kind.itemsize)
        values = np.ascontiguousarray(rows).view(
            kind.newbyteorder(">" if image.big_endian else "<")
        )
        return values.astype(kind, copy=False)
    if image.encoding.endswith(" compressed"):
        return _compressed_depth(image, source)
    if image.encoding in _RGB:
        channels, code = _RGB[image.encoding]
        rows = _rows(image, source, channels)
        assert image.size is not None
        shape = (image.size[1], image.size[0], channels)[: 2 if channels == 1 else 3]
        pixels = np.ascontiguousarray(rows).reshape(shape)
        return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code))
    raise ToolkitError(
        "an encoding that is not supported",
        path=source,
        field=image.topic,
        value=image.encoding,
        hint=f"supported: {', '.join((*COLOR_ENCODINGS, *DEPTH_ENCODINGS[:3]))}, compressedDepth",
    )


def _rows(image: RosImage, source: Path, pixel: int) -> NDArray[np.uint8]:
    """(h, w * pixel) bytes without padding."""
    assert image.size is not None
    width, height = image.size
    step = image.step or width * pixel
    if step < width * pixel or len(image.data) < step * height:
        raise ToolkitError(
            f"a {width}x{height} image of {image.encoding} has too few bytes",
            path=source,
            field=image.topic,
            value=len(image.data),
        )
    return image.data[: step * height].reshape(height, step)[:, : width * pixel]


def _compressed_depth(image: RosImage, source: Path) -> NDArray[Any]:
    data = image.data
    parameters = (0.0, 0.0)
    if data[:4].tobytes() != _PNG:
        # Format and two parameters of the quantisation come before the PNG.
        if data[12:16].tobytes() != _PNG:
            raise ToolkitError(
                "compressed depth must be PNG",
                path=source,
                field=image.topic,
                hint="record the raw depth images, or set the transport's format to png",
            )
        parameters = struct.unpack("<4xff", data[:12].tobytes())
        data = data[12:]
    values = _unpacked(image, source, data, cv2.IMREAD_UNCHANGED)
    if values.dtype != np.uint16 or values.ndim != 2:
        raise ToolkitError("compressed depth must have 16 bits", path=source, field=image.topic)
    if not image.encoding.startswith("32FC1"):
        return values
    a, b = parameters
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(a) / (values.astype(np.float32) - np.float32(b))
    return np.where(values > 0, metres, np.float32(0))


def _unpacked(image: RosImage, source: Path, data: NDArray[np.uint8], flag: int) -> NDArray[Any]:
    try:
        pixels = cv2.imdecode(np.ascontiguousarray(data), flag)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ToolkitError("a damaged compressed image", path=source, field=image.topic)
    return np.asarray(pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def pair_stamps(color: list[float], depth: list[float]) -> list[tuple[int, int]]:
    """Indices of colour and depth images of the same time, in order of time.

    Each image is used once. Pairs are at most about half a period of the slower stream apart.

    >>> pair_stamps([0.0, 0.1, 0.2], [0.01, 0.21])
    [(0, 0), (2, 1)]
    """
    slower = max((_period(times) for times in (color, depth)), default=0.0)
    allowed = _WITHIN * slower if slower > 0 else np.inf
    order = np.argsort(depth, kind="stable")
    times = np.asarray(depth)[order]
    candidates = []
    for i, stamp in enumerate(color):
        at = int(np.searchsorted(times, stamp))
        near = [j for j in (at - 1, at) if 0 <= j < len(times)]
        candidates += [(abs(float(times[j]) - stamp), i, int(order[j])) for j in near]
    used_color: set[int] = set()
    used_depth: set[int] = set()
    pairs = []
    for apart, i, j in sorted(candidates):
        if apart <= allowed and i not in used_color and j not in used_depth:
            used_color.add(i)
            used_depth.add(j)
            pairs.append((i, j))
    return sorted(pairs, key=lambda p: color[p[0]])


def _period(times: list[float]) -> float:
    gaps = [b - a for a, b in pairwise(sorted(times)) if b > a]
    return float(np.median(gaps)) if gaps else 0.0
