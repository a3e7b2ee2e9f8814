"""Scores of one frame, also at edges: steps of depth and outlines of objects."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Size, pixels_taken
from benchmark.metrics.depth.figures import Errors
from benchmark.metrics.depth.tally import tally
from benchmark.metrics.protocols.alignment import Line, PairSums
from benchmark.metrics.protocols.protocol import DEPTH_SUBSET, Grid, Protocol, Subset
from std_toolkit.errors import ToolkitError

STEP = 1.02  # ratio between neighbouring depths: 1 cm at half a metre

_ROWS_AT_ONCE = 32  # whose intermediate figures stay in the processor's cache

COLUMNS_PER_PIXEL = 200  # the band is one pixel wide per this many columns, on each side

_IDS, _NO_CELL = 256, 255  # a mask holds bytes, of which one is background


def band_width(columns: int) -> int:
    """Pixels on each side of an edge that belong to it.

    Args:
        columns: of the image.

    Returns:
        At least 1.

    >>> band_width(224), band_width(640), band_width(1280)
    (1, 3, 6)
    """
    return max(1, round(columns / COLUMNS_PER_PIXEL))


def edge_band(true: NDArray[np.float32], mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pixels within `band_width` of an edge of the ground truth.

    An edge runs between two neighbours in a row or column that belong to different objects (or
    one to none), or whose true depths, both there, differ by more than 2 %. The distance is the
    larger one of rows and columns.

    Args:
        true: (H, W) true metres, 0 where there is none.
        mask: (H, W) ids of objects, `BACKGROUND` elsewhere.

    Returns:
        (H, W) 1 within the band, 0 elsewhere; outside of objects nothing is looked for.

    >>> edge_band(np.array([[1, 1, 1, 2, 2]], np.float32), np.zeros((1, 5), np.uint8)).tolist()
    [[0, 0, 1, 1, 0]]
    """
    band = np.zeros(mask.shape, np.uint8)
    width = band_width(mask.shape[1])
    x, y, columns, rows = cv2.boundingRect((mask != BACKGROUND).view(np.uint8))
    if columns == 0:
        return band
    top, left = max(0, y - width), max(0, x - width)
    window = np.s_[top : y + rows + width, left : x + columns + width]
    m, g, beside = mask[window], true[window], band[window]
    # Where there is no depth there is no step: NaN passes no comparison.
    g = np.where(g > 0, g, np.float32(np.nan))
    for begin in range(0, len(g), _ROWS_AT_ONCE):
        # One row more, for the edges between this part and the next.
        part = np.s_[begin : begin + _ROWS_AT_ONCE + 1]
        for axis in (0, 1):
            _mark_edges(m[part], g[part], beside[part], axis)
    if width > 1:
        kernel = np.ones((2 * width - 1, 2 * width - 1), np.uint8)
        band[window] = cv2.dilate(np.ascontiguousarray(beside), kernel)
    return band


def _mark_edges(
    mask: NDArray[np.uint8], true: NDArray[np.float32], marked: NDArray[np.uint8], axis: int
) -> None:
    """Mark the pixels on both sides of the edges between neighbours along an axis."""
    one, two = ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:]))[axis]
    a, b = true[one], true[two]
    far = np.maximum(a, b)
    near = np.minimum(a, b)
    near *= np.float32(STEP)
    edge = far > near
    edge |= mask[one] != mask[two]
    found = edge.view(np.uint8)
    marked[one] |= found
    marked[two] |= found


@dataclass(frozen=True)
class Row:
    """Errors of one frame on one grid and one subset of its pixels.

    Attributes:
        grid, subset: names from the protocol.
        errors: the figures; NaN where the subset has no pixel in this frame.
    """

    grid: str
    subset: str
    errors: Errors

    def as_dict(self) -> dict[str, str | int | float]:
        """Columns by name: grid, subset, then those of `Errors`."""
        return {"grid": self.grid, "subset": self.subset, **self.errors.as_dict()}


