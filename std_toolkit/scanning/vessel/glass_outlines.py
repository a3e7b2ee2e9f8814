"""A clear vessel from unsprayed photos without masks: rough profile, outline points, fit.

Around the outline of the profile so far, each photo is searched for the place where the difference
from the bare table ends. These points are fitted by a surface of revolution, which is the next
profile. What points into the vessel, such as its inner wall, has differences outside of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.log import logger
from std_toolkit.scanning.masks.masks import dilated
from std_toolkit.scanning.masks.table_comparison import deviation
from std_toolkit.scanning.masks.table_model import model_tables
from std_toolkit.scanning.photos.views import View, in_threads
from std_toolkit.scanning.vessel.glass_profile import outline_evidence, rough_profile
from std_toolkit.scanning.vessel.revolve import fit_outline_points
from std_toolkit.scanning.vessel.revolved_surface import OutlineView, RevolvedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Pixels to both sides of the outline that are searched, in each round.
_REACH = (6.0, 2.5)
_RIM_PX = 4.0
_BESIDE_PX = 4
# Steps of a pixel along the search, and points along the outline that are averaged.
_STEP, _TOGETHER = 0.5, 5
# Height of a vessel and its radius, in sizes of the board.
_TALLEST, _WIDEST = 1.3, 0.42
_HINT = (
    "stand it upright; spray it matt and scan it without --revolve, or give outlines of your own "
    "with --masks; a patterned board behind the glass and light without highlights help"
)


@dataclass(frozen=True, kw_only=True)
class GlassOutlineSettings(Settings):
    """When a clear vessel is found."""

    shown: float = limit(0.35, source=NOT_RECORDED)
    """share of an added piece of outline that must show for a higher rim"""
    least: float = limit(0.25, source=NOT_RECORDED)
    """least difference of the inside from the outside of an outline point, in widths of the
    table"""
    faint: float = limit(0.15, source=NOT_RECORDED)
    """smallest evidence of a rough profile"""
    fewest: float = limit(0.35, source=NOT_RECORDED)
    """share of the outline that must show"""
    most_outside: float = limit(0.35, source=NOT_RECORDED)
    """largest share of the outline that the fit leaves out"""


def find_vessel(
    views: Sequence[View], corners: Array, *, threads: int
) -> tuple[RevolvedSurface, list[View]]:
    """The vessel on the board, and the photos with its outline filled as masks.

    Args:
        views: photos with poses, world z up with the table at z = 0.
        corners: (M, 3) corners of the board, world.
        threads: number of threads.

    Raises:
        ToolkitError: the outline is too faint, or that of no surface of revolution.
    """
    tables = model_tables(views, corners)
    off = in_threads(lambda i: deviation(views[i], tables, i), range(len(views)), threads=threads)
    return fit_vessel(views, outline_evidence(off), corners)


def fit_vessel(
    views: Sequence[View],
    evidence: Sequence[Floats],
    corners: Array,
) -> tuple[RevolvedSurface, list[View]]:
    """`find_vessel` from the difference of each photo from the bare table.

    Args:
        views: photos with poses.
        evidence: (H, W) of each photo, of `outline_evidence`.
        corners: (M, 3) corners of the board, world.

    Raises:
        ToolkitError: as `find_vessel`.
    """
    limits = GlassOutlineSettings.current()
    size = float(np.ptp(corners[:, :2], axis=0).max())
    tallest = min(float(np.percentile([v.centre[2] for v in views], 75)), _TALLEST * size)
    centre = _middle(views, evidence, corners)
    rough = rough_profile(views, evidence, centre, tallest, _WIDEST * size)
    logger.info("outline: rough profile of %.0f mm, evidence %.2f", 1000 * rough.heights[-1],
                rough.evidence)  # fmt: skip
    if rough.evidence < limits.faint:
        raise ToolkitError(
            f"the outline of an upright vessel is too faint: it differs from the bare table by "
            f"{rough.evidence:.2f} of the noise",
            field="--revolve",
            hint=_HINT,
        )
    centre = rough.centre
    heights, radii = _with_rim(views, evidence, centre, rough.heights, rough.radii)
    T: SE3 | None = None
    found = None
    for reach in _REACH:
        outlines = [_outline_of(v, centre, heights, radii, T) for v in views]
        points, shown = [], []
        for mask, value in zip(outlines, evidence, strict=True):
            uv, share = _outline_points(mask, value, reach)
            points.append(uv)
            shown.append(share)
        if float(np.mean(shown)) < limits.fewest:
            raise ToolkitError(
                f"{100 * float(np.mean(shown)):.0f} % of the outline of the vessel show in the "
                "photos",
                field="--revolve",
                hint=_HINT,
            )
        given = [
            OutlineView(v.camera, v.T_world_cam, m, v.image)
            for v, m in zip(views, outlines, strict=True)
        ]
        found = fit_outline_points(
            given, points, centre=centre, heights=heights, radii=radii,
            most_outside=limits.most_outside,
        )  # fmt: skip
        T = found.T_world_axis
        centre, heights, radii = T.t[:2], found.heights, found.radii
    assert found is not None
    masks = [_outline_of(v, centre, heights, radii, T) for v in views]
    return found, [v.with_mask(m) for v, m in zip(views, masks, strict=True)]


def _middle(views: Sequence[View], evidence: Sequence[Floats], corners: Array) -> Array:
    """(2,) where on the board most photos differ from it, at some heights above it."""
    low, high = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    x, y, z = np.meshgrid(
        np.arange(low[0], high[0], 0.004), np.arange(low[1], high[1], 0.004),
        [0.01, 0.02, 0.035, 0.05], indexing="ij",
    )  # fmt: skip
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    total = np.zeros(len(points))
    for view, value in zip(views, evidence, strict=True):
        blurred = cv2.GaussianBlur(np.nan_to_num(value), (0, 0), 5)
        at = np.nan_to_num(view.project(points)[0], nan=-9).astype(np.float32)[None]
        total += cv2.remap(blurred, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0]
    score = total.reshape(x.shape).sum(axis=2)
    weight = np.where(score > 0.7 * score.max(), score, 0)
    grid = np.stack([x[..., 0], y[..., 0]], axis=-1)
    return np.asarray((weight[..., None] * grid).sum(axis=(0, 1)) / weight.sum())


def _with_rim(
    views: Sequence[View],
    evidence: Sequence[Floats],
    centre: Array,
    heights: Array,
    radii: Array,
) -> tuple[Array, Array]:
    """Heights and radii up to the rim.

    The far side of the rim looks like the sides of a cone above the vessel, but in few photos: the
    height that adds most of an outline that shows in all photos, and leaves least that differs from
    the table outside, is taken.
    """
    limits = GlassOutlineSettings.current()
    few = [(v, e) for v, e in zip(views, evidence, strict=True)][:: max(1, len(views) // 16)]
    strong = [
        dilated(_outline_of(v, centre, heights, radii, None), _BESIDE_PX) & (e > 2 * limits.least)
        for v, e in few
    ]
    best, most = len(heights), -np.inf
    for step in (8, 4, 2, 1):
        tried = range(len(heights) // 3, len(heights) + 1, 8) if step == 8 else (
            best - step, best + step
        )  # fmt: skip
        for top in tried:
            if not 8 <= top <= len(heights):
                continue
            total = 0.0
            for (view, value), different in zip(few, strong, strict=True):
                outline = _outline_of(view, centre, heights[:top], radii[:top], None)
                total -= 0.5 * float((different & ~dilated(outline, _BESIDE_PX)).sum())
                uv, share = _outline_points(outline, value, _RIM_PX)
                total += len(uv) * (1 - limits.shown / max(share, 0.05))
            if total > most:
                best, most = top, total
    return heights[:best], radii[:best]


def _outline_of(view: View, centre: Array, heights: Array, radii: Array, T: SE3 | None) -> Mask:
    """Pixels that a solid of revolution covers: frusta are convex, and so are their images."""
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    chosen = np.unique(np.linspace(0, len(heights) - 1, 140).astype(int))
    points = np.concatenate(
        [
            radii[chosen][:, None, None] * ring,
            np.broadcast_to(heights[chosen][:, None, None], (len(chosen), 96, 1)),
        ],
        axis=2,
    ).reshape(-1, 3)
    world = points + np.array([*centre, 0.0]) if T is None else T @ points
    uv, _ = view.project(world)
    mask = np.zeros(view.image.shape[:2], np.uint8)
    if not np.isfinite(uv).all():
        return mask > 0
    fixed = np.rint(uv.reshape(len(chosen), 96, 2) * 16).astype(np.int32)
    for lower, upper in pairwise(fixed):
        hull = cv2.convexHull(np.concatenate([lower, upper]))
        cv2.fillConvexPoly(mask, hull, 1, shift=4)
    return mask > 0


def _outline_points(mask: Mask, evidence: Floats, reach: float) -> tuple[Array, float]:
    """Pixels (N, 2) where the difference ends near an outline, and the share of it that shows."""
    lines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not lines:
        return np.zeros((0, 2)), 0.0
    line = max(lines, key=len)[:, 0].astype(np.float64)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 3)
    gx, gy = cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)
    x, y = line.astype(int).T
    normal = -np.stack([gx[y, x], gy[y, x]], axis=1).astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    # The outermost pixels of the mask lie half a pixel within the outline.
    line = line + 0.5 * normal
    inward, outward = 4.0, 20.0
    along = np.arange(-reach - inward, reach + outward + _STEP, _STEP)
    place = (line[:, None] + along[:, None] * normal[:, None]).astype(np.float32)
    value = cv2.remap(
        evidence, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderValue=float("nan")
    )
    known = np.isfinite(value)
    value = np.where(known, value, 0)
    kernel = np.ones((_TOGETHER, 1), np.float32)
    value = cv2.filter2D(value, -1, kernel / _TOGETHER, borderType=cv2.BORDER_REFLECT)
    sums = np.concatenate([np.zeros((len(value), 1)), np.cumsum(value, axis=1)], axis=1)

    def mean(at: NDArray[np.intp], start: float, stop: float) -> Array:
        a = at + round(start / _STEP)
        b = at + round(stop / _STEP)
        return np.asarray((sums[:, b] - sums[:, a]) / (round((stop - start) / _STEP)))

    at = np.arange(round(inward / _STEP), round((inward + 2 * reach) / _STEP) + 1)
    score = mean(at, -3.0, 0.0) - mean(at, 0.5, 3.5) - mean(at, 3.5, 19.5)
    best = score.argmax(axis=1)
    rows = np.arange(len(line))
    good = (score[rows, best] > GlassOutlineSettings.current().least) & known[rows, at[best]]
    # Half of the peak within is where the image of the border lies.
    index = at[best]
    peak = np.max([value[rows, np.maximum(index - k, 0)] for k in range(7)], axis=0)
    edge = np.full(len(line), np.nan)
    for k in range(-6, 7):
        i = np.clip(index - k, 1, value.shape[1] - 1)
        a, b = value[rows, i - 1], value[rows, i]
        crosses = (a >= peak / 2) & (b < peak / 2) & np.isnan(edge)
        share = (a - peak / 2) / np.maximum(a - b, 1e-6)
        edge = np.where(crosses, along[i - 1] + share * _STEP, edge)
    good &= np.isfinite(edge)
    # Where no table is known behind the outline, nothing tells whether it shows.
    before = known[:, np.searchsorted(along, 0.0)]
    share = float(good.sum() / max(before.sum(), 1))
    return np.asarray(line + edge[:, None] * normal, np.float64)[good], share
