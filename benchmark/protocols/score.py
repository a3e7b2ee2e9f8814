"""Scoring one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame, Instance
from benchmark.metrics.resize import Size, pixels_taken
from benchmark.metrics.tally import Errors, tally
from benchmark.protocols.edges import edge_band
from benchmark.protocols.protocol import DEPTH_SUBSET, Grid, Protocol, Subset
from std_toolkit.errors import ToolkitError

_IDS, _NO_CELL = 256, 255  # a mask holds bytes, of which one is background


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
    restored: NDArray[np.floating] | None, frame: DepthFrame, protocol: Protocol
) -> list[Row]:
    """Compare restored depth with a frame's ground truth.

    Args:
        restored: (h, w) metres, of any size that covers the frame's view: it is resized to each
            grid. None where the method failed: every pixel is missing, and the frame stays in
            the means.
        frame: what was there.
        protocol: how to compare.

    Returns:
        A row for each grid and subset, in the protocol's order, also for subsets without pixels;
        then rows for the protocol's ranges of depth, those without pixels left out.

    Raises:
        ToolkitError: `restored` is not an image of floating-point numbers.
    """
    return score_depth(
        restored, frame.depth_true, frame.mask, frame.instances, protocol, key=frame.key
    )


def score_sensor(frame: DepthFrame, protocol: Protocol) -> list[Row]:
    """Compare the sensor's own depth with the ground truth: the row that a method has to beat.

    Args:
        frame: what the sensor gave, and what was there.
        protocol: how to compare.

    Returns:
        As `score_frame`.
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
) -> list[Row]:
    """`score_frame` for who has no whole frame at hand, such as saved results being scored anew.

    Args:
        restored: (h, w) metres, or None.
        true: (k, l) true metres, 0 where there is none.
        mask: (k, l) ids of `instances`, `BACKGROUND` elsewhere.
        instances: the objects.
        protocol: how to compare.
        key: what errors call the frame.

    Returns:
        As `score_frame`.

    Raises:
        ToolkitError: as `score_frame`.

    >>> from benchmark.data.frame import Material
    >>> from benchmark.protocols.registry import get_protocol
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
        self.count = len(of_id)
        belongs = np.zeros((len(subsets), self.count), np.bool_)
        self.of_id = np.full(_IDS, _NO_CELL, np.uint8)
        for i, (mask_id, objects) in enumerate(of_id.items()):
            belongs[:, i] = [any(s.has(o) for o in objects) for s in subsets]
            if belongs[:, i].any():
                self.of_id[mask_id] = i
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
