"""The table as the photos agree on it.

A point of the table is seen by some photos and hidden by the object in others. Those that see it
agree closely, shadows that rest on it included, and those that see the object do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.scanning.masks.table_cells import agree, showing
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_CELL_M = 0.001
MOST_CELLS = 250_000
# Spreads of the table's own colour by which a photo may differ from it; what differs by twice
# this width is something else.
_WIDTHS = 2.0
# Rings of cells by which the table is continued under the object, and their width.
_RINGS, _RING = 16, 4
# Share of the cells from which the board is compared instead of all of them.
_BOARD = 0.2
# Margin of the table around the board, and of the far one that is compared coarsely, in sizes of
# the board.
_NEAR, _FAR = 0.35, 3.0


@dataclass(frozen=True, kw_only=True)
class TableModelSettings(Settings):
    """Cells of the table on which the photos agree."""

    fewest_photos: int = limit(4, source=NOT_RECORDED)
    """photos that must see a cell"""
    narrowest: float = limit(5.0, unit="grey levels", source=NOT_RECORDED)
    """smallest difference from the table's colour that counts"""
    widest: float = limit(
        14.0,
        unit="grey levels",
        source="a wide width takes white texture of an object for white paper behind it",
    )
    """largest difference that is still the table"""
    agree: float = limit(0.5, source=NOT_RECORDED)
    """share of the photos that agree on the colour of the table"""
    agree_beside: float = limit(0.3, source="an object hides the table from most photos")
    """the same beside an object"""
    better: float = limit(2.0, source=NOT_RECORDED)
    """factor by which the photos beside an object must agree better"""
    agree_else: float = limit(0.25, source=NOT_RECORDED)
    """share of the photos that leave a cell in doubt if they agree on another colour"""
    close: float = limit(2.0, unit="grey levels", source=NOT_RECORDED)
    """scatter of those photos"""
    largest_spread: float = limit(22.0, unit="grey levels", source=NOT_RECORDED)
    """a cell whose photos differ more is a moving background, or the object"""
    at_rest: float = limit(0.6, source=NOT_RECORDED)
    """share of the cells around the board that are at rest on a table, and are not around a
    turntable"""
    continued: float = limit(20.0, unit="grey levels", source=NOT_RECORDED)
    """largest difference of the continued table from the colour beside it"""
    continued_share: float = limit(0.25, source=NOT_RECORDED)
    """share of the photos that must show the continued table"""
    steady: float = limit(1.5, source=NOT_RECORDED)
    """largest spread of these photos in parts of the usual spread"""
    darkest: float = limit(0.4, source=NOT_RECORDED)
    """smallest brightness of the continued table in parts of the known one"""
    brightest: float = limit(1.15, source=NOT_RECORDED)
    """largest brightness of the continued table in parts of the known one"""
    other_hue: float = limit(10.0, unit="grey levels", source=NOT_RECORDED)
    """largest deviation of its hue"""
    same_gain: float = limit(0.04, source=NOT_RECORDED)
    """logarithm of the exposure within which a cell suits it"""
    more: float = limit(1.5, source=NOT_RECORDED)
    """factor by which more cells must suit another exposure than the median"""
    flattest: float = limit(0.12, source=NOT_RECORDED)
    """sine of the angle below which the table is seen too flat to compare"""


@dataclass(frozen=True, eq=False)
class TableModel:
    """Colours of the plane z = 0.

    Attributes:
        low: (2,) x and y of the first cell, metres.
        cell: size of a cell in metres.
        color: (h, w, 3) float32 median colour.
        seen: (h, w) cells that enough photos show.
        known: (h, w) cells whose photos agree.
        gains: (V, 3) factor from the table's colours to those of each photo.
        width: grey values by which a photo of the bare table may differ.
    """

    low: Array
    cell: float
    color: Floats
    seen: Mask
    known: Mask
    gains: Floats
    width: float


