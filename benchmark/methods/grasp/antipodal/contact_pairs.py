"""Pairs of surface points between which a gripper can close."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Nearer together than this, two points are one.
_LEAST_WIDTH_M = 0.0015
# Cells that distinguish pairs when the best are chosen.
_CELL_M, _CELL_COS = 0.012, 0.25
# Two points of a circle: cosine of the least angle between their normals, how much the radii that
# they give may differ, and the sine from which on an axis is taken to lie.
_ROUND_COS, _ROUNDNESS, _LYING = -0.1, 0.15, 0.3
_LEAST_RADIUS_M = 0.004
# Walls whose other side is hidden: how thick they may be, how squarely they face the eye, how
# steep they are (z of the normal), and what is thought of such a pair.
_WALL_M = 0.005
_FACING, _STEEP = 0.35, 0.7
_RIM_QUALITY = 0.5
# In hidden faces behind edges, compared with faces that are seen.
_EDGE_TRUST = 0.8


@dataclass(frozen=True, eq=False)
class Pairs:
    """K pairs of contacts.

    Attributes:
        middles: (K, 3) metres.
        closings: (K, 3) unit vectors between the contacts.
        widths: (K,) between them, metres.
        quality: (K,) from 0 to 1: how squarely the fingers meet the surface, and how much of it
            was seen.
    """

    middles: Floats
    closings: Floats
    widths: Floats
    quality: Floats

    def __len__(self) -> int:
        return len(self.widths)

    @staticmethod
    def concatenated(batches: Sequence[Pairs]) -> Pairs:
        """The pairs of all."""
        return Pairs(
            np.concatenate([b.middles for b in batches]),
            np.concatenate([b.closings for b in batches]),
            np.concatenate([b.widths for b in batches]),
            np.concatenate([b.quality for b in batches]),
        )

    def __getitem__(self, which: NDArray[np.integer] | NDArray[np.bool_]) -> Pairs:
        return Pairs(
            self.middles[which], self.closings[which], self.widths[which], self.quality[which]
        )


_NO_PAIRS = Pairs(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))


def antipodal_pairs(
    points: Floats, normals: Floats, *, widest: float, cone: float, trust: Floats | None = None
) -> Pairs:
    """All pairs whose normals look away from each other, along the line between them.

    Args:
        points, normals: (C, 3), normals out of the object.
        widest: metres.
        cone: least cosine of the angle between a normal and the line.
        trust: (C,) in the points, from 0 to 1; all of it by default.
    """
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return _NO_PAIRS
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
    middle = (points[i] + points[j])[held] / 2
    square = (quality[held] - cone) / (1 - cone)
    if trust is not None:
        square *= np.minimum(trust[i], trust[j])[held]
    return Pairs(middle, closing[held], width[held], square)


def round_pairs(points: Floats, normals: Floats, *, widest: float) -> Pairs:
    """Level diameters of round bodies of which the camera sees less than half.

    The lines through two points along their normals meet in the middle of a ball, or on the axis
    of a cylinder, as far from the one point as from the other. That circle is closed by
    assumption, and held where it is level, also where nothing of it is seen there.

    Args:
        points, normals: (C, 3), normals out of the object.
        widest: metres.
    """
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return _NO_PAIRS
    i, j = cKDTree(points).query_pairs(widest, output_type="ndarray").T
    cosine = np.einsum("ni,ni->n", normals[i], normals[j])
    apart = (cosine < _ROUND_COS) & (cosine > -0.999)
    i, j, cosine = i[apart], j[apart], cosine[apart]
    # Closest points p - a n and q - b m of the two lines; m, n of unit length.
    line = points[i] - points[j]
    along_i = np.einsum("ni,ni->n", normals[i], line)
    along_j = np.einsum("ni,ni->n", normals[j], line)
    slant = 1 - cosine**2
    a = (along_i - cosine * along_j) / slant
    b = (cosine * along_i - along_j) / slant
    on_i, on_j = points[i] - a[:, None] * normals[i], points[j] - b[:, None] * normals[j]
    radius = (a + b) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        fits = (
            (radius > _LEAST_RADIUS_M)
            & (2 * radius < widest)
            & (np.abs(a - b) < _ROUNDNESS * radius)
            & (np.linalg.norm(on_i - on_j, axis=1) < _ROUNDNESS / 2 * radius)
        )
    i, j, cosine, radius = i[fits], j[fits], cosine[fits], radius[fits]
    middle = (on_i + on_j)[fits] / 2
    axis = np.cross(normals[i], normals[j])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    level = np.cross(axis, np.array([0.0, 0.0, 1.0]))
    lying = np.linalg.norm(level, axis=1)
    # Round an upright axis all directions are level: that between the points is as good as any.
    chord = points[j] - points[i]
    closing = np.where((lying > _LYING)[:, None], level, chord)
    closing /= np.linalg.norm(closing, axis=1, keepdims=True)
    quality = np.arccos(cosine) / np.pi
    return Pairs(middle, closing, 2 * radius, quality)


def with_edges(
    points: Floats, normals: Floats, outwards: Floats, at_edge: NDArray[np.bool_]
) -> tuple[Floats, Floats, Floats]:
    """Places on faces, and on the hidden faces behind their edges: the sides of a box of which
    the lid alone is seen.

    The hidden faces are taken to go back from the edges squarely.

    Args:
        points, normals: (C, 3), normals out of the object.
        outwards: (C, 3) out over the edge, along the face; 0 where there is none.
        at_edge: (C,) what lies beside the point lies far behind it.

    Returns:
        (D, 3) points, (D, 3) normals and (D,) trust in them.
    """
    edge = at_edge & outwards.any(axis=1)
    return (
        np.concatenate([points, points[edge]]),
        np.concatenate([normals, outwards[edge]]),
        np.concatenate([np.ones(len(points)), np.full(int(edge.sum()), _EDGE_TRUST)]),
    )


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
