"""Folders of depth that other programs predicted, as they lie: files of frames, and their unit.

DIR/SCENE/FRAME.png, .exr, .npy, .npz, .tif or .pfm; FRAME_depth.png; FRAME_spread.png beside it for
its expected error; in `depth/` or `depth_restored/` below the scene; with the suffix of the data
set's raw depth, as `std-bench --save-depth` writes it; and what `FrameFiles` finds.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import DepthFrame, resize_nearest
from benchmark.data.identity import SAVED_DEPTH, SAVED_SPREAD
from benchmark.data.loading import check_proportions
from benchmark.data.prediction_files import FrameFiles
from benchmark.data.splits import (
    DepthSource,
    FrameKey,
    Inputs,
    SceneFiles,
    inputs_of,
    saved_depth_path,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr_channel
from std_toolkit.io.foreign_files import read_npy, read_npz
from std_toolkit.io.image_header import check_plausible_size
from std_toolkit.io.images import read_png
from std_toolkit.io.tiff import TIFF_SUFFIXES, read_tiff

SUFFIXES = (".png", ".exr", ".npy", ".npz", ".pfm", *TIFF_SUFFIXES)
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "0.1mm": 0.0001}

# Factors by which a wrong unit is wrong: metres and millimetres, 0.1 and 0.25 mm, quarters.
_FACTORS = (4.0, 10.0, 100.0, 1000.0, 4000.0, 10_000.0)
_NEAR = 1.15

_LARGEST_HEADER = 200


def unit_of(text: str) -> float:
    """Return metres per number of a unit: m, cm, mm, 0.1mm, or the number itself.

    Raises:
        ToolkitError: no unit.

    >>> unit_of("mm"), unit_of("0.00025")
    (0.001, 0.00025)
    """
    try:
        value = UNITS[text] if text in UNITS else float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < 1000:
        known = ", ".join(UNITS)
        raise ToolkitError(f"expected {known}, or metres per number", field="unit", value=text)
    return value


def read_prediction(path: Path, unit: float | None = None) -> NDArray[np.float32]:
    """Read predicted depth.

    Args:
        path: of the file.
        unit: metres per number; by default millimetres in 16-bit images and arrays of whole
            numbers, metres in those of floating-point numbers.

    Returns:
        (h, w) metres of any size; 0 where there is none: NaN, infinite, 0 or negative.

    Raises:
        ToolkitError: missing, damaged, or no depth.
    """
    stored = _stored(path)
    if stored.ndim != 2 or stored.size == 0 or stored.dtype.kind not in "uif":
        raise ToolkitError(
            "depth must be one image (h, w) of numbers",
            path=path,
            value=f"{stored.dtype} {stored.shape}",
        )
    if stored.dtype == np.uint8:
        raise ToolkitError(
            "8-bit images hold no metric depth",
            path=path,
            hint="16-bit millimetres, or floating-point metres",
        )
    check_plausible_size(path, stored.shape[1], stored.shape[0])
    if unit is None:
        unit = UNITS["m" if stored.dtype.kind == "f" else "mm"]
    depth = stored.astype(np.float32)
    if unit != 1:
        depth *= np.float32(unit)
    depth[~(np.isfinite(depth) & (depth > 0))] = 0
    return depth


def _stored(path: Path) -> NDArray[Any]:
    suffix = path.suffix.lower()
    if suffix == ".exr":
        return read_exr_channel(path, require_equal=True)
    if suffix == ".png":
        return read_png(path)
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path)
    if suffix == ".pfm":
        return _read_pfm(path)
    if suffix == ".npz":
        arrays = read_npz(path)
        name = "depth" if "depth" in arrays else next(iter(arrays), "")
        if len(arrays) > 1 and name != "depth":
            raise ToolkitError("several arrays, none called depth", path=path, value=list(arrays))
        return np.squeeze(arrays[name]) if arrays else np.zeros(0)
    if suffix == ".npy":
        return np.squeeze(read_npy(path))
    raise ToolkitError("is no file of depth", path=path, hint=f"expected {', '.join(SUFFIXES)}")


def _read_pfm(path: Path) -> NDArray[np.float32]:
    """One channel of a portable float map: rows from the bottom, the sign of the scale is order."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ToolkitError(f"cannot be read: {error.strerror}", path=path) from error
    words = data[:_LARGEST_HEADER].split(maxsplit=4)
    try:
        kind, width, height = words[0], int(words[1]), int(words[2])
        scale = words[3].decode("ascii")
        order = "<f4" if float(scale) < 0 else ">f4"
    except (IndexError, ValueError) as error:
        raise ToolkitError("is no portable float map", path=path) from error
    if kind != b"Pf":
        raise ToolkitError("must have one channel (Pf)", path=path, value=repr(kind))
    check_plausible_size(path, width, height)
    begin = data.index(words[3], len(b"Pf ")) + len(words[3]) + 1
    values = data[begin:]
    if len(values) != 4 * width * height:
        raise ToolkitError(
            "the file is cut off or too long",
            path=path,
            value=f"{len(values)} bytes",
            hint=f"{width}x{height} are {4 * width * height} bytes",
        )
    return np.frombuffer(values, order).reshape(height, width)[::-1].astype(np.float32)