def model_tables(
    views: Sequence[View],
    corners: Array,
    blocked: Sequence[Mask] | None = None,
    *,
    cells: int = MOST_CELLS,
    threads: int = 1,
) -> list[TableModel]:
    """The table near the board and, if it is at rest, far around it, as low photos show it.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
        blocked: (H, W) pixels of each photo before which something stands.
        cells: number of cells of each table at most.
        threads: number of threads.
    """
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    size = float((high - low).max())
    low, high = low - _NEAR * size, high + _NEAR * size
    tables = [model_table(views, low, high, corners, blocked, cells=cells, threads=threads)]
    low, high = low - _FAR * size, high + _FAR * size
    far = model_table(views, low, high, corners, blocked, cells=cells, threads=threads)
    return [*tables, far] if is_table(far) else tables


def model_table(
    views: Sequence[View],
    low: Array,
    high: Array,
    corners: Array,
    blocked: Sequence[Mask] | None = None,
    *,
    cells: int = MOST_CELLS,
    threads: int = 1,
) -> TableModel:
    """Colours of the table between two corners (x, y), metres.

    Args:
        views: photos.
        low, high: (2,) corners.
        corners: (M, 3) corners of the board that photos show, world: they lie on the table.
        blocked: (H, W) pixels of each photo before which something stands.
        cells: number of cells at most.
        threads: number of threads.
    """
    limits = TableModelSettings.current()
    cell = max(_CELL_M, float(np.sqrt((high - low).prod() / cells)))
    w, h = (int(n) for n in np.ceil((high - low) / cell) + 1)
    y, x = np.mgrid[:h, :w]
    flat = np.stack([low[0] + x * cell, low[1] + y * cell], axis=-1).reshape(-1, 2)
    samples = np.zeros((len(views), h * w, 3), np.uint8)
    seen = np.zeros((len(views), h * w), bool)
    shown = np.zeros((len(views), h * w), bool)

    def sample(i: int) -> None:
        view = views[i]
        u, v, z = view.P[:, :2] @ flat.T + view.P[:, 3:]
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = (np.where(z > 0, a / z, -10).astype(np.float32) for a in (u, v))
        width, height = view.camera.size
        inside = (u > 0) & (v > 0) & (u < width - 1) & (v < height - 1)
        across = (flat[:, 0] - view.centre[0]) ** 2 + (flat[:, 1] - view.centre[1]) ** 2
        steep = view.centre[2] > limits.flattest * np.sqrt(across + view.centre[2] ** 2)
        seen[i] = shown[i] = inside & steep
        if blocked is not None:
            column, row = (np.rint(a[inside]).astype(np.int64) for a in (u, v))
            seen[i, inside] &= ~blocked[i][row, column]
        blurred = cv2.GaussianBlur(view.image, (0, 0), 0.7)
        # Maps of OpenCV are limited to 32767 rows.
        samples[i] = cv2.remap(blurred, u.reshape(h, w), v.reshape(h, w), cv2.INTER_LINEAR).reshape(
            -1, 3
        )

    in_threads(sample, range(len(views)), threads=threads)
    gains = np.ones((len(views), 3), np.float32)
    color = np.zeros((h * w, 3), np.float32)
    spread = np.zeros(h * w, np.float32)
    # A table shines, paper hardly: where it is the larger part, the board tells the exposures.
    board = np.ones(h * w, bool)
    for k in range(2):
        board &= (flat[:, k] >= corners[:, k].min()) & (flat[:, k] <= corners[:, k].max())
    board |= board.mean() < _BOARD
    for _ in range(2):
        color, spread = _agreed(samples, seen, gains)
        for i in range(len(views)):
            use = seen[i] & (spread < limits.largest_spread) & (color.min(axis=1) > 20)
            use &= board
            if use.sum() > 500:
                gains[i] = _gain(samples[i][use] / color[use])
    enough = (seen.sum(axis=0) >= limits.fewest_photos).reshape(h, w)
    known = enough & (spread < limits.largest_spread).reshape(h, w)
    usual = float(np.median(spread[known.ravel()])) if known.any() else limits.widest
    colors = color.reshape(h, w, 3)
    known = _of_the_table(known, (corners[:, :2] - low) / cell)
    _continue(colors, known, samples.reshape(-1, h, w, 3), shown.reshape(-1, h, w), gains, usual)
    width = float(np.clip(_WIDTHS * usual, limits.narrowest, limits.widest))
    return TableModel(low, cell, colors, enough, known, gains, width)


