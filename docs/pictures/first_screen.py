"""Makes docs/pictures/first_screen.jpg: two captures of ClearGrasp's real-val (Apache-2.0).

python docs/pictures/first_screen.py FOLDER_OF_CLEARGRASP_REAL_VAL

Colour with the contours of glass, raw depth, and depth restored as `std-restore` does by default.
Prints the error on glass and the harm elsewhere for the caption, and the share of errors within
their spread.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark import Restorer
from benchmark.evaluation.depth_panels import depth_picture, range_of
from benchmark.metrics.depth.harm import harm
from benchmark.restoring.options import MethodChoice
from std_toolkit.importers.depth_files import read_foreign_depth
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.images import read_color, write_color

OUT = Path(__file__).with_suffix(".jpg")
CAPTURES = ("000000080", "000000123", "000000130")
SHOWN = ("000000080", "000000130")
WIDTH, GAP = 560, 6
# What the default is compared with in docs/restoring.md.
OTHERS = (
    MethodChoice(where="everywhere"),
    MethodChoice(method="compactdr"),
    MethodChoice(method="colorization"),
)


def capture(folder: Path, name: str, restorer: Restorer) -> tuple[NDArray[np.uint8], list[float]]:
    """The three panels of a capture (h, w, 3) RGB; figures on glass, and of harm elsewhere.

    The figures: RMSE in mm, shares of pixels within 5 %, of harm, of errors within one and two
    spreads in %.
    """
    color = read_color(folder / f"{name}-transparent-rgb-img.jpg")
    size = (color.shape[1], color.shape[0])

    def depth(kind: str) -> NDArray[np.float32]:
        path = folder / f"{name}-{kind}-depth-img.exr"
        return read_foreign_depth(path, size=size).values.astype(np.float32)

    lens = read_intrinsics(str(folder / "camera_intrinsics.yaml"))
    sensor, true = depth("transparent"), depth("opaque")
    found = restorer.restore(color, sensor, [lens.fx, lens.fy, lens.cx, lens.cy])
    mask = cv2.imread(str(folder / f"{name}-mask.png"), cv2.IMREAD_GRAYSCALE)
    glass = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) > 0
    known = glass & (true > 0)
    error = np.abs(found.depth - true)[known]
    figures = [
        1e3 * float(np.sqrt((error**2).mean())),
        100 * float((error < 0.05 * true[known]).mean()),
        100 * harm(found.depth, sensor, true, ~glass),
    ]
    if found.spread is not None:
        figures += [100 * float((error < n * found.spread[known]).mean()) for n in (1, 2)]
    outlines, _ = cv2.findContours(glass.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    drawn = cv2.drawContours(color.copy(), outlines, -1, (255, 225, 40), 4, cv2.LINE_AA)
    scale = range_of(found.depth)
    panels = [drawn, depth_picture(sensor, scale), depth_picture(found.depth, scale)]
    small = (WIDTH, round(WIDTH * size[1] / size[0]))
    panels = [cv2.resize(panel, small, interpolation=cv2.INTER_AREA) for panel in panels]
    gap = np.full((small[1], GAP, 3), 255, np.uint8)
    parts = [part for panel in panels for part in (panel, gap)]
    return np.hstack(parts[:-1]).astype(np.uint8), figures


def picture(
    folder: Path, choice: MethodChoice | None = None
) -> tuple[NDArray[np.uint8], dict[str, list[float]]]:
    """Captures below one another; figures of all by name, restored by default or as chosen."""
    restorer = Restorer.of(choice or MethodChoice())
    rows, figures = [], {}
    for name in CAPTURES:
        row, figures[name] = capture(folder, name, restorer)
        if name in SHOWN:
            rows += [row, np.full((GAP, row.shape[1], 3), 255, np.uint8)]
    return np.vstack(rows[:-1]), figures


if __name__ == "__main__":
    made, told = picture(Path(sys.argv[1]))
    write_color(OUT, made, quality=88)
    for choice in OTHERS:
        _, found = picture(Path(sys.argv[1]), choice)
        told[f"{choice.method}, mean"] = np.mean([*found.values()], axis=0).tolist()
    told["by default, mean"] = np.mean([told[name] for name in CAPTURES], axis=0).tolist()
    for name, (rmse, within, harmed, *spread) in told.items():
        print(f"{name}: {rmse:.1f} mm, {within:.1f} % within 5 %; {harmed:.2f} % harm elsewhere")
        if spread:
            print("  {:.0f} % within one spread, {:.0f} % within two".format(*spread))
