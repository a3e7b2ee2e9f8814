"""Position of the edge along the normal of a contour point, from colour steps and statistics.

Two kinds of evidence along each normal are added:

- The colour step is signed, per channel, and averaged with the neighbours along the contour, which
  cancels texture but not the object's border. It is precise, but also responds to other borders.
- The colour statistics of object and surroundings are histograms, as in region-based trackers.
  They are imprecise, but distinguish the object from its surroundings.

The statistics dominate far from the right pose, the step within the last pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.labels.refine.caster import Patch
from std_toolkit.labels.refine.edges.contour import Contour, Kind

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

_BINS = 16
_SHARED_SIGMAS = 3.5
# Evidence of neighbouring pixels on a line is not independent.
_REGION_WEIGHT = 0.25
_LARGEST_LOG_RATIO = 2.5


@dataclass(frozen=True, eq=False)
class EdgeMeasurements:
    """One offset per contour sample.

    Attributes:
        offset: (N,) pixels from the predicted contour outward to the edge.
        weight: (N,) 0 to 1: clarity of the edge; 0 without an edge.
    """

    offset: Array
    weight: Array


def colour_odds(
    image: NDArray[np.uint8], patch: Patch, index: int, *, margin: int
) -> Array32 | None:
    """(h, w) log ratio of object to surroundings at every pixel of the patch, by its colour.

    None if object or surroundings are too small for statistics.
    """
    h, w = patch.hits.object.shape
    crop = image[patch.y : patch.y + h, patch.x : patch.x + w]
    mask = patch.hits.object == index
    kernel = np.ones((3, 3), np.uint8)
    solid = mask.astype(np.uint8)
    near = cv2.dilate(solid, kernel, iterations=max(margin, 2)).astype(bool)
    core = cv2.erode(solid, kernel).astype(bool)
    around = near & ~cv2.dilate(solid, kernel).astype(bool)
    if core.sum() < 20 or around.sum() < 20:
        return None
    levels = (crop >> 4).astype(np.int64)
    code = (levels[..., 0] * _BINS + levels[..., 1]) * _BINS + levels[..., 2]
    p_in = _histogram(code[core])
    p_out = _histogram(code[around])
    ratio = np.log(p_in / p_out).astype(np.float32)
    return np.clip(ratio, -_LARGEST_LOG_RATIO, _LARGEST_LOG_RATIO)[code]


def _histogram(codes: NDArray[np.int64]) -> Array32:
    cube = np.bincount(codes, minlength=_BINS**3).astype(np.float32).reshape((_BINS,) * 3)
    # Neighbouring bins are smoothed: noise and shading move colours by about a bin.
    for axis in range(3):
        every = (slice(None),) * axis
        first, last = (*every, slice(None, -1)), (*every, slice(1, None))
        half, cube = np.float32(0.5) * cube, cube.copy()
        cube[last] += half[first]
        cube[first] += half[last]
    flat = cube.ravel()
    floor = 1e-3 * flat.sum() / 64
    return (flat + floor) / (flat + floor).sum()


def measure_edges(
    image: NDArray[np.uint8],
    patch: Patch,
    contour: Contour,
    odds: Array32 | None,
    *,
    reach: int,
    along: float,
    spread: float,
    region_weight: float = 1.0,
    crease_weight: float = 1.0,
    taken: Array32 | None = None,
) -> EdgeMeasurements:
    """The most likely edge along every normal.

    Args:
        reach: pixels searched to both sides.
        along: Gaussian sigma of the averaging along the contour, pixels.
        spread: expected distance of the edge, pixels (standard deviation).
        region_weight: weight of the colour statistics; 0 uses the colour step only.
        crease_weight: weight of edges near creases, which may be invisible on a textured surface.
        taken: (h, w) predicted contours in the patch: an edge that another contour explains is
            not used for this one.
    """
    d = np.arange(-reach, reach + 1, dtype=np.float64)
    # The derivative of the profile needs a margin, which is then removed.
    pad = 3
    wide = np.arange(-reach - pad, reach + pad + 1, dtype=np.float64)
    # Columns and rows apart: small last axes are slow.
    x, y = (contour.pixels[:, k, None] + wide * contour.normals[:, k, None] for k in (0, 1))
    share = _sharing(contour, along)
    crop, left, top = _around(image, x, y)
    step = _derivative(_sample(crop, x - left, y - top))[:, pad:-pad]
    step = (share @ step.reshape(len(step), -1)).reshape(step.shape)
    square = step * step
    magnitude = np.sqrt(square[..., 0] + square[..., 1] + square[..., 2])
    noise = float(np.median(magnitude)) + 0.5
    relative = magnitude / noise
    score = 1.2 * np.log1p(relative**2)
    inner = x[:, pad:-pad] - patch.x, y[:, pad:-pad] - patch.y
    if taken is not None:
        elsewhere = _sample(taken, *inner) * (np.abs(d) > 1.5)
        score = score - 3.0 * elsewhere
    if odds is not None and region_weight > 0:
        line = share @ _sample(odds, *inner)
        within = np.cumsum(line, axis=1) - line / 2
        total = line.sum(axis=1, keepdims=True)
        # Inside the silhouette both sides are the object: its colours are not informative.
        weight = region_weight * _REGION_WEIGHT * (contour.kind == Kind.SILHOUETTE)[:, None]
        score = score + weight * (2 * within - total)
    posterior = score - 0.5 * (d / spread) ** 2
    best = posterior.argmax(axis=1)
    rows = np.arange(len(best))
    # A second candidate must be another peak, not the flank of the best one.
    rivals = np.where(np.abs(np.arange(len(d))[None] - best[:, None]) <= 3, -np.inf, posterior)
    gap = posterior[rows, best] - rivals.max(axis=1)
    offset = d[best] + _peak_shift(magnitude, best)
    strength = relative[rows, best] ** 2
    weight = np.clip(gap / 2, 0.02, 1) * strength / (1 + strength)
    weight = weight * np.where(contour.kind == Kind.CREASE, crease_weight, 1.0)
    at_end = (best == 0) | (best == len(d) - 1)
    return EdgeMeasurements(offset, np.where(at_end, 0, weight))


def _sharing(contour: Contour, along: float) -> csr_array:
    """(N, N) weights by which samples share their evidence; rows sum to 1."""
    from scipy.sparse import csr_array

    size = len(contour.pixels)
    here, there, square = contour.near(_SHARED_SIGMAS * along)
    weight = np.exp(-0.5 * square / max(along, 1e-3) ** 2).astype(np.float32)
    total = np.bincount(here, weight, size).astype(np.float32)
    # Few neighbours matter: a dense product would take most of the refinement time.
    order = np.argsort(here * size + there)
    ends = np.cumsum(np.bincount(here, minlength=size))
    starts = np.concatenate([[0], ends]).astype(np.int32)
    each = (weight / total[here])[order]
    return csr_array((each, there[order].astype(np.int32), starts), shape=(size, size))


def _around(image: NDArray[np.uint8], x: Array, y: Array) -> tuple[Array32, int, int]:
    """The part of an image that contains the pixels, as float32, and its first column and row."""
    bounds = []
    for values, size in ((x, image.shape[1]), (y, image.shape[0])):
        low = int(np.clip(np.floor(values.min()) - 2, 0, size - 2))
        bounds.append((low, int(np.clip(np.ceil(values.max()) + 3, low + 2, size))))
    (left, right), (top, bottom) = bounds
    return image[top:bottom, left:right].astype(np.float32), left, top


def _sample(image: Array32, x: Array, y: Array) -> Array32:
    """Bilinear samples of an image at columns and rows (N, M)."""
    return np.asarray(
        cv2.remap(
            image,
            x.astype(np.float32),
            y.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=np.float32,
    )


def _derivative(profile: Array32) -> Array32:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(profile, 1.0, axis=1, order=1, mode="nearest")


def _peak_shift(magnitude: Array32, best: NDArray[np.intp]) -> Array:
    """Sub-pixel distance of the step's peak from the sample `best`, within 2.5 px."""
    count = magnitude.shape[1]
    rows = np.arange(len(best))
    around = np.clip(best[:, None] + np.arange(-2, 3), 1, count - 2)
    top = around[rows, magnitude[rows[:, None], around].argmax(axis=1)]
    a, b, c = (magnitude[rows, top + k].astype(np.float64) for k in (-1, 0, 1))
    curve = a - 2 * b + c
    shift = np.where(curve < -1e-6, 0.5 * (a - c) / np.where(curve < -1e-6, curve, -1), 0)
    return (top - best) + np.clip(shift, -0.5, 0.5)
