"""Distance between the contour of a label and the edges of the image.

The image is sampled as a profile along the normal of every contour point. Edges are the peaks of
the profile's slope. The profiles give two measures:

- the distance to the nearest edge, which any nearby texture makes small;
- the shift of the whole contour that fits the edges best, which is less sensitive to texture,
  because texture has no single direction.

The shifts of all frames are then split into two parts. A wrong label gives shifts that one
correction in the world explains; refinement fixes it. Wrong camera poses or a wrong scale give
shifts that no correction explains: drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import Contour
from std_toolkit.geometry import SE3, Camera
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

STEP_PX = 0.5


LARGEST_SAMPLE = 300


_COARSE_PX = 1.0

_FINE_PX = 0.4


# Largest expected label error, and the accuracy of one shift: they bound depth, which a narrow
# sweep does not determine.
_PRIOR_M = 0.02

_SHIFT_PX = 0.5


@dataclass(frozen=True, kw_only=True)
class EdgeSettings(Settings):
    """Edges and shifts that count."""

    smallest_slope: float = limit(1.5, unit="grey levels per pixel", source=NOT_RECORDED)
    """a smaller peak is noise in any 8-bit image"""
    relative_slope: float = limit(0.2, source=NOT_RECORDED)
    """a peak below this fraction of the steepest slope of its profile is texture, not an outline"""
    fewest_points: int = limit(24, source=NOT_RECORDED)
    """points of a contour that a measurement needs"""
    smallest_gain: float = limit(0.15, source=NOT_RECORDED)
    """smallest gain of the score by a shift"""
    rival_px: float = limit(3.0, unit="px", source=NOT_RECORDED)
    """a rival of a shift is at least this far away"""
    largest_rival: float = limit(0.85, source=NOT_RECORDED)
    """largest gain of a rival, as a part of that of the best shift"""
    fewest_frames: int = limit(3, source=NOT_RECORDED)
    """frames with a shift from which the common translation is taken"""


@dataclass(frozen=True, eq=False)
class Profiles:
    """Slope of the image along contour normals.

    Attributes:
        slope: (P, S) grey levels per pixel, at least 0.
        offsets: (S,) positions along the normal in px, positive outwards.
        threshold: (P,) slope above which a peak counts as an edge.
        normals: (P, 2).
        index: (P,) places in the contour's points.
    """

    slope: Array
    offsets: Array
    threshold: Array
    normals: Array
    index: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class EdgeDistance:
    """Distances from contour points to the nearest image edge along their normals.

    Attributes:
        median_px, p90_px: over the points with an edge; None if no point has one.
        support: fraction of the points with an edge.
        chance_px: median distance for contours at random places nearby.
        points: number of contour points measured.
    """

    median_px: float | None
    p90_px: float | None
    support: float
    chance_px: float | None
    points: int


@dataclass(frozen=True, slots=True)
class Shift:
    """The shift of the whole contour that fits the image edges best.

    Attributes:
        x_px, y_px: position of the image relative to the label.
        gain: score of the best shift over the mean score of all shifts, minus 1.
    """

    x_px: float
    y_px: float
    gain: float


def smooth_image(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W, 3) float32 image without its pixel noise, the input of `read_profiles`."""
    return cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0)  # type: ignore[return-value]


