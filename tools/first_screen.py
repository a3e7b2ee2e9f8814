"""Make docs/pictures/first_screen.jpg: python tools/first_screen.py FOLDER_OF_CLEARGRASP_REAL_VAL.

Colour with the contours of the objects, raw depth and restored depth of two captures of
ClearGrasp's real-val (Apache-2.0).
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark import Restorer
from benchmark.evaluation.depth_panels import depth_picture, range_of
from std_toolkit.importers.depth_files import read_foreign_depth
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.images import read_color, write_color

CAPTURES = ("000000130", "000000123")
WIDTH = 560


def row(folder: Path, name: str, restorer: Restorer) -> NDArray[np.uint8]:
    """(h, w, 3) RGB: the three panels of a capture."""
    color = read_color(folder / f"{name}-transparent-rgb-img.jpg")
    size = (color.shape[1], color.shape[0])
    depth = read_foreign_depth(folder / f"{name}-transparent-depth-img.exr", size=size).values
    lens = read_intrinsics(str(folder / "camera_intrinsics.yaml"))
    K = [lens.fx, lens.fy, lens.cx, lens.cy]
    sensor = depth.astype(np.float32)
    restored = restorer.restore(color, sensor, K).depth
    mask = cv2.imread(str(folder / f"{name}-mask.png"), cv2.IMREAD_GRAYSCALE)
    outlines, _ = cv2.findContours(
        (mask > 0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    drawn = cv2.drawContours(color.copy(), outlines, -1, (255, 225, 40), 4, cv2.LINE_AA)
    scale = range_of(restored)
    panels = [drawn, depth_picture(sensor, scale), depth_picture(restored, scale)]
    height = round(WIDTH * size[1] / size[0])
    small = [cv2.resize(p, (WIDTH, height), interpolation=cv2.INTER_AREA) for p in panels]
    gap = np.full((height, 6, 3), 255, np.uint8)
    return np.hstack([small[0], gap, small[1], gap, small[2]]).astype(np.uint8)


if __name__ == "__main__":
    made = Restorer.load("swindrnet", size=(640, 360))
    rows = [row(Path(sys.argv[1]), name, made) for name in CAPTURES]
    gap = np.full((6, rows[0].shape[1], 3), 255, np.uint8)
    out = Path(__file__).resolve().parent.parent / "docs/pictures/first_screen.jpg"
    write_color(out, np.vstack([rows[0], gap, rows[1]]), quality=88)