def _gain(ratios: Floats) -> Floats:
    """(3,) exposure of a photo from the ratios (N, 3) of its colours to those of the table.

    The median, unless an object hides most of the board from a low camera: then that of the third
    of the cells that differ least, if it suits clearly more cells.
    """
    limits = TableModelSettings.current()
    grey = np.log(np.maximum(ratios.mean(axis=-1), 1e-3))
    order = grey.argsort()
    k = max(1, round(limits.agree_beside * len(order)))
    width = grey[order[k - 1 :]] - grey[order[: len(order) - k + 1]]
    first = int(width.argmin())
    usual = np.median(ratios, axis=0)
    agreed = np.median(ratios[order[first : first + k]], axis=0)
    suits = [(np.abs(grey - np.log(max(gain.mean(), 1e-3))) < limits.same_gain).sum()
             for gain in (usual, agreed)]  # fmt: skip
    return np.asarray(agreed if suits[1] > limits.more * suits[0] else usual, np.float32)


def _of_the_table(known: Mask, corners: Array) -> Mask:
    """Parts that reach the border or hold a corner of the board.

    The cells below an object of one colour have a median, too: that of the object.
    """
    _, labels = cv2.connectedComponents(known.astype(np.uint8), connectivity=4)
    border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    h, w = known.shape
    x, y = np.rint(corners.T).astype(np.int64)
    inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
    table = np.zeros(int(labels.max()) + 1, bool)
    table[np.concatenate([border, labels[y[inside], x[inside]]])] = True
    table[0] = False
    return np.asarray(table[labels])


def _continue(
    color: Floats,
    known: Mask,
    samples: NDArray[np.uint8],
    shown: Mask,
    gains: Floats,
    usual: float,
) -> None:
    """Continue a table under the object in place, from known cells inwards.

    Beside an object, half of the photos show the object before the table, so the median is of no
    use there. The photos that show about the colour of the nearest known cells show the table; it
    may get darker towards the object, but not of another hue. Pixels that are blocked are used,
    too: the outlines that block them may be too large.
    """
    limits = TableModelSettings.current()
    values = np.array(
        [limits.continued, limits.darkest, limits.brightest, limits.other_hue,
         limits.continued_share, limits.fewest_photos]
    )  # fmt: skip
    origin = color.copy()
    for _ in range(_RINGS):
        near = cv2.dilate(known.astype(np.uint8), np.ones((2 * _RING + 1,) * 2, np.uint8)) > 0
        rows, columns = np.nonzero(near & ~known)
        if len(rows) == 0:
            return
        # Beside tags, which are dark and bright by turns, the mean is no colour of the table.
        weight = cv2.blur(known.astype(np.float32), (2 * _RING + 1,) * 2)
        share = np.maximum(weight[rows, columns], 1e-6)[:, None]
        expected, bare = (
            cv2.blur(c * known[..., None], (2 * _RING + 1,) * 2)[rows, columns] / share
            for c in (color, origin)
        )
        enough, mean = showing(
            samples, shown, gains, rows, columns, expected, bare, values,
            limits.steady * max(usual, 1.0),
        )  # fmt: skip
        rows, columns = rows[enough], columns[enough]
        if len(rows) == 0:
            return
        color[rows, columns] = mean[enough]
        origin[rows, columns] = bare[enough]
        known[rows, columns] = True


def is_table(model: TableModel) -> bool:
    """Whether most of what the photos show there is at rest, as it is not around a turntable."""
    return bool(model.known.sum() > TableModelSettings.current().at_rest * model.seen.sum())


def _agreed(samples: NDArray[np.uint8], seen: Mask, gains: Floats) -> tuple[Floats, Floats]:
    """Colour (N, 3) on which photos of each cell agree best, and their spread (N,) about it.

    It is the mean of the half, or of the third if that agrees better, that differs least. The
    median is of no use beside an object: it hides those cells from most photos. The spread is 255
    where other photos agree as well on another colour.
    """
    limits = TableModelSettings.current()
    count = samples.shape[1]
    color = np.zeros((count, 3), np.float32)
    spread = np.full(count, 255, np.float32)
    shares = np.array([limits.agree, limits.agree_beside, limits.agree_else])
    agree(samples, seen, gains.astype(np.float32), shares, limits.better, limits.close,
           limits.continued, color, spread)  # fmt: skip
    return color, spread