def noise_level(image: NDArray[np.uint8]) -> float:
    """Standard deviation of the pixel noise in grey levels, 0.3 to 4.

    Source: J. Immerkaer, "Fast noise variance estimation", CVIU 1996 (the kernel), with a median
    in place of the mean, so that texture counts less.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    # Responses are integers: counting them is faster than sorting.
    response = np.abs(cv2.filter2D(grey, cv2.CV_16S, kernel)).ravel()
    ranks = (response.size - 1) // 2, response.size // 2
    middle = np.searchsorted(np.cumsum(np.bincount(response)), ranks, side="right")
    spread = float(middle.mean()) / 6 / 0.6745
    return float(np.clip(spread, 0.3, 4.0))


def read_profiles(
    smoothed: NDArray[np.float32], contour: Contour, *, reach_px: float, noise: float
) -> Profiles | None:
    """Slopes along the normals of the contour points where the object itself ends.

    Args:
        smoothed: from `smooth_image`.
        contour: contour of one object.
        reach_px: length of the profile on both sides.
        noise: from `noise_level`.

    Returns:
        The profiles, or None if too few points remain.
    """
    limits = EdgeSettings.current()
    index = np.flatnonzero(contour.own)
    if len(index) < limits.fewest_points:
        return None
    if len(index) > LARGEST_SAMPLE:
        index = index[np.linspace(0, len(index) - 1, LARGEST_SAMPLE).round().astype(int)]
    points, normals = contour.points[index], contour.normals[index]
    count = round(reach_px / STEP_PX)
    offsets = np.arange(-count - 1, count + 2) * STEP_PX
    at = points[:, None, :] + offsets[:, None] * normals[:, None, :]
    values = cv2.remap(
        smoothed,
        at[..., 0].astype(np.float32),
        at[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).astype(np.float64)
    slope = np.linalg.norm(values[:, 2:] - values[:, :-2], axis=-1) / (2 * STEP_PX * np.sqrt(3))
    floor = max(limits.smallest_slope, 1.4 * noise)
    threshold = np.maximum(floor, limits.relative_slope * slope.max(axis=1))
    return Profiles(slope, offsets[1:-1].astype(np.float64), threshold, normals, index)


def edge_distance(profiles: Profiles) -> EdgeDistance:
    """Distance to the nearest edge, and the distance by chance on the same profiles."""
    position = _peaks(profiles)
    reach = float(profiles.offsets[-1])
    nearest = np.min(np.abs(position), axis=1)
    met = np.isfinite(nearest)
    # The same contour, moved along its normals away from the label.
    moved = [np.min(np.abs(position - s), axis=1) for s in np.linspace(-reach / 2, reach / 2, 9)]
    if not met.any():
        return EdgeDistance(None, None, 0.0, None, len(nearest))
    chance = float(np.median(np.stack(moved)[:, met]))
    return EdgeDistance(
        float(np.median(nearest[met])),
        float(np.percentile(nearest[met], 90)),
        float(met.mean()),
        chance,
        len(nearest),
    )


def best_shift(profiles: Profiles, *, largest_px: float) -> Shift | None:
    """The shift within `largest_px` at which most of the contour is on strong slopes.

    Slopes are saturated, so that one steep edge does not outweigh many faint ones.

    Returns:
        The shift to about 0.1 px, or None if no shift is much better than the others or the best
        one is at the limit of the search.
    """
    limits = EdgeSettings.current()
    strength = profiles.slope / (profiles.slope + 3 * profiles.threshold[:, None])
    grid = np.arange(-largest_px, largest_px + _COARSE_PX / 2, _COARSE_PX)
    dx, dy = np.meshgrid(grid, grid)
    score = _score(profiles, strength, dx, dy)
    y, x = np.unravel_index(int(score.argmax()), score.shape)
    mean = float(score.mean())
    gain = float(score[y, x] / max(mean, 1e-9) - 1)
    if gain < limits.smallest_gain or not (0 < x < len(grid) - 1 and 0 < y < len(grid) - 1):
        return None
    # A rim or a reflection parallel to the outline gives a second good fit: the frame is then
    # ambiguous.
    elsewhere = score[np.hypot(dx - grid[x], dy - grid[y]) > limits.rival_px]
    if elsewhere.max() - mean > limits.largest_rival * (score[y, x] - mean):
        return None
    near = np.arange(-3, 4) * _FINE_PX
    fx, fy = np.meshgrid(grid[x] + near, grid[y] + near)
    fine = _score(profiles, strength, fx, fy)
    v, u = np.unravel_index(int(fine[1:-1, 1:-1].argmax()), (5, 5))
    v, u = v + 1, u + 1
    return Shift(
        float(fx[v, u] + _FINE_PX * _vertex(*fine[v, u - 1 : u + 2])),
        float(fy[v, u] + _FINE_PX * _vertex(*fine[v - 1 : v + 2, u])),
        gain,
    )


def _score(profiles: Profiles, strength: Array, dx: Array, dy: Array) -> Array:
    """Mean strength under the contour at shifts dx, dy (h, w)."""
    from std_toolkit.checks.measure.edge_sums import strength_at_shifts  # loads numba

    found = strength_at_shifts(profiles.normals, profiles.offsets, strength, dx.ravel(), dy.ravel())
    return np.asarray(found.reshape(dx.shape))


def edge_peaks(profiles: Profiles) -> tuple[Array, Array]:
    """(P, S-2) positions of the edges as in `_peaks`, and their strengths, 0..1."""
    position = _peaks(profiles)
    slope = profiles.slope[:, 1:-1]
    strength = slope / (slope + profiles.threshold[:, None])
    return position, np.where(np.isfinite(position), strength, 0.0)


def _peaks(profiles: Profiles) -> Array:
    """(P, S-2) positions of the edges along the normals in px, infinite without an edge."""
    left, middle, right = (profiles.slope[:, i : i + profiles.slope.shape[1] - 2] for i in range(3))
    is_peak = (middle > left) & (middle >= right) & (middle > profiles.threshold[:, None])
    bend = left - 2 * middle + right
    fine = np.divide(0.5 * (left - right), bend, out=np.zeros_like(bend), where=bend < 0)
    position = profiles.offsets[1:-1] + STEP_PX * fine
    return np.where(is_peak, position, np.inf)


def _vertex(left: float, middle: float, right: float) -> float:
    """Peak of a parabola through three samples, in samples from the middle one."""
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


@dataclass(frozen=True)
class Consistency:
    """Shifts of one object over the frames.

    Attributes:
        frames: number of frames with a shift.
        spread_px: median distance of the shifts from their median.
        offset_m: (3,) translation in the world that explains the shifts best; its length is the
            estimated error of the label.
        drift_px, drift_m: median length of the shifts that remain after that correction, in the
            image and at the object.
    """

    frames: int
    spread_px: float
    offset_m: tuple[float, float, float]
    drift_px: float
    drift_m: float


def shift_jacobian(camera: Camera, T_world_cam: SE3, point_world: Array) -> tuple[Array, float]:
    """Jacobian of the projection of a world point, (2, 3) px per metre, and the point's z."""
    R = T_world_cam.R.T
    x, y, z = R @ (point_world - T_world_cam.t)
    J = np.array(
        [[camera.fx / z, 0, -camera.fx * x / z**2], [0, camera.fy / z, -camera.fy * y / z**2]]
    )
    return J @ R, float(z)


