"""Corners of square tags as intersections of their edges.

Corner refinement settles inside the dark border of a blurred tag, by more than half a pixel on a
photo of a hand-held camera. The size of the board then seems too small against the distances of its
tags. The steepest place across a straight edge is not moved by a blur, and a whole edge of places
fits one line.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from std_toolkit.arrays import Array, Floats
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Part of an edge at either end that the neighbouring edge disturbs.
_ENDS = 0.14
# Reach of the search across an edge, in cells of the tag and in pixels, and its step.
_REACH_CELLS, _REACH_PX, _STEP_PX = 0.8, 5.0, 0.2
_SMALLEST_REACH_PX = 1.5
# Cells of an AprilTag of the family 36h11 across; families with fewer have larger ones.
_CELLS = 8
_MOST_SAMPLES = 60
_ROUNDS = 2


@dataclass(frozen=True, kw_only=True)
class TagEdgeSettings(Settings):
    """Edges of tags that determine corners."""

    faintest: float = limit(4.0, unit="grey values per pixel", source=NOT_RECORDED)
    """a weaker gradient is no edge"""
    fewest_samples: int = limit(6, source=NOT_RECORDED)
    """samples along an edge that it needs"""
    seen_share: float = limit(0.5, source="the ends of an edge must not be far from what is seen")
    """smallest fraction of an edge that must be seen"""
    off_line_px: float = limit(0.6, unit="px", source=NOT_RECORDED)
    """a place further from the line of its edge, or a corner that moves further, is something
    else"""


def edge_corners(grey: NDArray[np.uint8], corners: Array) -> Array:
    """Corners of tags, refined by lines through their edges.

    Args:
        grey: (H, W) image.
        corners: (N, 4, 2) pixels in the order of OpenCV, around each tag, to within about a cell.

    Returns:
        (N, 4, 2) pixels, pixel centres at integers. A corner beside an edge that is not seen keeps
        its place.
    """
    # Light adds up in a blur, coded values do not: their steepest place is nearer to the black.
    light = (255 * (grey / 255.0) ** 2.2).astype(np.float32)
    # Splines have continuous slopes; local interpolation is steepest at pixels.
    image = spline_filter(cv2.GaussianBlur(light, (0, 0), 0.7), order=3, output=np.float32)
    refined = np.array(corners, np.float64)
    for n in range(len(refined)):
        for _ in range(_ROUNDS):
            refined[n] = _refined(image, refined[n], np.asarray(corners[n], np.float64))
    return refined


def _refined(image: Floats, quad: Array, first: Array) -> Array:
    """(4, 2) corners of one tag from lines beside the sides of `quad`."""
    side = float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min())
    reach = float(np.clip(_REACH_CELLS * side / _CELLS, _SMALLEST_REACH_PX, _REACH_PX))
    lines = [_edge_line(image, quad[k], quad[(k + 1) % 4], quad.mean(axis=0), reach)
             for k in range(4)]  # fmt: skip
    out = quad.copy()
    for k in range(4):
        before, after = lines[k - 1], lines[k]
        if before is None or after is None:
            continue
        # Lines as n . p = c.
        normals = np.stack([before[:2], after[:2]])
        if abs(np.linalg.det(normals)) < 0.15:
            continue
        point = np.linalg.solve(normals, [before[2], after[2]])
        if np.linalg.norm(point - first[k]) < reach:
            out[k] = point
    return out


def _edge_line(image: Floats, a: Array, b: Array, middle: Array, reach: float) -> Array | None:
    """(nx, ny, c) of the line n . p = c along the edge from a to b; None if it is not seen."""
    limits = TagEdgeSettings.current()
    along = b - a
    length = float(np.linalg.norm(along))
    if length < 2 * limits.fewest_samples:
        return None
    along /= length
    out = np.array([along[1], -along[0]])
    if out @ (a - middle) < 0:
        out = -out
    count = int(np.clip(length * (1 - 2 * _ENDS), limits.fewest_samples, _MOST_SAMPLES))
    s = np.linspace(_ENDS * length, (1 - _ENDS) * length, count)
    t = np.arange(-reach - _STEP_PX, reach + 1.5 * _STEP_PX, _STEP_PX)
    p = a + s[:, None, None] * along + t[None, :, None] * out
    h, w = image.shape
    inside = ((p > 1) & (p < np.array([w, h]) - 2)).all(axis=(1, 2))
    if inside.sum() < limits.fewest_samples:
        return None
    p = p[inside]
    profile = map_coordinates(image, (p[..., 1], p[..., 0]), order=3, prefilter=False)
    # The paper around a tag is bright: only a rise outwards is its edge.
    slope = np.asarray((profile[:, 2:] - profile[:, :-2]) / (2 * _STEP_PX), np.float64)
    top = np.clip(slope.argmax(axis=1), 1, slope.shape[1] - 2)
    row = np.arange(len(slope))
    left, peak, right = (slope[row, top + k] for k in (-1, 0, 1))
    bend = left - 2 * peak + right
    shift = np.where(bend < -1e-6, 0.5 * (left - right) / np.minimum(bend, -1e-6), 0)
    good = (peak > limits.faintest) & (np.abs(shift) <= 1) & (slope.argmax(axis=1) == top)
    if good.sum() < max(limits.fewest_samples, limits.seen_share * count):
        return None
    points = (
        a
        + s[inside][good][:, None] * along
        + (t[1:-1][top[good]] + shift[good] * _STEP_PX)[:, None] * out
    )
    return _line(points, out)


def _line(points: Array, out: Array) -> Array | None:
    """(nx, ny, c) of the line that most of the points (N, 2) are on."""
    limits = TagEdgeSettings.current()
    kept = np.ones(len(points), bool)
    for _ in range(4):
        middle = points[kept].mean(axis=0)
        normal = np.linalg.svd(points[kept] - middle, full_matrices=False)[2][1]
        off = np.abs((points - middle) @ normal)
        limit = max(limits.off_line_px / 2, 2.5 * float(np.median(off[kept])))
        kept = off < min(limit, 4 * limits.off_line_px)
        if kept.sum() < limits.fewest_samples:
            return None
    if float(np.median(off[kept])) > limits.off_line_px or abs(normal @ out) < 0.9:
        return None
    return np.array([*normal, float(normal @ middle)])
