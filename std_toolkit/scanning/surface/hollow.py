"""The hollow of an open vessel whose plain inside shows no depth: its outside, moved inwards.

Outlines fill a vessel up to its rim and leave a flat cone above it, for rays over the rim fall no
steeper than the photos look. With the thickness of the wall, the inside follows from the outside.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from std_toolkit.arrays import Mask
from std_toolkit.scanning.masks.hull import column_tops
from std_toolkit.scanning.photos.views import Grid, View
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Slope of a surface that may be the cone above the rim, beyond that of the flattest look.
_MARGIN = 1.25
# Voxels over which the top is averaged, and slope that the steps of voxels leave.
_SMOOTH, _STAIRS = 2.0, 0.1
# Width of a handle across, as a share of the opening's radius: below twice this.
_HANDLE = 0.3


@dataclass(frozen=True, kw_only=True)
class HollowSettings(Settings):
    """What is the opening of a vessel."""

    smallest: float = limit(0.08, source=NOT_RECORDED)
    """smallest opening, as a share of the area that the object covers from above"""


def hollowed(
    field: NDArray[np.float32],
    hull: NDArray[np.float32],
    grid: Grid,
    views: list[View],
    wall_m: float,
) -> tuple[NDArray[np.float32], float]:
    """Open a surface at the top, straight down to a wall and a base of a known thickness.

    Args:
        field: (d, h, w) signed distance to the surface, positive outside, z first.
        hull: the same of the visual hull.
        grid: the voxels of both.
        views: photos with poses, z up.
        wall_m: thickness of wall and base, metres.

    Returns:
        The field with the hollow, and the opened share of the volume; 0 without an opening.
    """
    inside = hull < 0
    opening = _opening(inside, _flattest(views))
    if not opening.any():
        return field, 0.0
    within = grid.step * _depth(opening)
    body = _without_handle(inside, _HANDLE * float(within.max()) / grid.step)
    deep = grid.step * _depth(body)
    deep = ndimage.gaussian_filter(deep.astype(np.float32), 0.7) - grid.step / 2
    # Straight up from where the wall ends.
    carved = np.maximum.accumulate(deep - wall_m, axis=0)
    carved = np.minimum(carved, (within - grid.step / 2 - wall_m)[None]).astype(np.float32)
    found = np.maximum(field, carved)
    before = int((field < 0).sum())
    return found, 1 - float((found < 0).sum()) / max(before, 1)


def _depth(body: Mask) -> NDArray[np.float64]:
    """Distance of pixels or voxels of a body from the outside, which the border belongs to."""
    padded = np.asarray(ndimage.distance_transform_edt(np.pad(body, 1)))
    return padded[(slice(1, -1),) * body.ndim]


def _without_handle(inside: Mask, radius: float) -> Mask:
    """What discs of a radius in voxels cover in each level section."""
    across = (1e6, 1.0, 1.0)  # distances within a section alone
    padded = np.pad(inside, ((0, 0), (1, 1), (1, 1)))
    core = ndimage.distance_transform_edt(padded, sampling=across) > radius
    held = ndimage.distance_transform_edt(~core, sampling=across) <= radius
    held &= core.any(axis=(1, 2))[:, None, None]
    return np.asarray(held[:, 1:-1, 1:-1] & inside)


def _flattest(views: list[View]) -> float:
    """Slope of the flattest look at the middle of the object."""
    look = np.stack([v.T_world_cam.R[:, 2] for v in views])
    slope = -look[:, 2] / np.maximum(np.linalg.norm(look[:, :2], axis=1), 1e-6)
    return float(np.clip(np.percentile(slope, 10), 0.1, 2.0))


def _opening(inside: Mask, slope: float) -> Mask:
    """(h, w) columns below the rim: the top of the hull rises no steeper than photos look."""
    index, covers = column_tops(inside)
    top = np.where(covers, index, 0).astype(np.float32)
    weight = ndimage.gaussian_filter(covers.astype(np.float32), _SMOOTH)
    smooth = ndimage.gaussian_filter(top, _SMOOTH) / np.maximum(weight, 1e-3)
    # At the outer edge the weights change, and with them the place that is averaged.
    flat = covers & (np.hypot(*np.gradient(smooth)) <= _MARGIN * slope + _STAIRS)
    labels, count = ndimage.label(flat)
    if count == 0:
        return flat
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    areas[0] = 0
    # The rim is above a handle, and above the foot of a bowl.
    heights = ndimage.maximum(smooth, labels, np.arange(count + 1))
    large = areas >= HollowSettings.current().smallest * covers.sum()
    if not large.any():
        return np.zeros_like(flat)
    chosen = int(np.argmax(np.where(large, heights, -1)))
    # The average spreads where the top falls off, at the rim and beside a handle.
    found = labels == chosen
    level = float(np.percentile(top[found], 2)) - 1
    mask = covers & (top >= level)
    found = ndimage.binary_dilation(found, iterations=round(3 * _SMOOTH), mask=mask)
    return np.asarray(ndimage.binary_fill_holes(found))
