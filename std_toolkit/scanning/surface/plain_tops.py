"""Plain tops without depth, such as lids: level with what surrounds them, not a cone of the hull.

Rays over a rim fall no steeper than the photos look, so the hull has a flat cone above every top.
Depth maps cut it, but not where the top is too plain to be matched. There the surface is spanned
between the parts around it that are measured, unless an outline shows that the top is higher.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from std_toolkit.arrays import Floats, Mask
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning.masks.hull import column_tops, surface_of
from std_toolkit.scanning.masks.masks import covered, eroded
from std_toolkit.scanning.photos.views import Grid, View, in_threads
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Voxels of the change beside a surface that is sure.
_EDGE = 3
# Photos that judge a lower top.
_PHOTOS = 16


@dataclass(frozen=True, kw_only=True)
class PlainTopSettings(Settings):
    """Which plain tops are level with what surrounds them."""

    sure: float = limit(4.0, source=NOT_RECORDED)
    """weight of the depth measurements of a surface that is sure"""
    enclosed: float = limit(0.95, source=NOT_RECORDED)
    """share of the columns around a top that must be sure"""
    smallest: float = limit(0.005, source=NOT_RECORDED)
    """smallest top, as a share of the area that the object covers from above"""
    lost: float = limit(0.02, source=NOT_RECORDED)
    """share of its pixels that outlines may lose by a lower top"""


def levelled(
    field: Floats,
    support: Floats,
    grid: Grid,
    views: Sequence[View],
    *,
    threads: int = 1,
) -> Floats:
    """A surface whose plain tops are spanned between what is measured around them.

    Args:
        field: (d, h, w) signed distance to the surface, positive outside, z first.
        support: the same shape, weight of the depth measurements.
        grid: the voxels of both.
        views: photos with masks, z up.
        threads: number of threads.

    Returns:
        The field, lower where no outline contradicts.
    """
    limits = PlainTopSettings.current()
    top, sure = _tops(field, support)
    covers = top >= 0
    labels, count = ndimage.label(covers & ~sure)
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    height = np.arange(field.shape[0], dtype=np.float32)[:, None, None]
    for n in range(1, count + 1):
        if areas[n] < limits.smallest * covers.sum():
            continue
        # Depth that is only just sure, at the edge, still bulges towards the hull.
        region = ndimage.binary_dilation(labels == n, iterations=_EDGE, mask=covers)
        around = ndimage.binary_dilation(region) & ~region
        if (sure & covers)[around].mean() < limits.enclosed:
            continue
        level = np.where(region, np.minimum(top, _spanned(top, region)), np.inf)
        above = ((height - level) * grid.step).astype(np.float32)
        lower = np.where(region, np.maximum(field, above), field)
        if _explained(field, lower, grid, views, threads):
            field = lower
    return field


def _tops(field: Floats, support: Floats) -> tuple[Floats, Mask]:
    """(h, w) height of the surface in voxels, -1 for none, and where it is measured."""
    limits = PlainTopSettings.current()
    depth = len(field)
    index, covers = column_tops(field < 0)
    upper = np.minimum(index + 1, depth - 1)
    a = np.take_along_axis(field, index[None], 0)[0]
    b = np.take_along_axis(field, upper[None], 0)[0]
    top = index + np.clip(-a / np.maximum(b - a, 1e-9), 0, 1)
    weight = np.max(
        [
            np.take_along_axis(support, np.clip(index + k, 0, depth - 1)[None], 0)[0]
            for k in range(-2, 3)
        ],
        axis=0,
    )
    return np.where(covers, top, -1).astype(np.float32), covers & (weight >= limits.sure)


def _spanned(top: Floats, region: Mask) -> Floats:
    """Heights of the harmonic surface over a region that meets those around it."""
    number = np.full(np.add(region.shape, 2), -1)
    inner = number[1:-1, 1:-1]
    inner[region] = np.arange(region.sum())
    padded = np.pad(top, 1)
    y, x = np.nonzero(region)
    rows, columns, right = [], [], np.zeros(len(y))
    degree = np.zeros(len(y))
    for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        other, value = number[y + 1 + dy, x + 1 + dx], padded[y + 1 + dy, x + 1 + dx]
        free = other >= 0
        rows.append(np.flatnonzero(free))
        columns.append(other[free])
        # Beside the object there is nothing to meet.
        known = ~free & (value > 0)
        right += np.where(known, value, 0)
        degree += free | known
    own = np.arange(len(y))
    pairs = np.concatenate(rows), np.concatenate(columns)
    A = coo_matrix((np.full(len(pairs[0]), -1.0), pairs), shape=(len(y), len(y))).tocsr()
    A += coo_matrix((degree, (own, own)), shape=A.shape).tocsr()
    out = top.copy()
    out[region] = spsolve(A.tocsc(), right)
    return out


def _explained(
    before: Floats,
    after: Floats,
    grid: Grid,
    views: Sequence[View],
    threads: int,
) -> bool:
    """Whether the outlines still show no more than the surface."""
    casters = [RayCaster(*surface_of(f, grid), threads=1) for f in (before, after)]
    changed = np.argwhere((before < 0) & (after >= 0))
    if not len(changed):
        return False
    points = grid.points(changed[:: max(1, len(changed) // 20_000)])

    def one(view: View) -> tuple[int, int]:
        was, still = (covered(view, caster) for caster in casters)
        uv, _ = view.project(points)
        x, y = np.rint(np.nan_to_num(uv, nan=-9)).astype(int).T
        ok = (x >= 0) & (y >= 0) & (x < was.shape[1]) & (y < was.shape[0])
        drawn = np.zeros(was.shape, bool)
        drawn[y[ok], x[ok]] = True
        drawn = ndimage.binary_closing(drawn, iterations=2)
        # A strip of a pixel or two is an error of the mask.
        lost = eroded(view.shown & was & ~still, 1)
        return int(lost.sum()), int(drawn.sum())

    chosen = views[:: max(1, len(views) // _PHOTOS)]
    counts = np.array(in_threads(one, chosen, threads=threads))
    return bool(counts[:, 0].sum() <= PlainTopSettings.current().lost * counts[:, 1].sum())