@dataclass(frozen=True)
class DepthFolder(FrameFiles):
    """A folder of predicted depth; see `FrameFiles`.

    Attributes:
        unit: metres per number; None: by the type of the file.
    """

    content: ClassVar[str] = SAVED_DEPTH
    suffixes: ClassVar[tuple[str, ...]] = SUFFIXES
    endings: ClassVar[tuple[str, ...]] = ("", "_depth")
    below: ClassVar[tuple[str, ...]] = ("", "depth", "depth_restored")
    unit: float | None = None

    def own_path(self, key: FrameKey) -> Path:
        return saved_depth_path(self.folder, self.split, key)

    def read(self, key: FrameKey) -> NDArray[np.float32]:
        """Read the depth of a frame; see `read_prediction`."""
        return read_prediction(self.path(key), self.unit)

    def files(self, key: FrameKey) -> dict[str, Path]:
        path = self.path(key)
        spread = self._spread_path(path, key)
        return {self.content: path} | ({} if spread is None else {SAVED_SPREAD: spread})

    def spread(self, key: FrameKey) -> NDArray[np.float32] | None:
        """Read the expected error of a frame's depth: NAME_spread beside it, in the same unit.

        Returns:
            Metres of the size of the depth, infinite where the file has none; None without a file.

        Raises:
            ToolkitError: two files, a damaged one, or of another size than the depth.
        """
        path = self.path(key)
        beside = self._spread_path(path, key)
        if beside is None:
            return None
        spread = read_prediction(beside, self.unit)
        if spread.shape != (wanted := read_prediction(path, self.unit).shape):
            raise ToolkitError(
                "the spread has another size than the depth",
                path=beside,
                value="{1}x{0}".format(*spread.shape),
                hint="{1}x{0} is expected".format(*wanted),
            )
        return np.where(spread > 0, spread, np.float32(np.inf))

    def _spread_path(self, path: Path, key: FrameKey) -> Path | None:
        names = self._names_in(path.parent)
        stems = (key.name, *self.joined(key))
        found = [f"{s}_spread{x}" for s in stems for x in SUFFIXES if f"{s}_spread{x}" in names]
        if len(found) > 1:
            raise ToolkitError(
                "two files could be the spread of the frame",
                path=path.with_name(found[0]),
                value=found[1],
                hint="leave one of them",
            )
        return path.with_name(found[0]) if found else None


@dataclass(frozen=True)
class WithSavedDepth:
    """Frames of `source` with predicted depth of a folder instead of sensor depth.

    See `DepthSource`.
    """

    source: DepthSource
    answers: DepthFolder

    @property
    def name(self) -> str:
        return self.source.name

    def __len__(self) -> int:
        return len(self.source)

    def keys(self) -> list[FrameKey]:
        return self.source.keys()

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:
        """See `DepthSource`."""
        frame = self.source.load(index, sensor=sensor, nocs=nocs)
        key = FrameKey(frame.scene, frame.name)
        path = self.answers.path(key)
        depth = read_prediction(path, self.answers.unit)
        check_proportions(path, depth, frame.camera.size)
        return replace(frame, depth_raw=depth)

    def inputs(self, index: int, *, nocs: bool = False) -> Inputs:
        """See `DepthSource`; without the saved depth, which is an answer and no data."""
        return inputs_of(self.source, index, nocs=nocs)

    def files(self) -> Iterator[SceneFiles]:
        """See `DepthSource`."""
        return self.source.files()


def check_predictions(
    data: WithSavedDepth, frames: Sequence[int], *, tried: int = 5, metric: bool = True
) -> str:
    """Look at a few predictions before all are scored.

    The unit is never taken from the truth; but depth that is another unit off is refused.

    Args:
        data: the frames.
        frames: those that are to be scored.
        tried: number of predictions to read, spread over the frames.
        metric: whether they are to be metres; else no unit is wrong.

    Returns:
        What the files are, for people: type, unit, median depth.

    Raises:
        ToolkitError: no frame has a file, a file cannot be read or has other proportions, or the
            median of depth over truth is near a factor by which units differ.
    """
    keys = data.keys()
    there = [i for i in frames if data.answers.path(keys[i]).is_file()]
    if not there:
        first = keys[frames[0]]
        raise ToolkitError(
            f"no file of any of the {len(frames)} frames",
            path=data.answers.folder,
            value=str(first),
            hint=f"expected {first.scene}/{first.name}.png, .exr, .npy, ..., or folders above it",
        )
    ratios, medians = [], []
    for index in there[:: max(1, len(there) // tried)][:tried]:
        frame = data.load(index, sensor=False)
        true = frame.depth_true
        answer = resize_nearest(frame.depth_raw, (true.shape[1], true.shape[0]))
        both = (answer > 0) & (true > 0)
        if both.any():
            ratios.append(float(np.median(answer[both] / true[both])))
            medians.append(float(np.median(answer[both])))
    path = data.answers.path(keys[there[0]])
    unit = data.answers.unit or (1.0 if _stored(path).dtype.kind == "f" else 0.001)
    told = next((name for name, metres in UNITS.items() if metres == unit), f"{unit:g} m")
    if not metric:
        return f"{path.suffix}, aligned"
    if not ratios:
        return f"{path.suffix} in {told}"
    ratio = float(np.median(ratios))
    for factor in _FACTORS:
        for off in (factor, 1 / factor):
            if off / _NEAR < ratio < off * _NEAR:
                likely = unit / off
                name = next((n for n, m in UNITS.items() if abs(m / likely - 1) < 0.01), "")
                raise ToolkitError(
                    f"the depth is about {ratio:.3g} times the true depth: it was read in {told}, "
                    f"and is likely in {name or f'{likely:g} m'}",
                    path=path,
                    hint=f"--depth-unit {name or f'{likely:g}'}, if that is the unit of the files",
                )
    return f"{path.suffix} in {told}, median depth {np.median(medians):.3g} m"
