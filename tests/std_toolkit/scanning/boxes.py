"""Photos of two boxes on a table, or on the printed board, drawn with NumPy."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import Camera
from std_toolkit.io.images import write_color
from std_toolkit.poses.board_sheet import make_board_sheet, write_board_pdf
from std_toolkit.scanning.photos.views import View
from tests.std_toolkit.scanning.ball import look_at

CAMERA = Camera(240, 180, 225, 225, 119.5, 89.5)
CORNERS = np.array([[0.14, 0.14, 0.0], [-0.14, -0.14, 0.0]])
# Low and high corner of two boxes, the larger first.
BOXES = [
    (np.array([-0.10, -0.03, 0.0]), np.array([-0.04, 0.03, 0.08])),
    (np.array([0.05, -0.02, 0.0]), np.array([0.09, 0.02, 0.05])),
]

# Pixels of the printed sheet in a metre.
_FINE = 4000


def photos_of_boxes(
    count: int = 14, *, camera: Camera = CAMERA, sheet: NDArray[np.uint8] | None = None
) -> list[View]:
    """Two dark boxes with a pattern on a bright table, from two heights.

    Args:
        count: number of photos.
        camera: of the photos.
        sheet: of `printed_sheet`, that lies on the table.
    """
    views = []
    for n in range(count):
        a = 2 * np.pi * n / count
        eye = np.array([0.4 * np.cos(a), 0.4 * np.sin(a), (0.22, 0.4)[n % 2]])
        T = look_at(eye, np.array([0, 0, 0.03]))
        rays = camera.rays() @ T.R.T
        image = np.where(rays[..., 2:] < 0, [200.0, 195, 190], 40.0)
        if sheet is not None:
            _lay(sheet, image, eye, rays)
        nearest = np.full(rays.shape[:2], np.inf)
        for low, high in BOXES:
            with np.errstate(divide="ignore"):
                ends = np.stack([(low - eye) / rays, (high - eye) / rays])
            near, far = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
            hit = (near < far) & (near < nearest)
            nearest = np.where(hit, near, nearest)
            at = eye + near[..., None] * rays
            wave = np.sin(at @ [400, 250, 310]) + np.sin(at @ [-270, 380, 150])
            look = np.array([90.0, 30, 30]) + 14 * wave[..., None]
            image = np.where(hit[..., None], look, image)
        views.append(View(f"{n:03d}.png", image.clip(0, 255).astype(np.uint8), camera, T))
    return views


def printed_sheet() -> NDArray[np.uint8]:
    """Grey values (H, W) of the A4 board, its middle in the middle, y up."""
    sheet = make_board_sheet("a4")
    width, height = (round(mm / 1000 * _FINE) for mm in sheet.paper_mm)
    drawn = np.full((height, width), 235, np.uint8)
    for x, y, w, h in sheet.cells():
        columns = np.rint((np.array([x, x + w]) / 1000 * _FINE) + width / 2).astype(int)
        rows = np.rint((np.array([y, y + h]) / 1000 * _FINE) + height / 2).astype(int)
        drawn[rows[0] : rows[1], columns[0] : columns[1]] = 25
    return drawn


def _lay(sheet: NDArray[np.uint8], image: NDArray[np.float64], eye: object, rays: object) -> None:
    """Draw the sheet into an image in place."""
    h, w = sheet.shape
    with np.errstate(divide="ignore"):
        t = -eye[2] / rays[..., 2]  # type: ignore[index]
    at = (eye + np.where(t > 0, t, np.nan)[..., None] * rays)[..., :2] * _FINE  # type: ignore[operator]
    at = np.nan_to_num(at + np.array([w, h]) / 2 - 0.5, nan=-1e6).astype(np.float32)
    # A pixel covers several of the sheet.
    soft = cv2.GaussianBlur(sheet, (0, 0), 1.5)
    shown = cv2.remap(soft, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0)
    on = (at >= 1).all(axis=-1) & (at < np.array([w, h]) - 2).all(axis=-1)
    image[on] = shown[on, None]


# Camera of the photos on the board: a cell of its tags has three pixels.
BOARD_CAMERA = Camera(480, 360, 450, 450, 239.5, 179.5)


def write_photos_on_board(folder: Path, count: int = 12) -> Path:
    """Write photos of the boxes on the board, and return its description."""
    for view in photos_of_boxes(count, camera=BOARD_CAMERA, sheet=printed_sheet()):
        write_color(folder / view.name, view.image)
    return write_board_pdf(folder.parent / "board.pdf")[1]