def score_frame(
    restored: NDArray[np.floating] | None,
    frame: DepthFrame,
    protocol: Protocol,
    line: Line | None = None,
) -> list[Row]:
    """Compare restored depth with a frame's ground truth.

    Args:
        restored: (h, w) metres, of any size that covers the frame's view: it is resized to each
            grid. None where the method failed: every pixel is missing, and the frame stays in
            the means.
        frame: what was there.
        protocol: how to compare.
        line: scale and shift of a protocol that aligns; by default those of this frame alone.

    Returns:
        A row for each grid and subset, in the protocol's order, also for subsets without pixels;
        then rows for the protocol's ranges of depth, those without pixels left out.

    Raises:
        ToolkitError: `restored` is not an image of floating-point numbers.

    >>> from benchmark.data.frame import Material
    >>> from benchmark.metrics.protocols.protocol import get_protocol
    >>> from std_toolkit.geometry import Camera
    >>> color, true = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32)
    >>> mask, mug = np.zeros((4, 4), np.uint8), Instance(0, 6, Material.SPECULAR)
    >>> frame = DepthFrame("a", "0", color, true, true, mask, Camera(4, 4, 5, 5, 1.5, 1.5), (mug,))
    >>> score_frame(true + np.float32(0.25), frame, get_protocol())[0].errors.rmse
    0.25
    """
    return score_depth(
        restored, frame.depth_true, frame.mask, frame.instances, protocol, key=frame.key, line=line
    )


def score_sensor(frame: DepthFrame, protocol: Protocol) -> list[Row]:
    """Compare the sensor's own depth with the ground truth: the row that a method has to beat.

    Args:
        frame: what the sensor gave, and what was there.
        protocol: how to compare.

    Returns:
        As `score_frame`.

    >>> from benchmark.data.frame import Material
    >>> from benchmark.metrics.protocols.protocol import get_protocol
    >>> from std_toolkit.geometry import Camera
    >>> color, true = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32)
    >>> mask, mug = np.zeros((4, 4), np.uint8), Instance(0, 6, Material.SPECULAR)
    >>> frame = DepthFrame("", "", color, 0 * true, true, mask, Camera(4, 4, 5, 5, 1, 1), (mug,))
    >>> score_sensor(frame, get_protocol())[0].errors.rmse
    1.0
    """
    return score_frame(frame.depth_raw, frame, protocol)


def score_depth(
    restored: NDArray[np.floating] | None,
    true: NDArray[np.float32],
    mask: NDArray[np.uint8],
    instances: Sequence[Instance],
    protocol: Protocol,
    *,
    key: str = "frame",
    line: Line | None = None,
) -> list[Row]:
    """`score_frame` without a whole frame, for example to score saved results again.

    Args:
        restored: (h, w) metres, or None.
        true: (k, l) true metres, 0 where there is none.
        mask: (k, l) ids of `instances`, `BACKGROUND` elsewhere.
        instances: the objects.
        protocol: how to compare.
        key: name of the frame in errors.
        line: as of `score_frame`.

    Returns:
        As `score_frame`.

    Raises:
        ToolkitError: as `score_frame`.

    >>> from benchmark.data.frame import Material
    >>> from benchmark.metrics.protocols.protocol import get_protocol
    >>> true, mask = np.ones((4, 4), np.float32), np.zeros((4, 4), np.uint8)
    >>> mug = Instance(0, 6, Material.SPECULAR)
    >>> first = score_depth(true + np.float32(0.04), true, mask, [mug], get_protocol())[0]
    >>> first.grid, first.subset, first.errors.n_pixels, first.errors.d105
    ('h126w224', 'all', 28224, 1.0)
    """
    if restored is None:
        restored = np.zeros((1, 1), np.float32)
    if restored.ndim != 2 or restored.size == 0 or restored.dtype.kind != "f":
        raise ToolkitError(
            "restored depth must be one image (h, w) of floating-point metres",
            path=key,
            value=f"{restored.dtype} {restored.shape}",
        )
    if protocol.align:
        restored = (line or pair_sums(restored, true, protocol).line).of(restored)
    subsets = protocol.subsets_of(instances)
    # An edge is one of the whole ground truth: on a coarse grid every neighbour is far away.
    band = edge_band(true, mask) if any(s.edges for s in subsets) else None
    cells = _Cells(instances, subsets)
    rows: list[Row] = []
    by_depth: list[Row] = []
    for grid in protocol.grids:
        p, g, cell = _gather(restored, true, mask, band, cells, grid, protocol)
        errors = tally(p, g, cell, 2 * cells.count, protocol.missing).of_each(cells.members)
        rows += [Row(grid.name, s.name, e) for s, e in zip(subsets, errors, strict=True)]
        if grid is protocol.grids[0] and protocol.depth_bins:
            by_depth = _by_depth(p, g, grid, protocol)
    return rows + by_depth


