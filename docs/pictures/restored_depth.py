"""Makes docs/pictures/restored_depth.jpg: the best, the median and the worst frame of a run.

python docs/pictures/restored_depth.py OUT/SPLIT/swindrnet/strict/gallery
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from benchmark.running.panels import LARGEST_ERROR_M, PANEL_WIDTH, PANELS, TRUST_PANEL

OUT = Path(__file__).with_suffix(".jpg")
HEADING, GAP = 28, 4


def main(gallery: Path) -> None:
    """The frames below one another, with a heading above each panel."""
    rows = [read(sorted(gallery.glob(f"{rank}-*.jpg"))[0]) for rank in ("best", "median", "worst")]
    headings = [*PANELS, TRUST_PANEL]
    picture = np.full((HEADING, rows[0].shape[1], 3), 255, np.uint8)
    for index, heading in enumerate(headings):
        told = f"{heading} to {100 * LARGEST_ERROR_M:.0f} cm" if heading == "error" else heading
        place = (index * (PANEL_WIDTH + GAP) + 4, HEADING - 9)
        cv2.putText(picture, told, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 1, cv2.LINE_AA)
    gap = np.full((GAP, picture.shape[1], 3), 255, np.uint8)
    parts = [picture, *(part for row in rows for part in (row, gap))]
    cv2.imwrite(str(OUT), np.vstack(parts[:-1]), [cv2.IMWRITE_JPEG_QUALITY, 88])


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    if image is None:
        raise SystemExit(f"{path}: no image")
    return image


if __name__ == "__main__":
    main(Path(sys.argv[1]))
