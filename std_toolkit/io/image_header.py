"""Headers and completeness of PNG and JPEG files, checked before pixels are decoded.

Pillow parses the headers and compares the checksums of a PNG without decoding it. This module
searches for the end of a JPEG, because Pillow's `verify` does nothing for JPEG and OpenCV fills
the missing part of a truncated one with grey.
"""

import io
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from std_toolkit.errors import ToolkitError

# A compressed file of a few kilobytes can claim gigapixels; no supported camera has as many.
LARGEST_PIXEL_COUNT = 64_000_000
LARGEST_FILE_BYTES = 512 * 1024 * 1024
# In the entropy-coded part, FF is followed by 00 (a stuffed byte), a restart marker, or the end.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
# Pillow does not compare the checksum of this last chunk; OpenCV then swaps red and blue.
_PNG_END = b"\0\0\0\0IEND\xae\x42\x60\x82"
# Exceptions of Pillow for damaged files.
_DAMAGE = (OSError, SyntaxError, ValueError, LookupError, TypeError, struct.error)


@dataclass(frozen=True)
class ImageHeader:
    """Header of an image file.

    Attributes:
        format: detected from the content, not from the file name.
        width, height: pixels.
        bits: bits per channel.
        channels: number of decoded channels: 3 for a palette, 2 for grey with alpha.
    """

    format: Literal["png", "jpeg"]
    width: int
    height: int
    bits: int
    channels: int


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file; reading a pipe or device could block or never end.

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
        ToolkitError: not found, neither PNG nor JPEG, with the suffix of the other, or of an
            implausible size.
    """
    try:
        with open_regular(path) as file:
            header = _header(file)
    except _DAMAGE as error:
        raise ToolkitError(
            "not a readable PNG or JPEG image (empty, truncated or mislabelled?)", path=path
        ) from error
    expected = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}.get(path.suffix.lower())
    if expected != header.format:
        raise ToolkitError(
            f"the file is {header.format.upper()}, but its name has another suffix",
            path=path,
            value=path.suffix,
            hint="rename or convert it",
        )
    check_plausible_size(path, header.width, header.height)
    return header


def header_of(data: bytes, path: Path) -> ImageHeader:
    """Header of a PNG or JPEG image within another file.

    Args:
        data: of the image.
        path: of the file that holds it, for errors.

    Raises:
        ToolkitError: neither PNG nor JPEG, or of an implausible size.
    """
    try:
        header = _header(io.BytesIO(data))
    except _DAMAGE as error:
        raise ToolkitError("holds no readable PNG or JPEG image", path=path) from error
    check_plausible_size(path, header.width, header.height)
    return header


def check_plausible_size(path: Path, width: int, height: int) -> None:
    """Check that the image size is plausible.

    Raises:
        ToolkitError: no pixels, or more than any camera has.
    """
    if width <= 0 or height <= 0 or width * height > LARGEST_PIXEL_COUNT:
        raise ToolkitError(
            "the image has an implausible size", path=path, value=f"{width}x{height}"
        )


def check_whole(path: Path, data: bytes, header: ImageHeader) -> None:
    """Check that a file is complete and, for PNG, that its checksums are right.

    Raises:
        ToolkitError: truncated or damaged.
    """
    if header.format == "jpeg":
        if not _jpeg_ends(data):
            raise ToolkitError("the JPEG file is truncated", path=path)
        return
    try:
        PngImageFile(io.BytesIO(data)).verify()
        if _PNG_END not in data:
            raise ValueError("wrong checksum of its end")
    except _DAMAGE as error:
        raise ToolkitError(f"the PNG file is truncated or damaged: {error}", path=path) from error


def _header(file: BinaryIO) -> ImageHeader:
    is_jpeg = file.read(3) == b"\xff\xd8\xff"
    file.seek(0)
    if is_jpeg:
        jpeg = JpegImageFile(file)
        return ImageHeader("jpeg", *jpeg.size, jpeg.bits, jpeg.layers)
    png = PngImageFile(file)
    # Pixel format, such as "L", "L;4", "RGB;16B", "P;2" or "1".
    mode, _, bits = str(png.tile[0].args).partition(";")
    if mode == "P":  # palette entries are 8-bit for any width of the indices
        return ImageHeader("png", *png.size, 8, 3)
    return ImageHeader(
        "png", *png.size, int(bits.rstrip("B") or 8 if mode != "1" else 1), len(mode)
    )


def _jpeg_ends(data: bytes) -> bool:
    """Whether the end marker of the image follows its scans; a thumbnail has its own marker."""
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
