"""The loop over a list of `std-bench infer-list`, for scripts of other environments."""

import csv
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np


def fill(frames: str, answer: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> None:
    """Write depth for every row: `answer(color, raw, K)` gives (h, w) metres of any size.

    `color` is RGB uint8 (H, W, 3), `raw` float32 metres (H, W), 0 where nothing was measured, and
    `K` the 3x3 intrinsics of both, in pixels. Frames that have a file are left as they are.
    """
    with open(frames, newline="") as file:  # noqa: PTH123
        rows = [row for row in csv.DictReader(file) if not Path(row["out"]).exists()]
    for row in rows:
        color = np.ascontiguousarray(cv2.imread(row["color"])[:, :, ::-1])
        raw = cv2.imread(row["raw"], cv2.IMREAD_UNCHANGED) * np.float32(row["raw_unit_m"])
        raw = cv2.resize(raw, color.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        fx, fy, cx, cy = (float(row[name]) for name in ("fx", "fy", "cx", "cy"))
        depth = answer(color, raw, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float32))
        Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
        np.save(row["out"], np.asarray(depth, np.float32))
