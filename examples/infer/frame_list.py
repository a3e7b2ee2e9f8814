"""The loops over a list of `std-bench infer-list`, for scripts of other environments."""

import csv
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np


def fill(frames: str, answer: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> None:
    """Write depth for every row: `answer(color, raw, K)` gives (h, w) metres of any size.

    `color` is RGB uint8 (H, W, 3), `raw` float32 metres (H, W), 0 where nothing was measured, and
    `K` the 3x3 intrinsics of both, in pixels. Frames that have a file are left as they are.
    """
    for row in rows_left(frames):
        color, K = colour_of(row)
        raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * np.float32(row["raw_unit_m"])
        raw = cv2.resize(raw, color.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        save(row, answer(color, raw, K))


def fill_from_pair(frames: str, answer: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    """Write depth for every row: `answer(left, right)` gives the disparity (H, W) in pixels.

    Both are RGB uint8 (H, W, 3), rectified; the disparity is that of the left image. Depth is
    written as the colour camera sees it.
    """
    for row in rows_left(frames):
        if not row.get("ir_left"):
            sys.exit(f"{frames}: {row['scene']}/{row['frame']} has no infrared pair")
        left, right = (cv2.imread(row[name])[:, :, ::-1] for name in ("ir_left", "ir_right"))
        disparity = np.asarray(answer(left, right), np.float32)
        color, K = colour_of(row)
        # Twice as many points as pixels in each direction: colour is seldom finer.
        v, u = np.mgrid[0 : disparity.shape[0] - 1 : 0.5, 0 : disparity.shape[1] - 1 : 0.5]
        found = disparity[(v + 0.5).astype(int), (u + 0.5).astype(int)]
        fx, fy, cx, cy = (float(row[f"ir_{name}"]) for name in ("fx", "fy", "cx", "cy"))
        z = np.where(found > 0, fx * float(row["baseline_m"]) / np.maximum(found, 1e-6), 0)
        points = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], -1)[z > 0]
        pose = np.array(row["T_color_left"].split(), float).reshape(4, 4)
        points = points @ pose[:3, :3].T + pose[:3, 3]
        points = points[points[:, 2] > 0]
        x, y, _ = np.rint((points / points[:, 2:]) @ K.T).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < color.shape[1]) & (y < color.shape[0])
        depth = np.full(color.shape[:2], np.inf, np.float32)
        np.minimum.at(depth, (y[inside], x[inside]), points[inside, 2])
        save(row, np.where(np.isfinite(depth), depth, 0))


def rows_left(frames: str) -> list[dict[str, str]]:
    """Rows that have no file yet."""
    with open(frames, newline="") as file:  # noqa: PTH123
        return [row for row in csv.DictReader(file) if not Path(row["out"]).exists()]


def colour_of(row: dict[str, str]) -> tuple[np.ndarray, np.ndarray]:
    """Colour and its intrinsics."""
    color = np.ascontiguousarray(cv2.imread(row["color"])[:, :, ::-1])
    fx, fy, cx, cy = (float(row[name]) for name in ("fx", "fy", "cx", "cy"))
    return color, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float32)


def save(row: dict[str, str], depth: np.ndarray) -> None:
    """Write the answer of a row."""
    Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
    np.save(row["out"], np.asarray(depth, np.float32))