def fit_consistency(
    shifts_px: NDArray[np.floating],
    jacobians: NDArray[np.floating],
    metres_per_px: NDArray[np.floating],
) -> Consistency | None:
    """Split shifts over frames into one correction of the label and drift.

    Args:
        shifts_px: (F, 2) shift of the image against the label.
        jacobians: (F, 2, 3) px per metre, from `shift_jacobian`.
        metres_per_px: (F,) size of a pixel at the object.

    Returns:
        None with fewer than `EdgeSettings.current().fewest_frames` frames.
    """
    d = np.asarray(shifts_px, dtype=np.float64)
    if len(d) < EdgeSettings.current().fewest_frames:
        return None
    J = np.asarray(jacobians, dtype=np.float64)
    offset = np.zeros(3)
    for _ in range(20):
        r = d - J @ offset
        length = np.linalg.norm(r, axis=1)
        # Cauchy weights limit the influence of shifts to a wrong edge.
        scale = max(1.4826 * float(np.median(length)), _SHIFT_PX)
        w = 1 / (1 + (length / scale) ** 2)
        A = np.einsum("f,fij,fik->jk", w, J, J) / _SHIFT_PX**2 + np.eye(3) / _PRIOR_M**2
        step = np.linalg.solve(A, np.einsum("f,fij,fi->j", w, J, d) / _SHIFT_PX**2) - offset
        offset = offset + step
        if np.linalg.norm(step) < 1e-7:
            break
    left = np.linalg.norm(d - J @ offset, axis=1)
    return Consistency(
        len(d),
        float(np.median(np.linalg.norm(d - np.median(d, axis=0), axis=1))),
        (float(offset[0]), float(offset[1]), float(offset[2])),
        float(np.median(left)),
        float(np.median(left * metres_per_px)),
    )
