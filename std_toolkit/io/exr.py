"""OpenEXR files through the OpenEXR package (the headless OpenCV wheel reads none)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import atomic_path
from std_toolkit.io.exr_header import check_whole_exr, read_exr_header
from std_toolkit.io.image_header import open_regular

# "zips" compresses single scan lines; with level 1 it is as fast as no compression on sparse maps.
COMPRESSIONS = ("none", "zips", "zip", "piz")
_DTYPES = (np.float16, np.float32, np.uint32)


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
    header = read_exr_header(path)
    with open_regular(path) as whole:
        check_whole_exr(path, header, whole.read())
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises bare RuntimeError and worse
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error


def read_exr_channel(
    path: Path | str,
    names: tuple[str, ...] = ("Y", "Z", "V", "R"),
    *,
    require_equal: bool = False,
) -> NDArray[np.generic]:
    """One channel of an EXR, (H, W) in its stored type: for reading many files quickly.

    The first of `names` that is there is taken, or the only channel. Chunks are inflated once, by
    the decoder, which compares their checksums; `read_exr` inflates them beforehand as well,
    because the decoder prints to the terminal what it finds wrong.

    Args:
        names: of the channel, the best first.
        require_equal: refuse a file whose R, G and B differ: a picture, not a map.

    Raises:
        ToolkitError: unreadable, truncated or damaged, no such channel, or unequal ones.
    """
    import OpenEXR

    path = Path(path)
    header = read_exr_header(path)
    name = next((n for n in names if n in header.channels), None)
    if name is None:
        if len(header.channels) != 1:
            raise ToolkitError(
                f"the EXR file holds no channel {' or '.join(names)}",
                path=path,
                value=header.channels,
            )
        name = header.channels[0]
    with open_regular(path) as whole:
        check_whole_exr(path, header, whole.read(), inflate=False)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as image:
            channels = image.channels()
            pixels: NDArray[np.generic] = channels[name].pixels
            others = [n for n in "RGB" if n != name and n in channels]
            if require_equal and not all(_same(pixels, channels[n].pixels) for n in others):
                raise ToolkitError(
                    "the EXR file holds a picture, not a map: its channels differ", path=path
                )
            return pixels.copy()
    except ToolkitError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError and worse
        with open_regular(path) as whole:
            check_whole_exr(path, header, whole.read())
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error


def read_exr_depth(path: Path | str) -> NDArray[np.float32]:
    """The depth channel of an EXR as stored, (H, W) float32.

    It is the channel Y, Z or V, the only channel, or R where G and B hold the same (how tools
    without single-channel EXR save depth).

    Raises:
        ToolkitError: unreadable, no channel that could be depth, R, G and B that differ (a
            picture or normals), or integers (whose unit nobody knows).
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
                    "depth has one channel, or three equal ones; here R, G and B differ",
                    path=path,
                    hint="is this a picture or a normal map?",
                )
    if name is None:
        raise ToolkitError(
            "the EXR file holds no depth channel (Y, Z or R)", path=path, value=sorted(channels)
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
    """Whether all bits are the same, those of NaN included."""
    kinds = {2: np.uint16, 4: np.uint32}
    return a.dtype == b.dtype and np.array_equal(
        a.view(kinds[a.itemsize]), b.view(kinds[b.itemsize])
    )
