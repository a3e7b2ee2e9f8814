"""What an EXR file says about itself, and whether it is whole, before it goes to the decoder.

The OpenEXR binding prints to the terminal when it meets a damaged file, and some damage passes it;
the checks here need a few milliseconds and let only whole files through.

Source: "OpenEXR File Layout", openexr.com.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.image_header import check_plausible_size, open_regular

_MAGIC = b"\x76\x2f\x31\x01"
_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000
_PIXEL_BYTES = {0: 4, 1: 2, 2: 4}  # uint32, float16, float32
# Scan lines per chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
_NONE, _ZIPS, _ZIP = 0, 2, 3
_LARGEST_HEADER_BYTES = 1 << 20
_LARGEST_PIXEL_BYTES = 1 << 30


@dataclass(frozen=True)
class ExrHeader:
    """Header of a single-part EXR.

    Attributes:
        width, height: pixels.
        channels: names.
        row_bytes: of one uncompressed scan line, all channels.
        compression: number of the file format.
        tiled: stored in tiles instead of scan lines.
        end: offset of the chunk table.
    """

    width: int
    height: int
    channels: tuple[str, ...]
    row_bytes: int
    compression: int
    tiled: bool
    end: int


def read_exr_header(path: Path) -> ExrHeader:
    """Parse the header.

    Raises:
        ToolkitError: not found, not an EXR, of a kind that is no plain image (deep, several
            parts, cropped, subsampled), or of an implausible size.
    """
    with open_regular(path) as file:
        data = file.read(_LARGEST_HEADER_BYTES)
    try:
        return _parse(path, data)
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise ToolkitError(
            "not a readable EXR file (empty, truncated or mislabelled?)", path=path
        ) from error


def check_whole_exr(path: Path, header: ExrHeader, data: bytes, *, inflate: bool = True) -> None:
    """Refuse a file with missing or damaged chunks.

    Args:
        inflate: also compare the checksums of chunks that zlib compressed.

    Raises:
        ToolkitError: truncated or damaged.
    """
    if header.tiled:
        return
    lines = _LINES[header.compression]
    count = -(-header.height // lines)
    if header.end + 8 * count > len(data):
        raise ToolkitError("the EXR file is truncated", path=path)
    for index, offset in enumerate(struct.unpack_from(f"<{count}Q", data, header.end)):
        if offset == 0 or offset + 8 > len(data):
            raise ToolkitError("the EXR file is truncated", path=path)
        _, size = struct.unpack_from("<ii", data, offset)
        if size < 0 or offset + 8 + size > len(data):
            raise ToolkitError("the EXR file is truncated", path=path)
        raw = header.row_bytes * min(lines, header.height - index * lines)
        damaged = size > raw or (header.compression == _NONE and size != raw)
        if inflate and header.compression in (_ZIPS, _ZIP) and size < raw:
            damaged = not _inflates_to(data[offset + 8 : offset + 8 + size], raw)
        if damaged:
            raise ToolkitError("the EXR file is damaged", path=path, value=f"chunk {index}")


def _parse(path: Path, data: bytes) -> ExrHeader:
    version = struct.unpack_from("<I", data, 4)[0]
    if data[:4] != _MAGIC or version & 0xFF != 2:
        raise ValueError("no EXR")
    if version & (_DEEP | _MULTIPART):
        raise ToolkitError(
            "deep and multi-part EXR files are not read", path=path, hint="save a flat image"
        )
    attributes: dict[str, bytes] = {}
    at = 8
    while data[at] != 0:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        start = type_end + 5
        if size < 0 or start + size > len(data):
            raise ValueError("attribute beyond the end")
        attributes[data[at:name_end].decode("latin-1")] = data[start : start + size]
        at = start + size
    x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    check_plausible_size(path, width, height)
    if struct.unpack("<4i", attributes["displayWindow"]) != (x0, y0, x1, y1):
        raise ToolkitError(
            "the EXR file holds a window of its image only", path=path, hint="save it uncropped"
        )
    channels, row_bytes = _channels(path, attributes["channels"], width)
    if row_bytes * height > _LARGEST_PIXEL_BYTES:
        raise ToolkitError(
            "the image claims an implausible size",
            path=path,
            value=f"{width}x{height}, {len(channels)} channels",
        )
    compression = attributes["compression"][0]
    if compression not in _LINES:
        raise ToolkitError("unknown EXR compression", path=path, value=compression)
    return ExrHeader(
        width, height, channels, row_bytes, compression, bool(version & _TILED), at + 1
    )


def _channels(path: Path, data: bytes, width: int) -> tuple[tuple[str, ...], int]:
    names: list[str] = []
    row_bytes = 0
    at = 0
    while data[at] != 0:
        end = data.index(b"\0", at)
        kind, _, x_step, y_step = struct.unpack_from("<iIii", data, end + 1)
        if (x_step, y_step) != (1, 1):
            raise ToolkitError("subsampled EXR channels are not read", path=path)
        row_bytes += _PIXEL_BYTES[kind] * width
        names.append(data[at:end].decode("latin-1"))
        at = end + 17
    if not names:
        raise ToolkitError("the EXR file holds no channels", path=path)
    return tuple(names), row_bytes


def _inflates_to(chunk: bytes, size: int) -> bool:
    """Whether a zlib stream is whole, its checksum right, and `size` bytes long.

    A chunk is shorter than its pixels and zlib expands 1032 times at most, so no bomb fits in.
    """
    try:
        return len(zlib.decompress(chunk, bufsize=size)) == size
    except zlib.error:
        return False
