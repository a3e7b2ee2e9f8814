"""A photo against the table on which all photos agree: bare table, or something before it."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.scanning.masks.table_model import TableModel, TableModelSettings
from std_toolkit.scanning.photos.views import View
from std_toolkit.settings import NOT_RECORDED, Settings, limit


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


def compare(view: View, tables: Sequence[TableModel], index: int) -> Comparison:
    """Where a photo shows the bare table and where something else.

    Args:
        view: the photo.
        tables: of `model_table` over all photos; where several know a place, the first counts.
        index: index of the photo among them.
    """
    limits = TableComparisonSettings.current()
    off, textured, beyond = _against(view, tables, index)
    known = np.isfinite(off)
    # Before tags, a plain object has one of their colours everywhere.
    _, side = _seen(view, tables[0])
    cells = np.ones((side, side), np.uint8)
    shown = (cv2.dilate(view.image, cells) - cv2.erode(view.image, cells)).max(axis=-1)
    clear = (
        known
        & (off < 1)
        & ((textured < limits.texture) | (shown > limits.texture_shown * textured))
    )
    clear = cv2.morphologyEx(clear.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    return Comparison(clear, known & (off > 2), known, beyond)


def deviation(view: View, tables: Sequence[TableModel], index: int) -> Floats:
    """(H, W) difference of a photo from the table, in parts of the table's width.

    It is 0 for any colour that the table has within about a pixel, and NaN where no table is
    known.

    Args:
        view: the photo.
        tables: of `model_table` over all photos; where several know a place, the first counts.
        index: index of the photo among them.
    """
    return _against(view, tables, index)[0]


def _against(view: View, tables: Sequence[TableModel], index: int) -> tuple[Floats, Floats, Mask]:
    """(H, W) difference as in `deviation`, contrast of the table within about a pixel, and pixels
    whose rays meet neither the known table nor the first one."""
    (off, textured, met), *others = (_deviation(view, table, index) for table in tables)
    for farther, contrast, _ in others:
        first = np.isfinite(off) | met
        off, textured = np.where(first, off, farther), np.where(first, textured, contrast)
    return off, textured, ~met & ~np.isfinite(off)


def _rays(view: View, every: int = 1) -> tuple[Array, Mask]:
    """(h, w, 3) rays of every n-th pixel, world, and those that are steep enough to compare."""
    limits = TableModelSettings.current()
    rays = pixel_rays(view.camera)[::every, ::every] @ view.T_world_cam.R.T
    return rays, -rays[..., 2] / np.linalg.norm(rays, axis=-1) > limits.flattest


def _pixel_m(view: View) -> float:
    """Metres of the table in a pixel of a photo, across the ray, where it looks at the table."""
    rays, steep = _rays(view, 8)
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


def _deviation(view: View, table: TableModel, index: int) -> tuple[Floats, Floats, Mask]:
    rays, steep = _rays(view)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -view.centre[2] / rays[..., 2]
    at = view.centre[:2] + np.where(t > 0, t, np.nan)[..., None] * rays[..., :2]
    cell = ((at - table.low) / table.cell).astype(np.float32)
    cell[~np.isfinite(cell)] = -100
    color = (table.color * table.gains[index]).astype(np.float32)
    # A pixel may show any colour within about a pixel of its place on the table.
    n, _ = _seen(view, table)
    kernel = np.ones((n, n), np.uint8)
    x, y = cell[..., 0], cell[..., 1]
    hidden = ~table.known[..., None]
    low = np.where(hidden, np.float32(1e6), color)
    high = np.where(hidden, np.float32(-1e6), color)
    darkest = cv2.remap(cv2.erode(low, kernel), x, y, cv2.INTER_LINEAR)
    brightest = cv2.remap(cv2.dilate(high, kernel), x, y, cv2.INTER_LINEAR)
    # Between the cells of a tag photos differ by their blur, but neighbours bound the colours.
    closed = cv2.morphologyEx(table.known.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    known = cv2.remap(closed, x, y, cv2.INTER_NEAREST) > 0
    met = steep & (x >= 0) & (y >= 0) & (x < color.shape[1]) & (y < color.shape[0])
    known &= met
    image = cv2.GaussianBlur(view.image, (0, 0), 0.7).astype(np.float32)
    off = np.maximum(np.maximum(image - brightest, darkest - image), 0).max(axis=-1)
    off = np.where(known, off / table.width, np.nan).astype(np.float32)
    return off, np.where(known, (brightest - darkest).max(axis=-1), 0), met