def pair_sums(
    restored: NDArray[np.floating], true: NDArray[np.float32], protocol: Protocol
) -> PairSums:
    """Return the sums that align predictions: over all pixels of the first grid with truth.

    Args:
        restored: (h, w) predictions of any unit.
        true: (k, l) true metres, 0 where there is none.
        protocol: whose grid and range of depth count.

    Returns:
        The sums, without missing predictions.

    >>> from benchmark.metrics.protocols.protocol import get_protocol
    >>> true = np.full((126, 224), 0.5, np.float32)
    >>> pair_sums(2 * true, true, get_protocol("aligned-frame")).count == 126 * 224
    True
    """
    steps = protocol.grids[0].steps((true.shape[1], true.shape[0]))
    depths = [
        image.ravel() if taken is None else image.ravel().take(taken)
        for image in (restored, true)
        for taken in [pixels_taken((image.shape[1], image.shape[0]), *steps)]
    ]
    there = protocol.usable(depths[1])
    return PairSums.of(depths[0][there], depths[1][there])


def _by_depth(
    p: NDArray[np.floating], g: NDArray[np.float32], grid: Grid, protocol: Protocol
) -> list[Row]:
    """A row for each range of true depth that has pixels."""
    ends = np.array(protocol.depth_bins, np.float32)
    place = np.searchsorted(ends, g, side="right") - 1
    within = np.flatnonzero((place >= 0) & (place < len(ends) - 1))
    if not within.size:
        return []
    count = len(ends) - 1
    sums = tally(p.take(within), g.take(within), place.take(within), count, protocol.missing)
    each = sums.of_each(np.eye(count, dtype=np.bool_))
    return [
        Row(grid.name, DEPTH_SUBSET.format(low, high), errors)
        for (low, high), errors in zip(pairwise(protocol.depth_bins), each, strict=True)
        if errors.n_pixels
    ]


class _Cells:
    """Objects as cells of `tally`: first the pixels away from edges, then those at edges."""

    def __init__(self, instances: Sequence[Instance], subsets: Sequence[Subset]) -> None:
        of_id: dict[int, list[Instance]] = {}
        for instance in instances:
            if instance.mask_id != BACKGROUND:
                of_id.setdefault(instance.mask_id, []).append(instance)
        # The background is a cell of its own where a subset wants every pixel.
        every = [s.scene for s in subsets]
        self.count = len(of_id) + any(every)
        belongs = np.zeros((len(subsets), self.count), np.bool_)
        self.of_id = np.full(_IDS, _NO_CELL, np.uint8)
        for i, (mask_id, objects) in enumerate(of_id.items()):
            belongs[:, i] = [s.scene or any(s.has(o) for o in objects) for s in subsets]
            if belongs[:, i].any():
                self.of_id[mask_id] = i
        if any(every):
            belongs[:, -1] = every
            self.of_id[BACKGROUND] = self.count - 1
        edges = np.array([s.edges for s in subsets])
        self.members = np.concatenate([belongs & ~edges[:, None], belongs], axis=1)


def _gather(
    restored: NDArray[np.floating],
    true: NDArray[np.float32],
    mask: NDArray[np.uint8],
    band: NDArray[np.uint8] | None,
    cells: _Cells,
    grid: Grid,
    protocol: Protocol,
) -> tuple[NDArray[np.floating], NDArray[np.float32], NDArray[np.integer]]:
    """Prediction, truth and cell of the pixels of a grid that are compared, (N,) each."""
    native: Size = (mask.shape[1], mask.shape[0])
    steps = grid.steps(native)
    taken = pixels_taken(native, *steps)
    ids, depths = mask.ravel(), true.ravel()
    if taken is not None:
        ids, depths = ids.take(taken), depths.take(taken)
    cell: NDArray[Any] = cv2.LUT(ids, cells.of_id).ravel()
    kept = np.flatnonzero(cell != _NO_CELL)
    g = depths.take(kept)
    there = protocol.usable(g)
    if not there.all():
        picked = np.flatnonzero(there)
        kept, g = kept.take(picked), g.take(picked)
    cell = cell.take(kept)
    at = kept if taken is None else taken.take(kept)
    if band is not None:
        cell = cell + np.uint16(cells.count) * band.ravel().take(at)
    from_restored = pixels_taken((restored.shape[1], restored.shape[0]), *steps)
    p = restored.ravel().take(kept if from_restored is None else from_restored.take(kept))
    return p, g, cell
