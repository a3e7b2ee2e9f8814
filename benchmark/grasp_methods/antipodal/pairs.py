"""Pairs of places on a surface that two fingers can hold it at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Nearer together than this, two points are one.
_LEAST_WIDTH_M = 0.0015
# Cells by which pairs are told apart when the best are chosen.
_CELL_M, _CELL_COS = 0.012, 0.25
# How far the middle may be moved where both contacts are seen on the near side of a round body.
_LARGEST_SHIFT_M = 0.015
# Walls whose other side is hidden: how thick they may be, how squarely they face the eye, how
# steep they are (z of the normal), and what is thought of such a pair.
_WALL_M = 0.005
_FACING, _STEEP = 0.35, 0.75
_RIM_QUALITY = 0.95


@dataclass(frozen=True, eq=False)
class Pairs:
    """K pairs of contacts.

    Attributes:
        middles: (K, 3) metres.
        closings: (K, 3) unit vectors between the contacts.
        widths: (K,) between them, metres.
        quality: (K,) cosine of the larger angle between a normal and the line.
    """

    middles: Floats
    closings: Floats
    widths: Floats
    quality: Floats

    def __len__(self) -> int:
        return len(self.widths)

    @staticmethod
    def concatenated(a: Pairs, b: Pairs) -> Pairs:
        """The pairs of both."""
        return Pairs(
            np.concatenate([a.middles, b.middles]),
            np.concatenate([a.closings, b.closings]),
            np.concatenate([a.widths, b.widths]),
            np.concatenate([a.quality, b.quality]),
        )

    def __getitem__(self, which: NDArray[np.integer] | NDArray[np.bool_]) -> Pairs:
        return Pairs(
            self.middles[which], self.closings[which], self.widths[which], self.quality[which]
        )


def antipodal_pairs(
    points: Floats, normals: Floats, *, widest: float, cone: float, eye: Floats
) -> Pairs:
    """All pairs whose normals look away from each other, along the line between them.

    Args:
        points, normals: (C, 3), normals out of the object.
        widest: metres.
        cone: least cosine of the angle between a normal and the line.
        eye: (3,) from where the points were seen.
    """
    from scipy.spatial import cKDTree

    nothing = Pairs(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    if len(points) < 2:
        return nothing
    i, j = cKDTree(points).query_pairs(widest, output_type="ndarray").T
    # Cheap first: the normals themselves must look apart.
    apart = np.einsum("ni,ni->n", normals[i], normals[j]) < 1 - 2 * cone**2
    i, j = i[apart], j[apart]
    line = points[j] - points[i]
    width = np.linalg.norm(line, axis=1)
    long = width > _LEAST_WIDTH_M
    i, j, line, width = i[long], j[long], line[long], width[long]
    closing = line / width[:, None]
    quality = np.minimum(
        -np.einsum("ni,ni->n", normals[i], closing), np.einsum("ni,ni->n", normals[j], closing)
    )
    held = quality >= cone
    i, j, closing, width, quality = i[held], j[held], closing[held], width[held], quality[held]
    middle = (points[i] + points[j]) / 2
    shift, wider = _behind(normals[i] + normals[j], middle, width, eye)
    return Pairs(middle + shift, closing, wider, quality)


def rim_pairs(points: Floats, normals: Floats, at_edge: NDArray[np.bool_], eye: Floats) -> Pairs:
    """Pairs at edges of walls of which one side is seen: the rims of bowls, cups and boxes.

    At the outline of a solid body its surface turns away from the eye. Where it faces the eye and
    ends all the same, a wall ends; the other side is taken to be `_WALL_M` behind.

    Args:
        points, normals: (C, 3), normals out of the object.
        at_edge: (C,) what lies beside the point lies far behind it.
        eye: (3,) from where the points were seen.
    """
    sight = eye - points
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    facing = np.einsum("ni,ni->n", normals, sight)
    rim = at_edge & (facing > _FACING) & (np.abs(normals[:, 2]) < _STEEP)
    closing = normals[rim]
    count = len(closing)
    return Pairs(
        points[rim] - _WALL_M / 2 * closing,
        closing,
        np.full(count, _WALL_M),
        np.full(count, _RIM_QUALITY),
    )


def _behind(leaning: Floats, middle: Floats, width: Floats, eye: Floats) -> tuple[Floats, Floats]:
    """How far the widest place lies behind a chord of a round body, and how wide it is.

    Of a cylinder or ball the camera sees less than half; the outermost points that it sees lie on
    a chord before the middle, and their normals lean towards it. The circle through both that has
    these normals has its centre behind the chord by half the width times the tangent of the lean.

    Args:
        leaning: (K, 3) sums of the two normals.
        middle, width: (K, 3) and (K,) of the chords.
        eye: (3,).
    """
    flat = leaning * [1.0, 1.0, 0.0]
    sine = np.linalg.norm(flat, axis=1) / 2
    back = np.divide(-flat, 2 * sine[:, None], out=np.zeros_like(flat), where=sine[:, None] > 1e-6)
    away = np.einsum("ni,ni->n", back, middle - eye) > 0
    sine = np.clip(np.where(away, sine, 0), 0, 0.9)
    cosine = np.sqrt(1 - sine**2)
    shift = np.minimum(width / 2 * sine / cosine, _LARGEST_SHIFT_M)
    return shift[:, None] * back, np.hypot(width, 2 * shift)


def best_spread(pairs: Pairs, count: int, score: Floats) -> Pairs:
    """At most `count` pairs: of those in one place and direction first the best, then the next.

    Args:
        score: (K,) higher is better.
    """
    order = np.argsort(-score, kind="stable")
    pairs = pairs[order]
    # A line has no direction: the half-space decides, so that both of its vectors are one.
    sign = np.where(pairs.closings @ np.array([1.0, 1e-3, 1e-6]) < 0, -1.0, 1.0)
    keys = np.concatenate(
        [pairs.middles / _CELL_M, pairs.closings * sign[:, None] / _CELL_COS], axis=1
    )
    _, cell = np.unique(np.floor(keys).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    # Rank of each pair within its cell, as the order is already the best first.
    by_cell = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[by_cell], prepend=-1))
    rank = np.empty(len(cell), dtype=np.int64)
    rank[by_cell] = np.arange(len(cell)) - np.repeat(starts, np.diff(np.append(starts, len(cell))))
    chosen = np.lexsort((np.arange(len(cell)), rank))[:count]
    return pairs[np.sort(chosen)]
