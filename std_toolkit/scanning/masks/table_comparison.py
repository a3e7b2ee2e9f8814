"""A photo against the table on which all photos agree: bare table, or something before it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.scanning.masks.table_model import TableModel, TableModelSettings
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# x0, y0, x1, y1 in pixels.
Window = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class TableComparisonSettings(Settings):
    """When a photo shows the bare table clearly."""

    texture: float = limit(40.0, unit="grey levels", source=NOT_RECORDED)
    """texture of the table that a photo must show, too"""
    texture_shown: float = limit(0.4, source=NOT_RECORDED)
    """smallest share of it that a photo must show"""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A photo compared with the table.

    Attributes:
        clear: (H, W) pixels that show the bare table.
        different: (H, W) pixels before the known table that show something else.
        known: (H, W) pixels whose rays meet the known table.
        beyond: (H, W) pixels whose rays meet neither the known table nor any place near the board.
    """

    clear: Mask
    different: Mask
    known: Mask
    beyond: Mask


def compare(
    view: View, tables: Sequence[TableModel], index: int, window: Window | None = None
) -> Comparison:
    """Where a photo shows the bare table and where something else.

    Args:
        view: the photo.
        tables: of `model_table` over all photos; where several know a place, the first counts.
        index: index of the photo among them.
        window: the part of the photo that is compared; beside it, all masks are False. None: all.
    """
    limits = TableComparisonSettings.current()
    x0, y0, x1, y1 = window or (0, 0, *view.camera.size)
    off, textured, beyond = _against(view, tables, index, (x0, y0, x1, y1))
    known = np.isfinite(off)
    # Before tags, a plain object has one of their colours everywhere.
    _, side = _seen(view, tables[0])
    image = view.image[y0:y1, x0:x1]
    cells = np.ones((side, side), np.uint8)
    shown = (cv2.dilate(image, cells) - cv2.erode(image, cells)).max(axis=-1)
    clear = (
        known
        & (off < 1)
        & ((textured < limits.texture) | (shown > limits.texture_shown * textured))
    )
    clear = cv2.morphologyEx(clear.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    found = clear, known & (off > 2), known, beyond
    parts = np.zeros((4, *view.image.shape[:2]), bool)
    parts[:, y0:y1, x0:x1] = found
    return Comparison(*parts)


def deviation(view: View, tables: Sequence[TableModel], index: int) -> Floats:
    """(H, W) difference of a photo from the table, in parts of the table's width.

    It is 0 for any colour that the table has within about a pixel, and NaN where no table is
    known.

    Args:
        view: the photo.
        tables: of `model_table` over all photos; where several know a place, the first counts.
        index: index of the photo among them.
    """
    return _against(view, tables, index, (0, 0, *view.camera.size))[0]


def _against(
    view: View, tables: Sequence[TableModel], index: int, window: Window
) -> tuple[Floats, Floats, Mask]:
    """(h, w) difference as in `deviation`, contrast of the table within about a pixel, and pixels
    whose rays meet neither the known table nor the first one, all of a window."""
    (off, textured, met), *others = (_deviation(view, table, index, window) for table in tables)
    for farther, contrast, _ in others:
        first = np.isfinite(off) | met
        off, textured = np.where(first, off, farther), np.where(first, textured, contrast)
    return off, textured, ~met & ~np.isfinite(off)


def _pixel_m(view: View) -> float:
    """Metres of the table in a pixel of a photo, across the ray, where it looks at the table."""
    w, h = view.camera.size
    u, v = np.meshgrid(np.arange(0, w, 8), np.arange(0, h, 8))
    rays = view.camera.unproject(np.stack([u, v], axis=-1)) @ view.T_world_cam.R.T
    steep = -rays[..., 2] / np.linalg.norm(rays, axis=-1) > TableModelSettings.current().flattest
    if not steep.any():
        return 0.001
    return float(np.median(-view.centre[2] / rays[..., 2][steep])) / view.camera.fx


def _seen(view: View, table: TableModel) -> tuple[int, int]:
    """Sides of the square whose colours a pixel may show: in cells, and in pixels of the photo.

    Both are odd. A smaller window of a sharp photo lies within a cell of a tag and shows no
    contrast.
    """
    pixel = _pixel_m(view)
    cells = 2 * max(1, round(1.2 * pixel / table.cell)) + 1
    return cells, 2 * max(2, round(cells * table.cell / pixel / 2)) + 1


def _cells(view: View, table: TableModel, window: Window) -> tuple[Floats, Floats, Mask]:
    """Column and row (h, w) of the table that each pixel of a window looks at, -100 where it looks
    above the horizon, and which pixels see the table steeply enough to compare."""
    K_inv = np.linalg.inv(view.camera.K)
    # Rays of the world, the plane z = 0 and the cells: all are linear in the pixel.
    ray = view.T_world_cam.R @ K_inv
    height = view.centre[2]
    to_cell = ((view.centre[:2] - table.low)[:, None] * ray[2] - height * ray[:2]) / table.cell
    x0, y0, x1, y1 = window
    u, v = np.arange(x0, x1, dtype=np.float32), np.arange(y0, y1, dtype=np.float32)[:, None]

    def linear(row: Array) -> Floats:
        a, b, c = row.astype(np.float32)
        return np.asarray(a * u + (b * v + c), np.float32)

    down = linear(-ray[2])
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (np.where(down > 0, linear(-row) / down, np.float32(-100)) for row in to_cell)
    square = sum(linear(row) ** 2 for row in K_inv)
    steep = down > TableModelSettings.current().flattest * np.sqrt(square)
    return np.asarray(x, np.float32), np.asarray(y, np.float32), np.asarray(steep)


@lru_cache(maxsize=8)
def _bounds(table: TableModel, cells: int) -> tuple[Floats, Floats, NDArray[np.uint8]]:
    """Darkest and brightest colours (h, w, 3) of the table within some cells, for all photos that
    show as many in a pixel, and its known cells (h, w)."""
    # A pixel may show any colour within about a pixel of its place on the table.
    kernel = np.ones((cells, cells), np.uint8)
    color, hidden = table.color.astype(np.float32), ~table.known[..., None]
    low = cv2.erode(np.where(hidden, np.float32(1e6), color), kernel)
    high = cv2.dilate(np.where(hidden, np.float32(-1e6), color), kernel)
    # Between the cells of a tag photos differ by their blur, but neighbours bound the colours.
    closed = cv2.morphologyEx(table.known.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    return np.asarray(low), np.asarray(high), np.asarray(closed, np.uint8)


def _deviation(
    view: View, table: TableModel, index: int, window: Window
) -> tuple[Floats, Floats, Mask]:
    x, y, steep = _cells(view, table, window)
    low, high, closed = _bounds(table, _seen(view, table)[0])
    gain = table.gains[index].astype(np.float32)
    darkest, brightest = (cv2.remap(side, x, y, cv2.INTER_LINEAR) * gain for side in (low, high))
    known = cv2.remap(closed, x, y, cv2.INTER_NEAREST) > 0
    met = steep & (x >= 0) & (y >= 0) & (x < low.shape[1]) & (y < low.shape[0])
    known &= met
    x0, y0, x1, y1 = window
    image = cv2.GaussianBlur(view.image[y0:y1, x0:x1], (0, 0), 0.7).astype(np.float32)
    off = np.maximum(np.maximum(image - brightest, darkest - image), 0).max(axis=-1)
    off = np.where(known, off / table.width, np.nan).astype(np.float32)
    return off, np.where(known, (brightest - darkest).max(axis=-1), 0), met
