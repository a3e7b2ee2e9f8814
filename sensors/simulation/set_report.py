"""Statistics of a simulated set, and its contact sheet.

The contact sheet shows colour, infrared, raw depth, exact depth and error of a few frames.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sensors.output.dreds import BACKGROUND, DATA_SET, SPLITS
from sensors.output.simulated_frame import SimulatedFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.foreign_files import read_mask_source
from std_toolkit.importers.std_objects import read_meta
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, MATERIAL_IDS

FLOOR = "background"

WRONG_M = 0.01

# Errors sampled per frame and material: enough for medians over millions of pixels.
_KEPT = 2000

Image = NDArray[np.uint8]

# Error at which the colour scale ends.
LARGEST_ERROR_M = 0.02

NO_DEPTH = (24, 24, 28)

_NO_ERROR = (52, 34, 64)

_TITLES = ("colour", "left infrared", "raw depth", "exact depth", "error, 0 to 20 mm")

_TILE_WIDTH, _MARGIN, _HEADING = 400, 6, 26


@dataclass(frozen=True)
class SetStatistics:
    """Statistics of a data set.

    Attributes:
        scenes, frames: their numbers.
        categories: number of objects per category, summed over scenes.
        depth: per material class: number of pixels, completeness in percent, and, over pixels with
            a value, median and root mean square of the error in millimetres and the percentage of
            values that are wrong by more than a centimetre.
    """

    scenes: int
    frames: int
    categories: pd.DataFrame
    depth: pd.DataFrame

    def document(self) -> dict[str, object]:
        """The statistics as plain values."""
        return {
            "scenes": self.scenes,
            "frames": self.frames,
            "objects": self.categories["objects"].to_dict(),
            "depth": self.depth.to_dict("index"),
        }

    def __str__(self) -> str:
        return (
            f"{self.scenes} scenes, {self.frames} frames\n\n"
            f"{self.categories.to_string()}\n\n"
            f"raw depth against exact depth:\n{self.depth.to_string(float_format='%.2f')}"
        )


def set_statistics(root: Path) -> SetStatistics:
    """Read every frame of a data set.

    Args:
        root: folder that contains `DREDS-CatKnown`, or that folder itself.

    Raises:
        ToolkitError: there is no such data set, or one of its files is damaged.
    """
    scenes = list(_scenes(root))
    if not scenes:
        raise ToolkitError(
            "no scene in the DREDS layout here",
            path=root,
            hint="give the folder that std-sim wrote to",
        )
    classes = {number: name for name, number in CATEGORY_CLASS_IDS.items()}
    tally: defaultdict[str, ErrorTally] = defaultdict(ErrorTally)
    categories: Counter[str] = Counter()
    frames = 0
    for folder in scenes:
        seen: dict[int, int] = {}
        for meta in sorted(folder.glob("*_meta.txt")):
            stem = meta.name.removesuffix("_meta.txt")
            rows = read_meta(meta)
            seen.update({row.mask_id: row.class_id for row in rows})
            raw = read_exr_depth(folder / f"{stem}_simDepthImage.exr")
            exact = read_exr_depth(folder / f"{stem}_depth_120.exr")
            mask = read_mask_source(folder / f"{stem}_mask.exr", size=None)
            for name in (*MATERIAL_IDS, FLOOR):
                ids = [row.mask_id for row in rows if row.material == name]
                where = np.isin(mask, [BACKGROUND] if name == FLOOR else ids) & (exact > 0)
                tally[name].add(raw[where], exact[where])
            frames += 1
        categories.update(classes[label] for label in seen.values())
    depth = pd.DataFrame(
        {name: tally[name].row() for name in (*MATERIAL_IDS, FLOOR) if tally[name].pixels}
    ).T
    depth["pixels"] = depth["pixels"].astype(int)
    counts = pd.DataFrame({"objects": categories}).sort_values("objects", ascending=False)
    return SetStatistics(len(scenes), frames, counts, depth)


class ErrorTally:
    """Completeness and errors of depth, summed over frames."""

    def __init__(self) -> None:
        self.pixels = self.valid = self.wrong = 0
        self.squares = 0.0
        self.errors: list[NDArray[np.float32]] = []

    def add(self, raw: NDArray[np.floating], exact: NDArray[np.floating]) -> None:
        """Count pixels of measured depth (0 = none) and exact depth, metres, of one shape."""
        self.pixels += len(raw)
        valid = raw > 0
        error = np.abs(raw[valid] - exact[valid])
        self.valid += len(error)
        self.wrong += int((error > WRONG_M).sum())
        self.squares += float(np.square(error, dtype=np.float64).sum())
        self.errors.append(error[:: max(1, len(error) // _KEPT)])

    def row(self) -> dict[str, float]:
        """The figures by name, as in `SetStatistics.depth`."""
        measured = max(self.valid, 1)
        errors = np.concatenate(self.errors)
        return {
            "pixels": self.pixels,
            "complete %": 100 * self.valid / self.pixels if self.pixels else np.nan,
            "median mm": 1000 * float(np.median(errors)) if len(errors) else np.nan,
            "RMSE mm": 1000 * float(np.sqrt(self.squares / measured)),
            "off by > 1 cm %": 100 * self.wrong / measured,
        }


def _scenes(root: Path) -> Iterator[Path]:
    top = root / DATA_SET if (root / DATA_SET).is_dir() else root
    for split in SPLITS:
        if (top / split).is_dir():
            yield from sorted(p for p in (top / split).iterdir() if p.is_dir())


def contact_sheet(frames: list[SimulatedFrame]) -> Image:
    """(H, W, 3) uint8 RGB, a row for each frame.

    Depth runs from blue (near) to red within the frame's own range; pixels without a measurement
    are dark, in the error picture violet.
    """
    rows = [_row(frame) for frame in frames]
    width = rows[0].shape[1]
    heading = np.full((_HEADING, width, 3), 255, np.uint8)
    for i, title in enumerate(_TITLES):
        at = (i * (_TILE_WIDTH + _MARGIN) + 4, 18)
        cv2.putText(heading, title, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
    gap = np.full((_MARGIN, width, 3), 255, np.uint8)
    parts = [heading]
    for row in rows:
        parts += [row, gap]
    return np.concatenate(parts[:-1])


def _row(frame: SimulatedFrame) -> Image:
    exact = frame.depth_exact
    low, high = np.percentile(exact[exact > 0], [1, 99]) if (exact > 0).any() else (0.0, 1.0)
    error = np.abs(frame.depth_aligned - exact) / LARGEST_ERROR_M
    error_picture = _colored(error, cv2.COLORMAP_VIRIDIS)
    error_picture[frame.depth_aligned <= 0] = _NO_ERROR
    tiles = (
        frame.color,
        np.repeat(frame.infrared_left[..., None], 3, axis=2),
        _depth(frame.depth_aligned, low, high),
        _depth(exact, low, high),
        error_picture,
    )
    height = round(_TILE_WIDTH * exact.shape[0] / exact.shape[1])
    gap = np.full((height, _MARGIN, 3), 255, np.uint8)
    parts: list[Image] = []
    for tile in tiles:
        small = cv2.resize(tile, (_TILE_WIDTH, height), interpolation=cv2.INTER_AREA)
        parts += [np.asarray(small, np.uint8), gap]
    return np.concatenate(parts[:-1], axis=1)


def _depth(depth: NDArray[np.float32], low: float, high: float) -> Image:
    picture = _colored((depth - low) / max(high - low, 1e-6), cv2.COLORMAP_TURBO)
    picture[depth <= 0] = NO_DEPTH
    return picture


def _colored(values: NDArray[np.floating], scale: int) -> Image:
    grey = (255 * np.clip(values, 0, 1)).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(grey, scale)[..., ::-1])
