"""A rough profile of a clear vessel from where photos differ from the bare table behind it.

Masks of clear glass are full of holes: most of what is seen through a wall looks like the table.
Its outline is not. Light that passes a wall at grazing incidence is bent most, so a line that
differs from the table runs along it, and outside of it nothing differs. The vessel is a solid of
revolution upright on the table, so a height and a radius there have an outline point on the left
and one on the right in each photo. The evidence of all photos together is enough where that of one
photo is not: the profile with most of it is found by dynamic programming.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from std_toolkit.arrays import Array, Floats
from std_toolkit.scanning.photos.views import View

# Heights of the profile and steps of the radius per step of height.
_HEIGHTS, _FINE = 90, 4
# Heights of the profiles by which the axis is looked for first, and its steps in metres: an axis
# that is 2 mm off shows hardly anything of a vessel.
_COARSE_HEIGHTS, _COARSE_M, _COARSE_STEPS = 40, 0.001, (6, 3, 1)
# Changes of the radius per height; steps beyond them, as at the foot of a glass, have a price.
_SLOPES = np.array([-6, -4, -2, -1, 0, 1, 2, 4, 6])
_JUMP, _JUMP_PRICE = 40, 0.6
# Pixels from the outline: what is within it, beside it and farther out.
_WITHIN, _BESIDE, _FAR = 1.5, 3.0, (7.0, 13.0, 20.0, 28.0)
_FAR_WEIGHT = 0.35
# Evidence of an outline point that makes up for the price of another step of height.
_PRICE = 0.12
# Largest deviation from the table that counts, in parts of its width.
_MOST = 2.0


@dataclass(frozen=True, eq=False)
class RoughProfile:
    """An upright axis and a profile.

    Attributes:
        centre: (2,) where the axis meets the table, metres.
        heights: (K,) from 0 to the top, metres.
        radii: (K,) metres.
        evidence: mean over the outline of the difference that its inside has and its outside not,
            in widths of the table's colours; 0 without an object.
    """

    centre: Array
    heights: Array
    radii: Array
    evidence: float


def outline_evidence(deviation: Sequence[Floats]) -> list[Floats]:
    """(H, W) of each photo: how much each pixel differs from the table, NaN for unknown.

    What most pixels around it differ by, too, as where the table shines, is left out.

    Args:
        deviation: of `table_model.deviation`.
    """
    found = []
    for off in deviation:
        known = np.isfinite(off)
        value = np.where(known, np.minimum(off, 2 * _MOST), 0).astype(np.float32)
        h, w = value.shape
        small = cv2.resize(value, (w // 4, h // 4), interpolation=cv2.INTER_AREA)
        usual = cv2.medianBlur((small * 60).astype(np.uint8), 2 * (h // 16) + 1)
        usual = cv2.resize(usual, (w, h), interpolation=cv2.INTER_LINEAR).astype(np.float32) / 60
        found.append(np.where(known, np.clip(value - usual, 0, _MOST), np.nan).astype(np.float32))
    return found


class _Photos:
    """Evidence of the photos, blurred for points beside an outline, and their cameras."""

    def __init__(self, views: Sequence[View], evidence: Sequence[Floats], *, wide: int = 1) -> None:
        self.views = views
        self._wide = wide
        self._near: list[Floats] = []
        self._far: list[Floats] = []
        for value in evidence:
            known = np.isfinite(value).astype(np.float32)
            filled = np.where(known > 0, value, 0).astype(np.float32)
            for kept, size in ((self._near, 4 * wide - 1), (self._far, 7)):
                share = cv2.blur(known, (size, size))
                mean = cv2.blur(filled, (size, size)) / np.maximum(share, 1e-3)
                kept.append(np.where(share > 0.3, mean, np.nan).astype(np.float32))

    def score(self, centre: Array, height: Array, radius: Array, slope: Array) -> Array:
        """Evidence for outline points, the mean over photos and both sides.

        Args:
            centre: (2,) of the axis.
            height, radius, slope: of the profile, any equal shape.
        """
        within, beside = self._wide * _WITHIN, self._wide * _BESIDE
        total, count = np.zeros(height.shape, np.float32), np.zeros(height.shape, np.float32)
        for i, view in enumerate(self.views):
            C, P = view.centre, view.P
            away = C[:2] - centre
            distance, bearing = float(np.hypot(*away)), float(np.arctan2(away[1], away[0]))
            cosine = (radius + slope * (C[2] - height)) / distance
            ok = np.abs(cosine) < 0.98
            angle = np.arccos(np.clip(cosine, -0.98, 0.98))
            for side in (1, -1):
                a = bearing + side * angle
                along = np.cos(a), np.sin(a)
                x, y = centre[0] + radius * along[0], centre[1] + radius * along[1]
                u, v = _projected(P, x, y, height)
                small = 0.001
                du, dv = _projected(
                    P, x + small * slope * along[0], y + small * slope * along[1], height + small
                )
                du, dv = du - u, dv - v
                length = np.maximum(np.hypot(du, dv), 1e-6)
                # Outwards: the axis is on the other side of the outline.
                nu, nv = -side * dv / length, side * du / length
                su, sv = _projected(P, centre[0], centre[1], height)
                flip = np.where(nu * (u - su) + nv * (v - sv) < 0, -1.0, 1.0)
                nu, nv = nu * flip, nv * flip
                inner = _at(self._near[i], u - within * nu, v - within * nv)
                outer = _at(self._near[i], u + beside * nu, v + beside * nv)
                far = [_at(self._far[i], u + k * nu, v + k * nv) for k in _FAR]
                value = inner - outer - _FAR_WEIGHT * np.nansum(far, axis=0)
                good = ok & np.isfinite(value)
                # Far from the sides, the outline runs along rim or base: the same pixels would
                # serve many heights.
                weight = 1 - np.clip(cosine, -1, 1) ** 2
                total += np.where(good, weight * np.clip(value, -1.0, 1.0), 0)
                count += good
        # A place that few photos show before a known table must not win by them alone.
        return np.asarray(total / np.maximum(count, len(self.views)))


def _projected(P: Array, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    w = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
    w = np.where(w > 1e-6, w, np.nan)
    return (
        (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / w,
        (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / w,
    )


def _at(image: Floats, u: Array, v: Array) -> Floats:
    """Values at pixels of any shape; NaN outside."""
    shape = u.shape
    flat = cv2.remap(
        image,
        np.nan_to_num(u, nan=-9).reshape(shape[0], -1).astype(np.float32),
        np.nan_to_num(v, nan=-9).reshape(shape[0], -1).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=float("nan"),
    )
    return np.asarray(flat, np.float32).reshape(shape)


def rough_profile(
    views: Sequence[View],
    evidence: Sequence[Floats],
    centre: Array,
    tallest: float,
    widest: float,
) -> RoughProfile:
    """The upright profile with most evidence.

    Args:
        views: photos with poses.
        evidence: of `outline_evidence`.
        centre: (2,) near which the axis meets the table, metres.
        tallest, widest: limits of height and radius, metres.
    """
    centre = _near_centre(_Photos(views[::2], evidence[::2], wide=2), centre, tallest, widest)
    photos = _Photos(views, evidence)
    found = None
    for reach in (0.012, 0.004):
        found = _best_profile(photos, centre, tallest, widest)
        centre = _best_centre(photos, found, reach)
        widest = min(widest, 1.15 * float(found.radii.max()) + 0.003)
        # Steps of the radius follow those of the height: a low, wide search would be slow.
        tallest = min(tallest, max(1.15 * float(found.heights[-1]) + 0.005, widest))
    assert found is not None
    return _best_profile(photos, centre, tallest, widest)


def _near_centre(photos: _Photos, centre: Array, tallest: float, widest: float) -> Array:
    """The axis with most evidence, each with a coarse profile of its own, to a millimetre."""
    known: dict[tuple[int, int], float] = {}

    def value(at: tuple[int, int]) -> float:
        if at not in known:
            place = np.asarray(centre) + _COARSE_M * np.array(at)
            found = _best_profile(photos, place, tallest, widest, count=_COARSE_HEIGHTS)
            known[at] = (found.evidence - _PRICE) * len(found.heights)
        return known[at]

    best = (0, 0)
    for step in _COARSE_STEPS:
        for _ in range(4):
            around = [
                (best[0] + step * i, best[1] + step * j) for i in (-1, 0, 1) for j in (-1, 0, 1)
            ]
            better = max(around, key=value)
            if value(better) <= value(best):
                break
            best = better
    return np.asarray(np.asarray(centre) + _COARSE_M * np.array(best))


def _best_profile(
    photos: _Photos, centre: Array, tallest: float, widest: float, *, count: int = _HEIGHTS
) -> RoughProfile:
    step = tallest / (count - 1)
    fine = step / _FINE
    heights = np.arange(count) * step
    radii = np.arange(1, max(int(widest / fine), 8)) * fine
    # (slopes, heights, radii)
    shape = (len(_SLOPES), len(heights), len(radii))
    score = np.stack(
        [
            photos.score(
                centre,
                np.broadcast_to(heights[:, None], shape[1:]),
                np.broadcast_to(radii, shape[1:]),
                np.full(shape[1:], s / _FINE),
            )
            for s in _SLOPES
        ]
    )
    score -= _PRICE
    # value[r]: of the best profile from the table to this height that ends at r.
    value = score[:, 0].max(axis=0)
    came = np.zeros((len(heights), len(radii)), np.int64)
    came[0] = -1
    values = [value]
    index = np.arange(len(radii))
    for k in range(1, count):
        best = np.full(len(radii), -np.inf)
        for n, s in enumerate(_SLOPES):
            start = index - s
            ok = (start >= 0) & (start < len(radii))
            at = np.clip(start, 0, len(radii) - 1)
            # The outline of the step counts at both of its ends.
            gain = 0.5 * (score[n, k - 1, at] + score[n, k])
            total = np.where(ok, value[at] + gain, -np.inf)
            better = total > best
            best[better], came[k, better] = total[better], at[better]
        flat = score[len(_SLOPES) // 2, k]
        for s in range(-_JUMP, _JUMP + 1):
            start = index - s
            ok = (start >= 0) & (start < len(radii))
            at = np.clip(start, 0, len(radii) - 1)
            total = np.where(ok, value[at] + np.minimum(flat, 0) - _JUMP_PRICE, -np.inf)
            better = total > best
            best[better], came[k, better] = total[better], at[better]
        value = best
        values.append(value)
    whole = np.array(values)
    top, at = (int(n) for n in np.unravel_index(whole.argmax(), whole.shape))
    path = [at]
    for k in range(top, 0, -1):
        path.append(int(came[k, path[-1]]))
    chosen = np.asarray(radii[np.array(path[::-1])], np.float64)
    return RoughProfile(
        np.asarray(centre, np.float64),
        np.asarray(heights[: top + 1], np.float64),
        chosen,
        float(whole[top, at] / (top + 1)) + _PRICE,
    )


def _best_centre(photos: _Photos, found: RoughProfile, reach: float) -> Array:
    """The axis that gives a profile most evidence, within a reach in metres."""
    slope = np.gradient(found.radii, found.heights) if len(found.heights) > 2 else found.radii * 0
    slope = np.convolve(np.pad(slope, 2, mode="edge"), np.ones(5) / 5, mode="valid")
    height, radius = found.heights[:, None], found.radii[:, None]
    centre = found.centre
    for step in (reach / 2, reach / 4, reach / 8):
        for _ in range(3):
            around = [centre + step * np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            total = [photos.score(c, height, radius, slope[:, None]).sum() for c in around]
            best = int(np.argmax(total))
            if best == 4:
                break
            centre = around[best]
    return np.asarray(centre)
