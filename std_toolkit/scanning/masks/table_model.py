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
from std_toolkit.scanning.photos.views import View
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
) -> list[TableModel]:
    """The table near the board and, if it is at rest, far around it, as low photos show it.

    Args:
        views: photos.
        corners: (M, 3) corners of the board, world.
        blocked: (H, W) pixels of each photo before which something stands.
        cells: number of cells of each table at most.
    """
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    size = float((high - low).max())
    low, high = low - _NEAR * size, high + _NEAR * size
    tables = [model_table(views, low, high, corners, blocked, cells=cells)]
    low, high = low - _FAR * size, high + _FAR * size
    far = model_table(views, low, high, corners, blocked, cells=cells)
    return [*tables, far] if is_table(far) else tables


def model_table(
    views: Sequence[View],
    low: Array,
    high: Array,
    corners: Array,
    blocked: Sequence[Mask] | None = None,
    *,
    cells: int = MOST_CELLS,
) -> TableModel:
    """Colours of the table between two corners (x, y), metres.

    Args:
        views: photos.
        low, high: (2,) corners.
        corners: (M, 3) corners of the board that photos show, world: they lie on the table.
        blocked: (H, W) pixels of each photo before which something stands.
        cells: number of cells at most.
    """
    limits = TableModelSettings.current()
    cell = max(_CELL_M, float(np.sqrt((high - low).prod() / cells)))
    w, h = (int(n) for n in np.ceil((high - low) / cell) + 1)
    y, x = np.mgrid[:h, :w]
    points = np.stack([low[0] + x * cell, low[1] + y * cell, np.zeros(x.shape)], axis=-1)
    flat = points.reshape(-1, 3)
    samples = np.zeros((len(views), h * w, 3), np.uint8)
    seen = np.zeros((len(views), h * w), bool)
    shown = np.zeros((len(views), h * w), bool)
    for i, view in enumerate(views):
        uv, z = view.project(flat)
        uv = np.where(np.isfinite(uv), uv, -10).astype(np.float32)
        inside = (uv > 0).all(axis=1) & (uv < np.array(view.camera.size) - 1).all(axis=1) & (z > 0)
        steep = view.centre[2] / np.linalg.norm(view.centre - flat, axis=1) > limits.flattest
        seen[i] = shown[i] = inside & steep
        if blocked is not None:
            x, y = np.rint(uv[inside].T).astype(np.int64)
            seen[i, inside] &= ~blocked[i][y, x]
        blurred = cv2.GaussianBlur(view.image, (0, 0), 0.7)
        # Maps of OpenCV are limited to 32767 rows.
        samples[i] = cv2.remap(
            blurred, uv[:, 0].reshape(h, w), uv[:, 1].reshape(h, w), cv2.INTER_LINEAR
        ).reshape(-1, 3)
    gains = np.ones((len(views), 3), np.float32)
    color = np.zeros((h * w, 3), np.float32)
    spread = np.zeros(h * w, np.float32)
    # A table shines, paper hardly: where it is the larger part, the board tells the exposures.
    board = ((flat >= corners.min(axis=0)) & (flat <= corners.max(axis=0)))[:, :2].all(axis=1)
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
        value = samples[:, rows, columns].astype(np.float32) / gains[:, None]
        there = shown[:, rows, columns]
        fits = there & (np.abs(value - expected).max(axis=-1) < limits.continued)
        gain = value.mean(axis=-1) / np.maximum(bare.mean(axis=-1), 1)
        hue = np.abs(value - gain[..., None] * bare).max(axis=-1)
        fits &= (gain > limits.darkest) & (gain < limits.brightest) & (hue < limits.other_hue)
        count = fits.sum(axis=0)
        enough = (count >= limits.fewest_photos) & (
            count >= limits.continued_share * there.sum(axis=0)
        )
        mean = (value * fits[..., None]).sum(axis=0) / np.maximum(count, 1)[:, None]
        off = np.abs(value - mean).max(axis=-1)
        spread = (off * fits).sum(axis=0) / np.maximum(count, 1)
        enough &= spread < limits.steady * max(usual, 1.0)
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
    photos, count = samples.shape[:2]
    color = np.zeros((count, 3), np.float32)
    spread = np.full(count, 255, np.float32)
    rank = np.arange(photos)[:, None]
    for part in np.array_split(np.arange(count), max(1, count // 50_000)):
        value = samples[:, part].astype(np.float32) / gains[:, None]
        grey = value.mean(axis=-1)
        grey[~seen[:, part]] = np.inf
        order = grey.argsort(axis=0)
        grey = np.take_along_axis(grey, order, axis=0)
        n = seen[:, part].sum(axis=0)
        first, last, width = _narrowest(grey, n, limits.agree, np.ones(grey.shape, bool))
        start, end, third = _narrowest(grey, n, limits.agree_beside, np.ones(grey.shape, bool))
        take = third * limits.better / limits.agree_beside < width / limits.agree
        first, last = np.where(take, start, first), np.where(take, end, last)
        width = np.where(take, third, width)
        used = (rank >= first) & (rank < last)
        start, end, other = _narrowest(grey, n, limits.agree_else, ~used)
        ours, theirs = (np.take_along_axis(grey, i[None], axis=0)[0] for i in (first, start))
        with np.errstate(invalid="ignore"):
            doubtful = (other < 2 * width + limits.close) & (
                np.abs(ours - theirs) > limits.continued
            )
        value = np.take_along_axis(value, order[..., None], axis=0) * used[..., None]
        total = np.maximum(used.sum(axis=0), 1)[:, None]
        mean = value.sum(axis=0) / total
        off = (np.abs(value - mean) * used[..., None]).max(axis=-1)
        color[part] = np.where(n[:, None] > 0, mean, 0)
        spread[part] = np.where((n > 0) & ~doubtful, 2 * off.sum(axis=0) / total[:, 0], 255)
    return color, spread


def _narrowest(
    grey: Floats, n: NDArray[np.int64], share: float, allowed: Mask
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """First, end and width (N,) of the share of sorted values (V, N) that differs least.

    Args:
        grey: values of each cell, ascending; the first n of them are valid.
        n: (N,).
        share: of the n values.
        allowed: (V, N) values that may be used.
    """
    photos = len(grey)
    rank = np.arange(photos)[:, None]
    k = np.maximum(np.ceil(share * n).astype(np.int64), 1)
    end = np.minimum(rank + k - 1, photos - 1)
    within = (rank + k <= n) & allowed & np.take_along_axis(allowed, end, axis=0)
    # All k values must be allowed.
    count = np.vstack([np.zeros((1, grey.shape[1]), np.int64), allowed.cumsum(axis=0)])
    within &= np.take_along_axis(count, end + 1, axis=0) - count[:-1] == k
    high = np.take_along_axis(grey, end, axis=0)
    width = np.where(within, np.where(within, high, 0) - np.where(within, grey, 0), np.inf)
    start = width.argmin(axis=0)
    return start, start + k, width[start, np.arange(grey.shape[1])].astype(np.float32)
