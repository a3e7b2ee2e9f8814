"""Rays through the outline of an object, and their distance from a surface of revolution.

In the half-plane of height and radius, a ray is a hyperbola; its distance is that of the sample
which is nearest to the profile.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scanning.vessel.revolved_surface import OutlineView
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Rays that are used, and samples along each.
_MOST_RAYS, _SAMPLES = 4000, 97


@dataclass(frozen=True, kw_only=True)
class OutlineRaySettings(Settings):
    """What a surface of revolution needs."""

    fewest_views: int = limit(4, source=NOT_RECORDED)
    """photos that show the outline"""


@dataclass(frozen=True, eq=False)
class OutlineRays:
    """Rays through outlines.

    Attributes:
        origin: (N, 3) metres, world.
        direction: (N, 3) unit vectors.
        px_per_m: (N,) pixels per metre at their nearest point.
        within: deviations from which rays that enter the surface count less; None as of the others.
    """

    origin: Array
    direction: Array
    px_per_m: Array
    within: float | None = None


@dataclass(frozen=True, eq=False)
class TurnedProfile:
    """Radii at equal steps of height; height of the rim; axis: x, y at the table, two tilts."""

    radii: Array
    top: float
    axis: Array

    @property
    def heights(self) -> Array:
        return np.linspace(0.0, self.top, len(self.radii))

    @property
    def T_world_axis(self) -> SE3:
        x, y, a, b = self.axis
        return SE3(so3_exp(np.array([a, b, 0.0])), np.array([x, y, 0.0]))


@dataclass(frozen=True, eq=False)
class RayGaps:
    """Of each ray: signed distance from the surface, and where: lower height, weight of the next.

    Attributes:
        distance: (N,) metres, negative where the ray enters the surface.
        index: (N,) number of the height below the nearest point.
        share: (N,) weight of the height above it.
        slope: (N,) derivative of the distance by a radius at that height.
        along: (N,) where along the ray, metres.
    """

    distance: Array
    index: NDArray[np.int64]
    share: Array
    slope: Array
    along: Array


def outline_rays(views: Sequence[OutlineView], points: Sequence[Array]) -> OutlineRays:
    """Rays through points of the outline, at most about `_MOST_RAYS`, in equal parts of the photos.

    Args:
        views: photos.
        points: (N, 2) pixels of the outline in each.

    Raises:
        ToolkitError: fewer than four photos show enough of the outline.
    """
    limits = OutlineRaySettings.current()
    rng = np.random.default_rng(0)
    origins, directions, scales = [], [], []
    each = max(100, _MOST_RAYS // max(len(views), 1))
    for view, uv in zip(views, points, strict=True):
        if len(uv) < 20:
            continue
        if len(uv) > each:
            uv = uv[np.sort(rng.choice(len(uv), each, replace=False))]
        d = view.camera.unproject(uv)
        length = np.linalg.norm(d, axis=1)
        origins.append(np.broadcast_to(view.T_world_cam.t, d.shape))
        directions.append((d / length[:, None]) @ view.T_world_cam.R.T)
        scales.append(np.sqrt(view.camera.fx * view.camera.fy) / length)
    if len(origins) < limits.fewest_views:
        raise ToolkitError(
            f"{len(origins)} photos show the outline of the object, "
            f"{limits.fewest_views} are needed",
            hint="photograph it from all sides and from two heights",
        )
    origin, direction = np.concatenate(origins), np.concatenate(directions)
    return OutlineRays(origin, direction, np.concatenate(scales) / np.linalg.norm(origin, axis=1))


def mask_outline(mask: NDArray[np.bool_]) -> Array:
    """(N, 2) points half way between pixels of the mask and their neighbours outside it."""
    parts = []
    for axis in (0, 1):
        first, second = (mask[:-1], mask[1:]) if axis == 0 else (mask[:, :-1], mask[:, 1:])
        row, column = np.nonzero(first != second)
        half = (0.0, 0.5) if axis == 0 else (0.5, 0.0)
        parts.append(np.stack([column, row], axis=1) + half)
    return np.concatenate(parts)


def _samples(rays: OutlineRays, state: TurnedProfile) -> Array:
    """(N, S) distances along the rays, near the axis."""
    T = state.T_world_axis.inverse()
    o, d = T @ rays.origin, rays.direction @ T.R.T
    flat = np.maximum((d[:, :2] ** 2).sum(axis=1), 1e-9)
    nearest = -(o[:, :2] * d[:, :2]).sum(axis=1) / flat
    reach = 1.2 * max(float(state.radii.max(initial=0.0)), 0.25 * state.top, 0.02)
    return np.asarray(
        nearest[:, None] + np.linspace(-1, 1, _SAMPLES) * (reach / np.sqrt(flat))[:, None]
    )


def gap_at(
    rays: OutlineRays, state: TurnedProfile, along: Array
) -> tuple[Array, NDArray[np.int64], Array, Array]:
    """Signed distances (N, S) of points along the rays; index, share and slope as in `RayGaps`."""
    T = state.T_world_axis.inverse()
    o, d = T @ rays.origin, rays.direction @ T.R.T
    x, y, height = (o[:, k : k + 1] + along * d[:, k : k + 1] for k in range(3))
    radius = np.sqrt(x * x + y * y)
    count = len(state.radii)
    step = state.top / (count - 1)
    place = np.clip(height / step, 0, count - 1.000001)
    index = place.astype(np.int64)
    share = place - index
    wall = (1 - share) * state.radii[index] + share * state.radii[index + 1]
    # Distance along the normal of the profile; steeper than 4:1 is a disc seen from above.
    cosine = 1 / np.sqrt(1 + np.clip(np.gradient(state.radii, step), -4, 4) ** 2)
    factor = (1 - share) * cosine[index] + share * cosine[index + 1]
    gap = (radius - wall) * factor
    slope = -factor
    beyond = np.maximum(height - state.top, -height)
    outside = beyond > 0
    over = np.maximum(radius[outside] - wall[outside], 0)
    corner = np.sqrt(over**2 + beyond[outside] ** 2)
    gap[outside] = corner
    slope[outside] = -over / np.maximum(corner, 1e-9)
    return gap, index, share, slope


def ray_gaps(rays: OutlineRays, state: TurnedProfile) -> RayGaps:
    """Where each ray is nearest to the surface, and how near."""
    along = _samples(rays, state)
    gap, index, share, slope = gap_at(rays, state, along)
    at = (np.arange(len(gap)), gap.argmin(axis=1))
    return RayGaps(gap[at], index[at], share[at], slope[at], along[at])


def outline_noise(rays: OutlineRays, state: TurnedProfile) -> float:
    """Robust standard deviation of the outline, pixels, at least that of whole pixels."""
    pixels = ray_gaps(rays, state).distance * rays.px_per_m
    return max(1.4826 * float(np.median(np.abs(pixels - np.median(pixels)))), 0.29)
