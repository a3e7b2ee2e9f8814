"""A surface of revolution from the outlines of an object: vessels of glass need no depth.

A ray through the outline touches the surface. In the half-plane of height and radius, a ray is a
hyperbola that touches the profile from outside, whatever the azimuth: the gap between both is one
residual per ray, and axis and profile follow by least squares. Outlines alone do not tell a flat
top from a lid below the line of sight; the lowest top that explains them is taken. Handles and
spouts are out of reach: their outline is left out and its share reported.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from std_toolkit.arrays import Array, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.scanning.vessel.foot import with_foot
from std_toolkit.scanning.vessel.outline_rays import (
    OutlineRays,
    TurnedProfile,
    gap_at,
    mask_outline,
    outline_noise,
    outline_rays,
    ray_gaps,
)
from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Steps between the heights of the profile, and their number.
_STEP_M, _LEAST_HEIGHTS, _MOST_HEIGHTS = 0.001, 40, 260

# Steps of the fit between changes of its top.
_ROUNDS = 6


# Residuals beyond this many deviations count less. Points that were searched for from within a
# vessel, whose inside differs from the table, too, are rather within its outline than beside it.
_HUBER, _HUBER_WITHIN = 2.0, 0.5

# The profile bends by this much over a step, as a deviation; corners are kept by a robust weight.
_BEND_M = 1.5e-4

# Steps below the rim where the profile has no corner.
_AT_RIM = 3

# Deviation of the axis from the vertical: the object stands on the table.
_TILT_RAD = np.deg2rad(0.4)


# Height of the cone above the rim, and its slope in parts of that of the rays.
_CONE_M, _CONE = 0.003, 0.6


@dataclass(frozen=True, kw_only=True)
class RevolveSettings(Settings):
    """When an object is one of revolution."""

    far: float = limit(5.0, unit="deviations", source=NOT_RECORDED)
    """rays that a lower rim leaves further away are not explained"""
    far_px: float = limit(2.0, unit="px", source=NOT_RECORDED)
    """the same, at least in pixels"""
    explained: float = limit(0.005, source=NOT_RECORDED)
    """a lower rim explains the outlines if no larger share of them gets that far"""
    outside: float = limit(6.0, unit="deviations", source=NOT_RECORDED)
    """residuals beyond are no outline of the object"""
    largest_outside: float = limit(0.1, source=NOT_RECORDED)
    """share of the outline that may be left out"""
    largest_px: float = limit(3.0, unit="px", source=NOT_RECORDED)
    """largest root mean square distance of the rest"""
    fewest_over: int = limit(20, source=NOT_RECORDED)
    """rays over the rim that show its height"""


def fit_revolution(views: Sequence[OutlineView]) -> RevolvedSurface:
    """Fit an axis and a profile to the outlines of an object in all views.

    Args:
        views: at least four, from about all sides and two heights.

    Raises:
        ToolkitError: too few views with an outline, or an outline that is not that of a surface of
            revolution.
    """
    points = [mask_outline(view.mask) for view in views]
    rays = outline_rays(views, points)
    state = _first_profile(rays, *_start(views, rays))
    return _fitted(rays, state, RevolveSettings.current().largest_outside)


def fit_outline_points(
    views: Sequence[OutlineView],
    points: Sequence[Array],
    *,
    centre: Array,
    heights: Array,
    radii: Array,
    most_outside: float,
) -> RevolvedSurface:
    """Fit an axis and a profile to points of the outline, near a profile that is known roughly.

    Args:
        views: photos; their masks are not used.
        points: (N, 2) pixels of the outline in each photo.
        centre: (2,) where the axis meets the table, about.
        heights, radii: (K,) the rough profile, metres.
        most_outside: share of the points that may belong to something else.

    Raises:
        ToolkitError: as `fit_revolution`.
    """
    rays = replace(outline_rays(views, points), within=_HUBER_WITHIN)
    top = float(heights[-1])
    count = int(np.clip(top / _STEP_M, _LEAST_HEIGHTS, _MOST_HEIGHTS))
    line = np.interp(np.linspace(0, top, count), heights, radii)
    start = TurnedProfile(line, top, np.array([*centre, 0.0, 0.0]))
    return _fitted(rays, start, most_outside)


def _fitted(rays: OutlineRays, state: TurnedProfile, most_outside: float) -> RevolvedSurface:
    """Axis and profile by least squares from a start."""
    limits = RevolveSettings.current()
    sigma = outline_noise(rays, state)
    state, sigma = _settled(rays, state, sigma)
    for _ in range(2):
        state = _with_cone(_lowest_top(rays, state, sigma))
        state, sigma = _settled(rays, state, sigma)
        state, sigma = _settled(rays, _without_cone(rays, state), sigma)
    state, hidden = with_foot(rays, state, limits.largest_px)
    gap = ray_gaps(rays, state)
    pixels = gap.distance * rays.px_per_m
    kept = np.abs(pixels) <= max(limits.outside * sigma, limits.largest_px)
    outside = float((~kept).mean())
    rms = float(np.sqrt((pixels[kept] ** 2).mean()))
    if outside > most_outside or rms > limits.largest_px:
        raise ToolkitError(
            f"the object is no surface of revolution: its outline is {rms:.1f} px off, and "
            f"{100 * outside:.0f} % of it far off",
            hint="a handle, a spout, or wrong masks? Correct the masks, or spray the object and "
            "scan it without --revolve",
        )
    deviation, seen = _deviation(rays, state, sigma)
    return RevolvedSurface(
        T_world_axis=state.T_world_axis,
        heights=state.heights,
        radii=state.radii,
        deviation_m=deviation,
        seen=seen & ~hidden,
        outline_px=rms,
        outside=outside,
    )


def _start(views: Sequence[OutlineView], rays: OutlineRays) -> tuple[Array, float]:
    """Where the axis meets the table, and a height above the object.

    The middles of the outlines' left and right ends lie in planes through the axis.
    """
    A, b = [], []
    for view in views:
        rows, columns = np.nonzero(view.mask)
        if not len(rows):
            continue
        ends = np.array([[columns.min(), 0.0], [columns.max(), 0.0]])
        ends[:, 1] = rows.mean()
        left, right = (v / np.linalg.norm(v) for v in view.camera.unproject(ends))
        middle = view.T_world_cam.R @ (left + right)
        across = np.cross(middle, [0.0, 0.0, 1.0])[:2]
        across /= max(float(np.linalg.norm(across)), 1e-9)
        A.append(across)
        b.append(across @ view.T_world_cam.t[:2])
    centre = np.linalg.lstsq(np.array(A), np.array(b), rcond=None)[0]
    # Height of the rays where they pass the axis: none touches the object above all of them.
    o, d = rays.origin[:, :2] - centre, rays.direction
    t = -(o * d[:, :2]).sum(axis=1) / np.maximum((d[:, :2] ** 2).sum(axis=1), 1e-9)
    height = rays.origin[:, 2] + t * d[:, 2]
    return centre, float(np.clip(np.percentile(height, 99.8), 0.01, 2.0))


def _first_profile(rays: OutlineRays, centre: Array, top: float) -> TurnedProfile:
    """The largest surface of revolution within the outlines, but for a small share of them."""
    state = TurnedProfile(np.zeros(0), top, np.array([*centre, 0.0, 0.0]))
    count = int(np.clip(state.top / _STEP_M, _LEAST_HEIGHTS, _MOST_HEIGHTS))
    heights = np.linspace(0, state.top, count)
    T = state.T_world_axis.inverse()
    o, d = T @ rays.origin, rays.direction @ T.R.T
    steep = np.where(np.abs(d[:, 2]) < 1e-6, 1e-6, d[:, 2])
    t = (heights[:, None] - o[None, :, 2]) / steep
    radius = np.hypot(o[:, 0] + t * d[:, 0], o[:, 1] + t * d[:, 1])
    low = np.partition(radius, 8, axis=1)[:, 8]
    return TurnedProfile(np.maximum(low, 1e-4), state.top, state.axis)


def _lowest_top(rays: OutlineRays, state: TurnedProfile, sigma: float) -> TurnedProfile:
    """The lowest rim with which the outlines are still explained."""

    limits = RevolveSettings.current()
    far = max(limits.far * sigma, limits.far_px)

    def cost(top: float) -> float:
        count = max(_LEAST_HEIGHTS, round(len(state.radii) * top / state.top))
        cut = np.interp(np.linspace(0, top, count), state.heights, state.radii)
        pixels = ray_gaps(rays, TurnedProfile(cut, top, state.axis)).distance * rays.px_per_m
        return float((pixels > far).mean())

    plateau = cost(state.top)
    low, high = 0.3 * state.top, state.top
    for _ in range(14):
        middle = (low + high) / 2
        if cost(middle) <= plateau + limits.explained:
            high = middle
        else:
            low = middle
    # The rim itself is higher by what was allowed, but for the slope of the rays.
    high = min(high + 0.3 * far / float(np.median(rays.px_per_m)), state.top)
    count = int(np.clip(high / _STEP_M, _LEAST_HEIGHTS, _MOST_HEIGHTS))
    radii = np.interp(np.linspace(0, high, count), state.heights, state.radii)
    return TurnedProfile(radii, high, state.axis)


def _with_cone(state: TurnedProfile) -> TurnedProfile:
    """Higher by a margin that is no part of the object: a rim too low would widen instead."""
    count = len(state.radii)
    extra = max(1, round(_CONE_M * (count - 1) / state.top))
    radii = np.concatenate([state.radii, np.full(extra, state.radii[-1])])
    return replace(state, radii=radii, top=state.top * (len(radii) - 1) / (count - 1))


def _without_cone(rays: OutlineRays, state: TurnedProfile) -> TurnedProfile:
    """Without what rays over the rim leave above it: a cone that closes as steeply as they fall."""
    gap = ray_gaps(rays, state)
    height = state.heights[gap.index]
    fall = -rays.direction[height > state.top - 3 * _CONE_M]
    fall = fall[fall[:, 2] > 0.05]
    if len(fall) < RevolveSettings.current().fewest_over:
        return state
    steepest = float(np.percentile(np.hypot(fall[:, 0], fall[:, 1]) / fall[:, 2], 10))
    slope = np.gradient(state.radii, state.heights)
    # From the rim downwards, as long as it closes.
    closing = (slope < -_CONE * steepest)[::-1]
    if not closing[:3].any():
        return state
    first = int(closing.argmax())
    count = first + int((~closing[first:]).argmax())
    count = min(count, len(state.radii) - _LEAST_HEIGHTS // 2)
    if count <= 0:
        return state
    top = float(state.heights[len(state.radii) - count])
    heights = np.linspace(0, top, len(state.radii) - count)
    return replace(state, radii=np.interp(heights, state.heights, state.radii), top=top)


def _system(rays: OutlineRays, state: TurnedProfile, sigma: float) -> tuple[Array, Array, Array]:
    """Normal equations A x = b of a step in radii, rim and axis; and the weights of the rays."""
    count = len(state.radii)
    gap = ray_gaps(rays, state)
    scale = rays.px_per_m / sigma
    residual = gap.distance * scale
    limit = np.where(residual < 0, rays.within or _HUBER, _HUBER)
    weight = np.minimum(1, limit / np.maximum(np.abs(residual), 1e-9)) * (
        np.abs(residual) < 4 * RevolveSettings.current().outside
    )
    J = np.zeros((len(residual), count + 5))
    rows = np.arange(len(residual))
    J[rows, gap.index] += (1 - gap.share) * gap.slope
    J[rows, gap.index + 1] += gap.share * gap.slope
    for k, small in enumerate((1e-5, 1e-5, 1e-5, 1e-4, 1e-4)):
        ends = []
        for sign in (1, -1):
            if k == 0:
                moved = replace(state, top=state.top + sign * small)
            else:
                axis = state.axis.copy()
                axis[k - 1] += sign * small
                moved = replace(state, axis=axis)
            # The nearest point moves along the ray, which does not change the distance.
            ends.append(gap_at(rays, moved, gap.along[:, None])[0][:, 0])
        J[:, count + k] = (ends[0] - ends[1]) / (2 * small)
    J *= scale[:, None]
    A = (J * weight[:, None]).T @ J
    b = -(J * weight[:, None]).T @ residual
    bend = np.diff(state.radii, 2) / _BEND_M
    stiff = 1 / (1 + (bend / 2) ** 2)
    # A higher rim looks like a wider one: that of a profile that goes on as below it is meant.
    stiff[-_AT_RIM:] = 1
    D = np.zeros((count - 2, count + 5))
    row = np.arange(count - 2)
    D[row, row], D[row, row + 1], D[row, row + 2] = 1, -2, 1
    D /= _BEND_M
    A += (D * stiff[:, None]).T @ D
    b -= (D * stiff[:, None]).T @ bend
    for k in (3, 4):
        A[count + k, count + k] += 1 / _TILT_RAD**2
        b[count + k] -= state.axis[k - 1] / _TILT_RAD**2
    A[np.diag_indices(len(A))] += 1e-6 * np.diag(A) + 1e-9
    return A, b, weight


def _improved(rays: OutlineRays, state: TurnedProfile, sigma: float) -> tuple[TurnedProfile, float]:
    """One step, and the noise of the outline after it."""
    count = len(state.radii)
    A, b, _ = _system(rays, state, sigma)
    step = np.linalg.solve(A, b)
    step[:count] = np.clip(step[:count], -0.004, 0.004)
    step[count] = np.clip(step[count], -0.002, 0.002)
    state = TurnedProfile(
        np.maximum(state.radii + step[:count], 1e-4),
        state.top + float(step[count]),
        state.axis + step[count + 1 :],
    )
    return state, outline_noise(rays, state)


def _settled(rays: OutlineRays, state: TurnedProfile, sigma: float) -> tuple[TurnedProfile, float]:
    """Some steps, and the noise of the outline after them."""
    for _ in range(_ROUNDS):
        state, sigma = _improved(rays, state, sigma)
    return state, sigma


def _deviation(rays: OutlineRays, state: TurnedProfile, sigma: float) -> tuple[Array, Mask]:
    """Standard deviation of the radii, and where outlines touch the surface."""
    A, _, weight = _system(rays, state, sigma)
    count = len(state.radii)
    gap = ray_gaps(rays, state)
    touched = np.zeros(count)
    np.add.at(touched, gap.index, weight)
    near = np.convolve(touched, np.ones(5), mode="same")
    variance = np.diag(np.linalg.inv(A))[:count]
    return np.sqrt(variance), near >= 3
