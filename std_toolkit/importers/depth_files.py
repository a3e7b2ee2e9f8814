"""Depth images of other programs: 16-bit PNG, EXR with any channels or parts, TIFF, two bytes.

Missing depth is written in many ways. `Missing` tells which numbers of a recording mean it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io import exr, images
from std_toolkit.io.image_header import check_plausible_size
from std_toolkit.io.tiff import TIFF_SUFFIXES, read_tiff
from std_toolkit.settings import NOT_RECORDED, Settings, limit

DEPTH_SUFFIXES = (".png", ".exr", *TIFF_SUFFIXES)
_SATURATED = 65535
# "No depth" of the synthetic half of NOCS.
_NOCS_EMPTY = 32001
# Numbers at which a sensor or a file saturates, whatever the unit; numbers that programs write for
# "nothing", in millimetres and units of 16-bit images; and in metres of floating-point ones.
FULL_SCALE = (65535, 65534, 65504, 32767, 32766, 16383, 8191, 8190, 4095, 4094)
KNOWN_MARKS = (65500, 65000, 60000, 50000, 40000, 32000, 30000, 20000, 10000, 9999)
KNOWN_MARKS_M = (10.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0)
# Marks beyond one another, such as a far plane and a value for the sky.
_ROUNDS = 4


@dataclass(frozen=True, kw_only=True)
class DepthFileSettings(Settings):
    """Which numbers of depth images are no measurements."""

    farthest_m: float = limit(
        65.0, unit="m", source="65.535 m is the end of 16 bits of millimetres; no RGB-D sensor "
        "measures beyond 20 m",
    )  # fmt: skip
    """neither this distance nor one beyond is a measurement"""
    mark_share: float = limit(
        0.005, source="a wall that a sensor measures spreads over many numbers"
    )
    """a number that more of the pixels than this have may be a mark"""
    gap: float = limit(2.0, source="surfaces of one room are seen at all distances")
    """a mark is this many times farther than the farthest measurement (or nearer)"""
    far_m: float = limit(10.0, unit="m", source="the range of RGB-D sensors")
    """beyond this, any number that stands alone is a mark"""
    near_m: float = limit(0.05, unit="m", source="the range of RGB-D sensors begins at 0.1 m")
    """below this, any number that stands alone is a mark"""
    round_mark_m: float = limit(
        5.0, unit="m", source="40000 is a wall at 4 m where the unit is 0.1 mm, 65000 is none"
    )
    """a round number (`KNOWN_MARKS`) that is nearer may be a wall"""
    saturation: float = limit(20.0, source=NOT_RECORDED)
    """a known mark without a gap has this many times the pixels of the numbers below it"""


@dataclass(frozen=True)
class Missing:
    """Which numbers of a recording's depth images are no measurement.

    Attributes:
        values: numbers as stored, beside NaN, infinity, 0 and negative ones.
        unit: metres per number of 16-bit images; None: nothing is known of distances.
        float_unit: metres per number of floating-point images.
    """

    values: tuple[float, ...] = ()
    unit: float | None = None
    float_unit: float = 1.0

    def unit_of(self, values: NDArray[Any]) -> float | None:
        """Metres per number of an image."""
        return self.unit if values.dtype.kind == "u" else self.float_unit


@dataclass(frozen=True)
class ForeignDepth:
    """A depth image as read.

    Attributes:
        values: (H, W) uint16 units, or float16/float32 numbers; 0 = missing.
        converted: whether other encodings of missing depth became 0, so that the file cannot be
            copied.
        marks: numbers that meant "no measurement" -> pixels.
    """

    values: NDArray[Any]
    converted: bool
    marks: Mapping[float, int]


def read_foreign_depth(
    path: Path,
    *,
    size: tuple[int, int],
    missing: Missing | None = None,
    two_bytes: bool = False,
) -> ForeignDepth:
    """Depth of `size` (width, height) from a 16-bit PNG, an EXR, or a TIFF.

    NaN, infinity and negative numbers (DREDS writes -0.001), and the saturated 65535 of 16-bit
    images, mean "no measurement" and become 0. Of an EXR with several channels the one that is
    named Z or depth is taken; without such names it may have one channel or equal ones.

    Args:
        path: the file.
        size: expected (width, height).
        missing: further numbers that become 0, and those beyond the range of any sensor.
        two_bytes: whether a PNG may have depth in its green (high) and red (low) bytes.

    Raises:
        ToolkitError: unreadable, of another size, or not a depth image.
    """
    stored = read_stored_depth(path, size=size, two_bytes=two_bytes)
    empty = ~np.isfinite(stored) | (stored < 0) if stored.dtype.kind == "f" else stored < 0
    if stored.dtype == np.uint16 or path.suffix.lower() in TIFF_SUFFIXES:
        empty = empty | (stored == _SATURATED)
    marks: dict[float, int] = {}
    if missing is not None:
        valid = ~empty & (stored > 0)
        found = [v for v in missing.values if (stored == v).any()]
        found += [v for v in frame_marks(stored[valid], missing.unit_of(stored)) if v not in found]
        for value in found:
            hit = (stored == value) & ~empty
            marks[float(value)] = int(hit.sum())
            empty = empty | hit
        unit = missing.unit_of(stored)
        if unit is not None:
            with np.errstate(over="ignore"):
                far = (stored >= DepthFileSettings.current().farthest_m / unit) & ~empty
            if far.any():
                marks[float(stored[far].max())] = int(far.sum())
                empty = empty | far
    if not empty.any():
        return ForeignDepth(stored, path.suffix.lower() != ".png" or two_bytes, marks)
    return ForeignDepth(np.where(empty, np.zeros((), stored.dtype), stored), True, marks)


def read_stored_depth(
    path: Path, *, size: tuple[int, int], two_bytes: bool = False
) -> NDArray[Any]:
    """The numbers (H, W) of a depth image as stored: uint16, float16 or float32.

    Raises:
        ToolkitError: as `read_foreign_depth`.
    """
    if path.suffix.lower() == ".exr":
        return _exr_depth(path, size)
    if path.suffix.lower() in TIFF_SUFFIXES:
        stored = read_tiff(path)
        check_aligned(path, (stored.shape[1], stored.shape[0]), size)
        if stored.dtype == np.uint8:
            raise ToolkitError("depth in a TIFF must be 16-bit or float", path=path, value="uint8")
        return stored
    if path.suffix.lower() != ".png":
        raise ToolkitError(
            "depth must be a 16-bit PNG, an EXR or a TIFF",
            path=path,
            hint="JPEG and 8-bit lose depth",
        )
    raw = images.read_png(path)
    check_aligned(path, (raw.shape[1], raw.shape[0]), size)
    if two_bytes and raw.dtype == np.uint8 and raw.ndim == 3:
        high, low = (raw[..., i].astype(np.uint16) for i in (1, 0))
        wide = high * 256 + low
        return np.where(wide == _NOCS_EMPTY, np.uint16(0), wide)
    if raw.dtype != np.uint16 or raw.ndim != 2:
        raise ToolkitError(
            "depth must be a single-channel 16-bit PNG",
            path=path,
            value=f"{raw.dtype}, {1 if raw.ndim == 2 else raw.shape[2]} channels",
            hint="a colour-mapped or 8-bit depth image has no metric values",
        )
    return raw


def check_aligned(path: Path, actual: tuple[int, int], size: tuple[int, int]) -> None:
    """Check that depth has the size of its colour image.

    Raises:
        ToolkitError: the sizes differ.
    """
    if actual != size:
        raise ToolkitError(
            f"depth is {actual[0]}x{actual[1]}, colour {size[0]}x{size[1]}: depth is not aligned",
            path=path,
            hint="record or convert depth aligned to colour (RealSense: rs.align(stream.color))",
        )


def frame_marks(values: NDArray[Any], unit: float | None) -> list[float]:
    """Numbers of an image that stand alone at its ends and mean "no measurement".

    A flat surface at a plausible distance is a measurement, also where all its pixels are equal.

    Args:
        values: (N,) positive finite numbers as stored.
        unit: metres per number; None finds nothing.
    """
    if unit is None or not values.size:
        return []
    limits = DepthFileSettings.current()
    total = values.size
    found: list[float] = []
    for _ in range(_ROUNDS):
        if not values.size:
            return found
        top = values.max()
        below = values[values < top]
        count = values.size - below.size
        if float(top) * unit < limits.farthest_m:
            if not _is_far_mark(top, count, total, below, unit, limits):
                break
            found.append(float(top))
        values = below
    if values.size:
        low = values.min()
        above = values[values > low]
        alone = above.size and float(above.min()) >= limits.gap * float(low)
        share = (values.size - above.size) / total
        if alone and float(low) * unit < limits.near_m and share > limits.mark_share:
            found.append(float(low))
    return found


def _is_far_mark(
    top: Any, count: int, total: int, below: NDArray[Any], unit: float,
    limits: DepthFileSettings,
) -> bool:  # fmt: skip
    if count <= limits.mark_share * total:
        return False
    value = float(top)
    is_round = value in KNOWN_MARKS and value * unit > limits.round_mark_m
    known = value in FULL_SCALE or is_round or (below.dtype.kind == "f" and value in KNOWN_MARKS_M)
    farthest = float(below.max()) if below.size else 0.0
    if farthest * limits.gap <= value:
        return known or (below.size > 0 and value * unit > limits.far_m)
    if not known or below.dtype.kind != "u":
        return False
    near = below[below > 0.9 * value].size / (0.1 * value)
    return count > limits.saturation * max(near, 1.0)


def lone_values(values: NDArray[Any], unit: float) -> list[float]:
    """Numbers that stand alone at the far end and are no certain marks: the user may know."""
    limits = DepthFileSettings.current()
    if not values.size:
        return []
    top = values.max()
    below = values[values < top]
    often = values.size - below.size > limits.mark_share * values.size
    alone = below.size > 0 and float(below.max()) * limits.gap <= float(top)
    return [float(top)] if often and alone and float(top) * unit <= limits.far_m else []


def _exr_depth(path: Path, size: tuple[int, int]) -> NDArray[np.floating]:
    if _is_multipart(path):
        channels = _parts(path, size)
    else:
        check_aligned(path, exr.exr_size(path), size)
        channels = exr.read_exr(path)
    name = _depth_channel(path, sorted(channels))
    chosen = channels[name]
    others = [channels[c] for c in "GB" if c in channels] if name == "R" else []
    if any(not np.array_equal(c, chosen, equal_nan=True) for c in others):
        raise ToolkitError(
            "the EXR file is a colour image, not depth: its channels differ", path=path
        )
    if chosen.dtype not in (np.float16, np.float32):
        raise ToolkitError("depth in an EXR must be float", path=path, value=str(chosen.dtype))
    return chosen


def _depth_channel(path: Path, names: Sequence[str]) -> str:
    """Name of the channel with depth: Z, a channel of a layer "depth", or the only one."""
    if len(names) == 1:
        return names[0]
    if {"Y", "RY", "BY"} <= set(names):
        raise ToolkitError("the EXR file is a colour image, not depth", path=path, value=names)
    words = {n: n.lower().split(".") for n in names}
    of_depth = [
        n for n, w in words.items()
        if w[-1] in ("z", "depth", "distance") or any("depth" in x for x in w)
    ]  # fmt: skip
    # Blender files fog and denoised copies beside its depth.
    of_depth = [n for n in of_depth if not any(x in n.lower() for x in ("mist", "noisy", "albedo"))]
    plain = [n for n in of_depth if n in ("Z", "depth", "Depth")]
    if len(plain or of_depth) == 1:
        return (plain or of_depth)[0]
    if not of_depth and (plain := [n for n in ("Y", "V", "R") if n in names]):
        return plain[0]
    raise ToolkitError(
        "the EXR file has no depth channel (Y, Z or R)" if not of_depth
        else "several channels of the EXR file could be depth",
        path=path, value=of_depth or list(names), hint="save the depth alone",
    )  # fmt: skip


def _is_multipart(path: Path) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(8)
    return head[:4] == b"\x76\x2f\x31\x01" and bool(int.from_bytes(head[4:8], "little") & 0x1000)


def _parts(path: Path, size: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """Channels of all parts of the image's size; the name of the part comes first."""
    import OpenEXR

    found: dict[str, NDArray[Any]] = {}
    try:
        with OpenEXR.File(str(path), header_only=True) as head:
            sizes = []
            for part in head.parts:
                low, high = part.header["dataWindow"]
                sizes.append((int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1))
        for width, height in sizes:
            check_plausible_size(path, width, height)
        with OpenEXR.File(str(path), separate_channels=True) as file:
            for i, part in enumerate(file.parts):
                title = str(part.header.get("name", i))
                for name, channel in part.channels.items():
                    key = name if name.lower().startswith(title.lower()) else f"{title}.{name}"
                    if sizes[i] == size:
                        found[key] = np.array(channel.pixels)
    except ToolkitError:
        raise
    except Exception as error:  # the binding raises bare RuntimeError and worse
        raise ToolkitError(f"cannot decode the EXR file: {error}", path=path) from error
    if not found:
        check_aligned(path, sizes[0], size)
        raise ToolkitError("the EXR file has no channels", path=path)
    return found
