"""Environment maps: reading them, and folders of them split into training and test."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.exr import read_exr

SUFFIXES = (".hdr", ".exr")

# Wider maps are reduced to this: the reflection in a sphere of 10 cm has no finer detail.
WIDTH = 1024

Split = Literal["train", "test", "all"]

# 74 of 97 maps were for training in DREDS.
TRAIN_PERCENT = 76

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Light from all directions.

    Attributes:
        name: file name without suffix, or the origin of the map.
        pixels: (H, W, 3) float32 linear RGB radiance of mean luminance 1 over the sphere. Rows
            run from straight up to straight down, columns once around.
    """

    name: str
    pixels: NDArray[np.float32]

    @staticmethod
    def normalised(name: str, pixels: NDArray[np.floating]) -> EnvironmentMap:
        """Scale to mean luminance 1: files from different sources differ by orders of magnitude.

        Raises:
            ToolkitError: the map is black.
        """
        pixels = np.asarray(pixels, np.float32)
        mean = mean_luminance(pixels)
        if mean <= 0:
            raise ToolkitError("the environment map is black", field=name)
        return EnvironmentMap(name, np.ascontiguousarray(pixels / np.float32(mean)))


def mean_luminance(pixels: NDArray[np.float32]) -> float:
    """Mean over the sphere; rows near the poles are weighted by their smaller area."""
    height = len(pixels)
    weight = np.sin((np.arange(height) + 0.5) / height * np.pi)
    return float(np.average((pixels @ LUMINANCE).mean(axis=1), weights=weight))


def read_environment(path: Path | str) -> EnvironmentMap:
    """Read a .hdr (Radiance) or .exr lat-long map.

    Raises:
        ToolkitError: unreadable, not twice as wide as high, or negative or infinite values.
    """
    path = Path(path)
    pixels = _read_exr_color(path) if path.suffix.lower() == ".exr" else _read_hdr(path)
    height, width = pixels.shape[:2]
    if abs(width - 2 * height) > 0.02 * width or height < 8:
        raise ToolkitError(
            "an environment map is a lat-long image, twice as wide as high",
            path=path,
            value=f"{width}x{height}",
        )
    if not np.isfinite(pixels).all() or pixels.min() < 0:
        raise ToolkitError("the environment map holds negative or infinite light", path=path)
    if width > WIDTH:
        smaller = cv2.resize(pixels, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA)
        pixels = np.asarray(smaller, np.float32)
    try:
        return EnvironmentMap.normalised(path.stem, pixels)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path) from error


def _read_hdr(path: Path) -> NDArray[np.float32]:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ToolkitError(
            f"cannot read the environment map: {error.strerror}", path=path
        ) from error
    image = None
    if data[:2].tobytes() == b"#?":
        try:
            image = cv2.imdecode(data, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
        except cv2.error:  # a damaged file raises or gives None, depending on the damage
            image = None
    if image is None or image.dtype != np.float32:
        raise ToolkitError("not a readable Radiance .hdr file", path=path)
    return np.ascontiguousarray(image[..., ::-1])


def _read_exr_color(path: Path) -> NDArray[np.float32]:
    channels = read_exr(path)
    if not {"R", "G", "B"} <= set(channels):
        raise ToolkitError(
            "an environment map needs the channels R, G and B", path=path, value=sorted(channels)
        )
    return np.stack([channels[c].astype(np.float32) for c in "RGB"], axis=-1)


def split_of(name: str) -> Literal["train", "test"]:
    """The split of a file by its name without suffix: the same on every machine, permanently."""
    number = int(hashlib.sha256(name.encode()).hexdigest()[:8], 16) % 100
    return "train" if number < TRAIN_PERCENT else "test"


def files_of_split(folder: Path | str, split: Split, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of a split, in name order.

    Sub-folders `train` and `test` define the splits if they exist; otherwise the names do.

    Raises:
        ToolkitError: no such folder, or it has no file for the split.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ToolkitError(
            "no such folder", path=folder, hint="leave the option out to use what is built in"
        )
    divided = [d for d in ("train", "test") if (folder / d).is_dir()]
    if divided:
        found = [p for d in divided if split in (d, "all") for p in _files(folder / d, suffixes)]
    else:
        found = [p for p in _files(folder, suffixes) if split in (split_of(p.stem), "all")]
    if not found:
        total = sum(len(_files(folder / d, suffixes)) for d in (".", *divided))
        raise ToolkitError(
            f"no {' or '.join(suffixes)} file" + (f" for the split {split}" if total else ""),
            path=folder,
            hint=f"{total} files belong to the other split; sort them into {folder.name}/train "
            f"and {folder.name}/test yourself"
            if total
            else "put files there, or leave the option out to use what is built in",
        )
    return sorted(found)


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and p.is_file())


class EnvironmentFolder:
    """Maps of a folder.

    Args:
        folder: contains .hdr and .exr files, or sub-folders `train` and `test` with such files.
        split: maps to draw from.

    Raises:
        ToolkitError: see `files_of_split`.
    """

    def __init__(self, folder: Path | str, *, split: Split = "train") -> None:
        self.files = files_of_split(folder, split, SUFFIXES)

    def draw(self, rng: np.random.Generator) -> EnvironmentMap:
        """A random map; consumes one number.

        Raises:
            ToolkitError: the file cannot be read.
        """
        return _kept(self.files[int(rng.integers(len(self.files)))])


@lru_cache(maxsize=8)
def _kept(path: Path) -> EnvironmentMap:
    return read_environment(path)
