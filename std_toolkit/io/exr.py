"""OpenEXR files: headers checked before decoding, reading, writing.

The module parses the header itself. The OpenEXR binding (`header_only`) accepts cropped images,
gigapixels and files that end after the header, and gives neither the pixel types nor the position
of the chunk table, which are needed to check the chunks. Its decoder prints to the terminal at a
damaged chunk and does not detect some damage.

Source: "OpenEXR File Layout", openexr.com.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.image_header import check_plausible_size, open_regular

# "zips" compresses single scan lines; with level 1 it is as fast as no compression on sparse maps.
COMPRESSIONS = ("none", "rle", "zips", "zip", "piz")

_DTYPES = (np.float16, np.float32, np.uint32)

_MAGIC = b"\x76\x2f\x31\x01"

_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000

_PIXEL_BYTES = {0: 4, 1: 2, 2: 4}  # uint32, float16, float32

# Scan lines per chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}

_NONE, _ZIPS, _ZIP = 0, 2, 3

_LARGEST_HEADER_BYTES = 1 << 20

_LARGEST_PIXEL_BYTES = 1 << 30


def exr_size(path: Path | str) -> tuple[int, int]:
    """(width, height) of an EXR from its header, without decoding.

    Raises:
        ToolkitError: not found, not an EXR, or of an implausible size.
    """
    header = read_exr_header(Path(path))
    return header.width, header.height


def read_exr(path: Path | str) -> dict[str, NDArray[np.generic]]:
    """All channels of an EXR, each (H, W) in its stored type (float16, float32 or uint32).

    Raises:
        ToolkitError: unreadable, truncated or damaged.
    """
    import OpenEXR

    path = Path(path)
    data = _read(path)
    check_whole_exr(path, _header(path, data), data)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: channel.pixels for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeError and worse
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error


def read_exr_channel(
    path: Path | str,
    names: tuple[str, ...] = ("Y", "Z", "V", "R"),
    *,
    require_equal: bool = False,
) -> NDArray[np.generic]:
    """One channel of an EXR, (H, W) in its stored type: for reading many files quickly.

    Returns the first of `names` that exists, or the only channel. The decoder inflates chunks once
    and compares their checksums. `read_exr` also inflates them beforehand, because the decoder
    prints errors to the terminal.

    Args:
        names: names of the channel, in order of preference.
        require_equal: reject a file whose R, G and B differ (a picture, not a map).

    Raises:
        ToolkitError: unreadable, truncated or damaged, no such channel, or unequal ones.
    """
    import OpenEXR

    path = Path(path)
    data = _read(path)
    header = _header(path, data)
    name = next((n for n in names if n in header.channels), None)
    if name is None:
        if len(header.channels) != 1:
            raise ToolkitError(
                f"the EXR file has no channel {' or '.join(names)}",
                path=path,
                value=header.channels,
            )
        name = header.channels[0]
    check_whole_exr(path, header, data, inflate=False)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as image:
            channels = image.channels()
            pixels: NDArray[np.generic] = channels[name].pixels
            others = [n for n in "RGB" if n != name and n in channels]
            if require_equal and not all(_same(pixels, channels[n].pixels) for n in others):
                raise ToolkitError(
                    "the EXR file is a picture, not a map: its channels differ", path=path
                )
            return pixels
    except ToolkitError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError and worse
        check_whole_exr(path, header, data)
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error


def read_exr_depth(path: Path | str) -> NDArray[np.float32]:
    """The depth channel of an EXR as stored, (H, W) float32.

    It is the channel Y, Z or V, the only channel, or R if G and B are equal to it (tools without
    single-channel EXR save depth this way).

    Raises:
        ToolkitError: unreadable, no channel that could be depth, R, G and B that differ (a
            picture or normals), or integers (of unknown unit).
    """
    channels = read_exr(path)
    name: str | None = next((n for n in ("Y", "Z", "V") if n in channels), None)
    if name is None and len(channels) == 1:
        name = next(iter(channels))
    if name is None and "R" in channels:
        name = "R"
        for other in ("G", "B"):
            if other not in channels or not np.array_equal(
                channels["R"], channels[other], equal_nan=True
            ):
                raise ToolkitError(
                    "depth must have one channel or three equal ones; R, G and B differ",
                    path=path,
                    hint="is this a picture or a normal map?",
                )
    if name is None:
        raise ToolkitError(
            "the EXR file has no depth channel (Y, Z or R)", path=path, value=sorted(channels)
        )
    if channels[name].dtype == np.uint32:
        raise ToolkitError(
            "EXR depth must be float16 or float32, in metres", path=path, field=name, value="uint32"
        )
    return channels[name].astype(np.float32)


def write_exr(
    path: Path | str, channels: dict[str, NDArray[np.generic]], *, compression: str = "zips"
) -> None:
    """Write channels of equal shape (H, W), atomically and deterministically.

    Args:
        channels: by name; float16, float32 or uint32.
        compression: one of `COMPRESSIONS`.

    Raises:
        ToolkitError: no channels, unequal shapes, another type, or an unknown compression.
    """
    import OpenEXR

    kinds = {
        "none": OpenEXR.NO_COMPRESSION,
        "rle": OpenEXR.RLE_COMPRESSION,
        "zips": OpenEXR.ZIPS_COMPRESSION,
        "zip": OpenEXR.ZIP_COMPRESSION,
        "piz": OpenEXR.PIZ_COMPRESSION,
    }
    if compression not in kinds:
        raise ToolkitError(
            "unknown EXR compression", path=path, value=compression, hint=f"one of {COMPRESSIONS}"
        )
    pixels = {name: np.ascontiguousarray(value) for name, value in channels.items()}
    shapes = {value.shape for value in pixels.values()}
    if len(shapes) != 1 or any(v.ndim != 2 or v.dtype not in _DTYPES for v in pixels.values()):
        raise ToolkitError(
            "EXR channels must be (H, W) of one size and float16, float32 or uint32",
            path=path,
            value={name: f"{v.dtype} {v.shape}" for name, v in pixels.items()},
        )
    header = {"compression": kinds[compression], "type": OpenEXR.scanlineimage}
    with atomic_path(path) as temporary, OpenEXR.File(header, pixels) as file:
        file.write(str(temporary))


def _same(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    """Whether all bits are equal, including those of NaN."""
    kinds = {2: np.uint16, 4: np.uint32}
    return a.dtype == b.dtype and np.array_equal(
        a.view(kinds[a.itemsize]), b.view(kinds[b.itemsize])
    )


@dataclass(frozen=True)
class ExrHeader:
    """Header of a single-part EXR.

    Attributes:
        width, height: pixels.
        channels: names.
        row_bytes: size of one uncompressed scan line, all channels.
        compression: its number in the file format.
        tiled: whether it is stored in tiles instead of scan lines.
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
        ToolkitError: not found, not an EXR, not a plain image (deep, several parts, cropped,
            subsampled), or of an implausible size.
    """
    return _header(path, _read(path, _LARGEST_HEADER_BYTES))


def _read(path: Path, size: int = -1) -> bytes:
    with open_regular(path) as file:
        return file.read(size)


def _header(path: Path, data: bytes) -> ExrHeader:
    try:
        return _parse(path, data)
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise ToolkitError(
            "not a readable EXR file (empty, truncated or mislabelled?)", path=path
        ) from error


def check_whole_exr(path: Path, header: ExrHeader, data: bytes, *, inflate: bool = True) -> None:
    """Check a file for missing or damaged chunks.

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
            "deep and multi-part EXR files are not supported", path=path, hint="save a flat image"
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
            "the EXR file contains only a window of its image", path=path, hint="save it uncropped"
        )
    channels, row_bytes = _channels(path, attributes["channels"], width)
    if row_bytes * height > _LARGEST_PIXEL_BYTES:
        raise ToolkitError(
            "the image has an implausible size",
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
            raise ToolkitError("subsampled EXR channels are not supported", path=path)
        row_bytes += _PIXEL_BYTES[kind] * width
        names.append(data[at:end].decode("latin-1"))
        at = end + 17
    if not names:
        raise ToolkitError("the EXR file has no channels", path=path)
    return tuple(names), row_bytes


def _inflates_to(chunk: bytes, size: int) -> bool:
    """Whether a zlib stream is complete, has the right checksum, and is `size` bytes long.

    A chunk is shorter than its pixels and zlib expands at most 1032 times, which excludes
    decompression bombs.
    """
    try:
        return len(zlib.decompress(chunk, bufsize=size)) == size
    except zlib.error:
        return False
