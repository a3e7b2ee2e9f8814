"""What a PNG or JPEG file says about itself, and whether it is whole, before pixels are decoded.

The headers are parsed here instead of by an image library, because the answer must not depend on
decoding anything, and because decoders are silent about what matters: OpenCV fills the missing
part of a truncated JPEG with grey and reduces 16-bit colour to 8 bits.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from std_toolkit.errors import ToolkitError

# A compressed file of a few kilobytes can claim gigapixels; no camera of this field does.
LARGEST_PIXEL_COUNT = 64_000_000
LARGEST_FILE_BYTES = 512 * 1024 * 1024
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
# Start-of-frame markers; C4, C8 and CC in their midst mean other things.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# In the entropy-coded part, FF is followed by 00 (a stuffed byte), a restart marker, or the end.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


@dataclass(frozen=True)
class ImageHeader:
    """Header of an image file.

    Attributes:
        format: by content, whatever the file's name says.
        width, height: pixels.
        bits: per channel.
        channels: as decoded: a palette has 3, grey with alpha 2.
    """

    format: Literal["png", "jpeg"]
    width: int
    height: int
    bits: int
    channels: int


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file; a pipe or device in its place could block or never end.

    Raises:
        ToolkitError: not found, not a file, not readable or implausibly large.
    """
    if not path.is_file():
        problem = "is not a regular file" if path.exists() else "image file not found"
        raise ToolkitError(problem, path=path)
    try:
        if path.stat().st_size > LARGEST_FILE_BYTES:
            raise ToolkitError("the image file is implausibly large", path=path)
        return path.open("rb")
    except OSError as error:
        raise ToolkitError(f"cannot read the image: {error.strerror}", path=path) from error


def read_header(path: Path) -> ImageHeader:
    """Header of a PNG or JPEG file.

    Raises:
        ToolkitError: not found, neither PNG nor JPEG, named as the other of the two, or of an
            implausible size.
    """
    with open_regular(path) as file:
        start = file.read(8)
        header = None
        if start == PNG_SIGNATURE:
            header = _png_header(file)
        elif start[:3] == b"\xff\xd8\xff":
            header = _jpeg_header(file)
    if header is None:
        raise ToolkitError(
            "not a readable PNG or JPEG image (empty, truncated or mislabelled?)", path=path
        )
    expected = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}.get(path.suffix.lower())
    if expected != header.format:
        raise ToolkitError(
            f"the file is {header.format.upper()}, its name says otherwise",
            path=path,
            value=path.suffix,
            hint="rename or convert it",
        )
    check_plausible_size(path, header.width, header.height)
    return header


def check_plausible_size(path: Path, width: int, height: int) -> None:
    """Refuse a size that would only fill the memory.

    Raises:
        ToolkitError: no pixels, or more than any camera has.
    """
    if width <= 0 or height <= 0 or width * height > LARGEST_PIXEL_COUNT:
        raise ToolkitError(
            "the image claims an implausible size", path=path, value=f"{width}x{height}"
        )


def check_whole(path: Path, data: bytes, header: ImageHeader) -> None:
    """Refuse a file that ends early, or (PNG) whose checksums are wrong.

    Raises:
        ToolkitError: truncated or damaged.
    """
    if header.format == "png":
        _check_whole_png(path, data)
    elif not _jpeg_ends(data):
        raise ToolkitError("the JPEG file is truncated", path=path)


def _png_header(file: BinaryIO) -> ImageHeader | None:
    chunk = file.read(25)
    if len(chunk) < 25 or chunk[:8] != b"\x00\x00\x00\rIHDR":
        return None
    width, height, bits, colour = struct.unpack_from(">IIBB", chunk, 8)
    if colour not in _PNG_CHANNELS or bits not in (1, 2, 4, 8, 16):
        return None
    # A palette's entries are 8-bit whatever the width of its indices.
    return ImageHeader("png", width, height, 8 if colour == 3 else bits, _PNG_CHANNELS[colour])


def _jpeg_header(file: BinaryIO) -> ImageHeader | None:
    file.seek(2)
    while True:
        byte = file.read(1)
        if byte != b"\xff":
            return None
        while byte == b"\xff":  # fill bytes
            byte = file.read(1)
        length = file.read(2)
        if not byte or len(length) < 2 or byte in (b"\xd9", b"\xda"):
            return None
        if byte[0] in _JPEG_FRAMES:
            frame = file.read(6)
            if len(frame) < 6:
                return None
            bits, height, width, channels = struct.unpack(">BHHB", frame)
            return ImageHeader("jpeg", width, height, bits, channels)
        file.seek(struct.unpack(">H", length)[0] - 2, 1)


def _check_whole_png(path: Path, data: bytes) -> None:
    view = memoryview(data)
    at = len(PNG_SIGNATURE)
    pixels = False
    while at + 12 <= len(view):
        (length,) = struct.unpack_from(">I", view, at)
        end = at + 12 + length
        if end > len(view):
            break
        kind = bytes(view[at + 4 : at + 8])
        (checksum,) = struct.unpack_from(">I", view, end - 4)
        if zlib.crc32(view[at + 4 : end - 4]) != checksum:
            raise ToolkitError("the PNG file is damaged (a checksum is wrong)", path=path)
        pixels = pixels or kind == b"IDAT"
        if kind == b"IEND":
            if not pixels:
                raise ToolkitError("the PNG file holds no pixels", path=path)
            return
        at = end
    raise ToolkitError("the PNG file is truncated", path=path)


def _jpeg_ends(data: bytes) -> bool:
    """Whether the end marker of the image follows its scans (an embedded thumbnail has its own)."""
    at = 2
    while at + 4 <= len(data) or data[at : at + 2] == b"\xff\xd9":
        if data[at] != 0xFF:
            return False
        marker = data[at + 1]
        if marker == 0xFF:
            at += 1
            continue
        if marker == 0xD9:
            return True
        (length,) = struct.unpack_from(">H", data, at + 2)
        at += 2 + length
        if marker == 0xDA:
            following = _JPEG_MARKER.search(data, at)
            if following is None:
                return False
            at = following.start()
    return False
