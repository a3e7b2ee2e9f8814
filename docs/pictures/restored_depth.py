"""Makes docs/pictures/restored_depth.jpg: the best, the median and the worst frame of a run.

python docs/pictures/restored_depth.py OUT/SPLIT/swindrnet/strict/gallery
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from benchmark.evaluation.depth_panels import LARGEST_ERROR_M, PANELS, TRUST_PANEL
from std_toolkit.io.images import read_color, write_color

OUT = Path(__file__).with_suffix(".jpg")
HEADING, GAP = 28, 4


def main(gallery: Path) -> None:
    """The frames below one another, with a heading above each panel."""
    ranks = ("best", "median", "worst")
    rows = [read_color(next(gallery.glob(f"{rank}-*.jpg"))) for rank in ranks]
    width = rows[0].shape[1]
    headings = [*PANELS, TRUST_PANEL]
    picture = np.full((HEADING, width, 3), 255, np.uint8)
    for index, heading in enumerate(headings):
        title = f"{heading} to {100 * LARGEST_ERROR_M:.0f} cm" if heading == "error" else heading
        place = (index * width // len(headings) + 4, HEADING - 9)
        cv2.putText(
            picture, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (0, 0, 0), 1, cv2.LINE_AA
        )
    gap = np.full((GAP, width, 3), 255, np.uint8)
    parts = [picture, *(part for row in rows for part in (row, gap))]
    write_color(OUT, np.vstack(parts[:-1]), quality=88)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
