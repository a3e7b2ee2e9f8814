"""Depth of glass and metal, fused from all views of a scene.

Where the mask of a view shows glass or metal, two sources answer along every ray. The visual hull
says that nothing is nearer than its front, and is right where the object is convex and seen from
around. The answers of all views that look at the point are their mean, weighted by 1 / spread^2.
Both are weighted by their variances: that of the answers grows where other views contradict them,
that of the hull where the answers lie farther behind it than they are expected to be off, as
inside of a bowl.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmark.metrics.depth.figures import tolerance
from benchmark.restoring.visual_hull import Entry, Hull, PosedView, hull_of
from std_toolkit.arrays import Floats, Mask
from std_toolkit.compiled import compiled
from std_toolkit.geometry.camera import pixel_rays
from std_toolkit.settings import Settings, limit

_TRIED = "ray-cast bottle, tumbler and bowl, 12 to 18 views, answers off by 10 to 45 mm"


@dataclass(frozen=True, kw_only=True)
class FusionSettings(Settings):
    """How the answers of views and the hull are weighted."""

    most_views: int = limit(48, source="every 8 degrees around a table")
    """views whose answers and masks are used, evenly chosen; all frames are written"""
    alike: float = limit(0.8, source="a network errs alike in all views of a glass")
    """correlation of the errors of a method in different views"""
    near_deg: float = limit(40.0, unit="deg", source=_TRIED)
    """answers of views that look along the ray of a pixel to within this angle are averaged"""
    rim_px: float = limit(3.0, unit="px", source="masks of networks are off by 1 to 3 px")
    """this near to the border of a mask, an answer that is far off the hull stands beside glass"""
    hull_share: float = limit(0.15, source="9 to 14 mm on a bottle of 70 mm, 6 to 18 true masks")
    """expected error of the hull from around, as a share of its thickness"""
    doubted: float = limit(1.2, source=_TRIED)
    """the hull is doubted where answers lie behind it by more than this times their variance"""


@dataclass(frozen=True, eq=False)
class Fused:
    """Depth of a view after the fusion.

    Attributes:
        depth: (H, W) float32 metres.
        spread: (H, W) float32 metres, its expected error.
        fused: (H, W) pixels of glass or metal that have the answer of all views.
    """

    depth: Floats
    spread: Floats
    fused: Mask


@dataclass(frozen=True, eq=False)
class _Surface:
    """The answers of a view within the hull: maps (H, W), 0 where there is none."""

    view: PosedView
    depth: Floats
    variance: Floats
    pixels: Mask
    entry: Entry


class ViewFusion:
    """The views of a scene as one surface.

    Args:
        views: of a static scene; those that `hull_of` finds to be wrong are left out.
    """

    def __init__(self, views: Sequence[PosedView]) -> None:
        self.hull = hull_of(views) if len(views) > 1 else None
        self._surfaces: list[_Surface] = []
        if self.hull is not None:
            used = [v for v, counts in zip(views, self.hull.counted, strict=True) if counts]
            self._surfaces = [_surface(view, self.hull) for view in used]

    def fuse(self, view: PosedView) -> Fused:
        """The depth of a view: only pixels of its mask that the hull covers change, and of these
        none whose depth is the sensor's own.

        Args:
            view: any view of the scene; others that have its name do not count twice.
        """
        depth, spread = view.depth.copy(), view.spread.copy()
        if self.hull is None or not view.mask.any():
            return Fused(depth, spread, np.zeros(depth.shape, bool))
        own = _surface(view, self.hull)
        answer, variance = self._mean(own)
        z, variance = _with_hull(own, answer, variance, self.hull)
        # A mask may be wrong about an opaque object, and the hull about what stands beside glass.
        changed = own.pixels & ~view.kept
        moved = ~view.kept[own.pixels]
        depth[changed], spread[changed] = z[moved], np.sqrt(variance[moved])
        return Fused(depth, spread, changed)

    def _mean(self, own: _Surface) -> tuple[Floats, Floats]:
        """The mean of the answers of all views at the pixels of one, and its variance."""
        settings = FusionSettings.current()
        z, variance = own.depth[own.pixels], own.variance[own.pixels]
        pose = own.view.T_world_cam
        points = pose @ (pixel_rays(own.view.camera)[own.pixels] * z[:, None])
        sums = np.zeros((len(z), 5))
        sums[:, 0], sums[:, 2] = 1 / variance, 1
        nearest = float(np.cos(np.deg2rad(settings.near_deg)))
        for other in self._surfaces:
            if other.view.name == own.view.name:
                continue
            T = other.view.T_world_cam.inverse()
            centres = np.stack([pose.t, other.view.T_world_cam.t])
            K = other.view.intrinsics
            _compare(
                points, variance, centres, T.R, T.t, K, other.depth, other.variance, nearest, sums
            )
        weight, shift, count, against, seeing = sums.T
        mean = z + shift / weight
        alone = count / weight  # mean variance of one answer
        found = settings.alike * alone + (1 - settings.alike) / weight
        # Half of what is seen lies before it: 1 where answers are as far off as is expected.
        contradicted = np.maximum(1, 2 * against / np.maximum(seeing, 1))
        return mean.astype(np.float32), (found * contradicted).astype(np.float32)


def _surface(view: PosedView, hull: Hull) -> _Surface:
    """The answers of a view; those before or behind the hull are off by what they are outside."""
    pixels = view.mask.copy()
    entry = hull.entry(view, pixels)
    given, spread = view.depth[pixels], view.spread[pixels]
    spread = np.maximum(spread, tolerance(given).astype(np.float32))
    # What is surely there stands beside the object, or before it: the mask is wrong.
    rim = cv2.distanceTransform(pixels.astype(np.uint8), cv2.DIST_L2, 3)[pixels]
    beside = (rim <= FusionSettings.current().rim_px) & (given > entry.back + 3 * spread)
    before = view.kept[pixels] & (given < entry.front - 3 * spread)
    wrong = (given > 0) & (beside | before)
    met = (entry.front > 0) & ~wrong
    pixels[pixels] = met
    front, back, across = (values[met] for values in (entry.front, entry.back, entry.across))
    given, spread = given[met], spread[met]
    answered = given > 0
    z = np.clip(np.where(answered, given, front), front, back)
    variance = np.where(answered, spread**2 + (given - z) ** 2, (back - front) ** 2 + across**2)
    depth_map, variance_map = (np.zeros(pixels.shape, np.float32) for _ in range(2))
    depth_map[pixels], variance_map[pixels] = np.where(answered, given, front), variance
    return _Surface(view, depth_map, variance_map, pixels, Entry(front, back, across))


def _with_hull(
    own: _Surface, answer: Floats, variance: Floats, hull: Hull
) -> tuple[Floats, Floats]:
    """The answers of the views and the front of the hull, weighted by their variances."""
    settings = FusionSettings.current()
    front, across = own.entry.front, own.entry.across
    answer = np.clip(answer, front, own.entry.back)
    share = settings.hull_share + (1 - hull.around) / 2
    grain = hull.grid.edge + front / own.view.camera.fx
    behind = _around_mean((answer - front) ** 2, own)
    surprise = behind / (settings.doubted * _around_mean(variance, own))
    of_hull = (share * across) ** 2 + grain**2
    of_hull = of_hull + behind * surprise * np.maximum(surprise - 1, 0)
    weights = 1 / variance + 1 / of_hull
    z = (answer / variance + front / of_hull) / weights
    return z.astype(np.float32), (1 / weights).astype(np.float32)


def _around_mean(values: Floats, own: _Surface) -> Floats:
    """Means over the pixels of the surface around each, about a twentieth of the image wide."""
    full, there = np.zeros(own.pixels.shape, np.float32), own.pixels.astype(np.float32)
    full[own.pixels] = values
    size = (2 * (own.view.camera.width // 40) + 1,) * 2
    summed, counted = (cv2.blur(m, size, borderType=cv2.BORDER_CONSTANT) for m in (full, there))
    return np.asarray(summed[own.pixels] / counted[own.pixels], np.float32)


def _compare_code(
    points: Any, variances: Any, centres: Any, R: Any, t: Any, K: Any,
    depth: Any, variance: Any, nearest: Any, sums: Any,
) -> None:  # fmt: skip
    """Compare the points of one view (N, 3) with the answers (H, W) of another.

    To the rows of `sums` are added: weights and weighted distances of answers along nearly the
    same ray, their number; squares of distances in front of the other's answer, by their variance,
    and the number of points that the other sees.
    """
    height, width = depth.shape
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        zc = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        if zc < 0.01:
            continue
        xc = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        yc = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        u = int(np.floor(K[0] * xc / zc + K[2] + 0.5))
        v = int(np.floor(K[1] * yc / zc + K[3] + 0.5))
        if not (0 <= u < width and 0 <= v < height) or variance[v, u] <= 0:
            continue
        behind = depth[v, u] - zc
        both = variances[n] + variance[v, u]
        square = behind * behind / both
        if behind < 0 and square > 9:
            continue  # hidden by what the other sees
        sums[n, 4] += 1
        if behind > 0:
            sums[n, 3] += min(square, 25.0)
        ax, ay, az = x - centres[0, 0], y - centres[0, 1], z - centres[0, 2]
        bx, by, bz = x - centres[1, 0], y - centres[1, 1], z - centres[1, 2]
        lengths = np.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))
        if square <= 4 and ax * bx + ay * by + az * bz >= nearest * lengths:
            sums[n, 0] += 1 / variance[v, u]
            sums[n, 1] += behind / variance[v, u]
            sums[n, 2] += 1


_compare = compiled(_compare_code, error_model="numpy")
