"""What a texture looks like whatever the light: normalised colours and gradients, and their match.

Exposure and white balance scale and shift each channel, shading varies slowly over a surface and
jumps at its creases and borders. Colours are therefore normalised over the object, compared with
and without their slow part, and pixels near creases and borders are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Smoothing of both images, pixels, and of the slow part, in parts of the object's size.
_SMOOTH_PX, _SLOW = 1.0, 0.1

# Faces that meet at a larger angle form a crease; pixels this near to it are left out.
_CREASE_DEG, _CREASE_PX = 25.0, 2

# Pixels this near to the silhouette are left out.
_BORDER_PX = 3


# Shares of colours, colours without their slow part, and gradients in the agreement. Shading and
# exposure disturb colours most, and gradients least.
_SHARES = (0.15, 0.35, 0.5)

# The same when pictures are aligned.
_SLOW_ALIGN = 0.15


# The channels are smoothed to these sigmas when pictures are aligned, pixels; steps at each.
_ALIGN_PX, _ALIGN_STEPS = (4.0, 2.0, 1.0), 6


@dataclass(frozen=True, kw_only=True)
class TextureContrastSettings(Settings):
    """When a surface has a texture."""

    plain: float = limit(3.0, unit="grey levels", source="noise and baked-in shading")
    """below this contrast a surface is plain"""
    textured: float = limit(8.0, unit="grey levels", source=NOT_RECORDED)
    """above this contrast a texture is clear"""
    strong: float = limit(30.0, unit="grey levels", source="a texture in large letters")
    """contrast of a strong texture"""
    facet_px: int = limit(40, unit="px", source=NOT_RECORDED)
    """smaller parts of the surface between creases are left out"""


def inner_mask(mask: Mask, normal: Array32) -> Mask:
    """(h, w) pixels away from the silhouette and from creases.

    Args:
        mask: (h, w) pixels that show the object.
        normal: (h, w, 3) unit normals.
    """
    inside = _eroded(mask, _BORDER_PX)
    n = np.where(mask[..., None], normal, 0)
    cosine = np.ones(mask.shape, np.float32)
    for axis in (0, 1):
        a, b = (np.take(n, range(s, n.shape[axis] - 1 + s), axis=axis) for s in (0, 1))
        both = np.take(mask, range(n.shape[axis] - 1), axis=axis) & np.take(
            mask, range(1, n.shape[axis]), axis=axis
        )
        c = np.where(both, (a * b).sum(axis=-1), 1)
        pad = [(0, 0), (0, 0)]
        pad[axis] = (0, 1)
        cosine = np.minimum(cosine, np.pad(c, pad, constant_values=1))
    crease = (cosine < np.cos(np.deg2rad(_CREASE_DEG))).astype(np.uint8)
    size = 2 * _CREASE_PX + 1
    crease = np.asarray(cv2.dilate(crease, np.ones((size, size), np.uint8)), dtype=np.uint8)
    return np.asarray(inside & (crease == 0))


def contrast(color: Array32, mask: Mask, size: float) -> float:
    """Standard deviation of the drawn colours without their slow part, grey levels."""
    if mask.sum() < 30:
        return 0.0
    fine = smoothed(color, mask, _SMOOTH_PX) - smoothed(color, mask, _SLOW * size)
    return float(np.sqrt((fine[mask] ** 2).mean()))


def strength(level: float) -> float:
    """0 to 1, how much a view tells about the texture, from its contrast."""
    limits = TextureContrastSettings.current()
    return float(np.clip((level - limits.plain) / (limits.strong - limits.plain), 0, 1))


def clarity(level: float) -> float:
    """0 for a plain surface, 1 for a clear texture, from its contrast."""
    limits = TextureContrastSettings.current()
    return float(np.clip((level - limits.plain) / (limits.textured - limits.plain), 0, 1))


def facets(mask: Mask) -> NDArray[np.int32]:
    """(h, w) numbers of the smooth parts of the surface, which creases divide; 0 for none.

    Light differs from one face of a box to the next, so each is compared by itself.
    """
    count, label, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    number = np.arange(count)
    number[stats[:, cv2.CC_STAT_AREA] < TextureContrastSettings.current().facet_px] = 0
    number[0] = 0
    return np.asarray(number[label], dtype=np.int32)


def agreement(drawn: Array32, taken: Array32, mask: Mask, size: float) -> float:
    """Correlation -1 to 1 of a drawn texture and a photo of it.

    Args:
        drawn, taken: (h, w, 3) RGB on the same pixels.
        mask: (h, w) pixels to compare, see `inner_mask`.
        size: of the object, pixels.
    """
    parts = agreements(drawn, taken, mask, size)
    return float(np.dot(parts, _SHARES)) if parts else 0.0


def agreements(drawn: Array32, taken: Array32, mask: Mask, size: float) -> list[float]:
    """Correlations of the colours of each facet, without their slow part, and of gradients."""
    part = facets(mask)
    mask = part > 0
    if mask.sum() < 30:
        return []
    a, b = (smoothed(x, mask, _SMOOTH_PX) for x in (drawn, taken))
    fine_a, fine_b = (x - smoothed(x, mask, _SLOW * size) for x in (a, b))
    return [
        _correlation(_centred(a, part), _centred(b, part)),
        _correlation(fine_a[mask], fine_b[mask]),
        _correlation(_gradients(a)[mask], _gradients(b)[mask]),
    ]


def _centred(image: Array32, part: NDArray[np.int32]) -> Array32:
    """(N, 3) colours of the pixels of all facets without the mean of their facet."""
    index = part[part > 0]
    values = image[part > 0].astype(np.float64)
    count = np.bincount(index)
    sums = np.stack([np.bincount(index, values[:, c]) for c in range(3)], axis=1)
    means = sums / np.maximum(count, 1)[:, None]
    return np.asarray(values - means[index], dtype=np.float32)


def aligned(drawn: Array32, taken: Array32, mask: Mask, *, limit_px: float) -> Array32:
    """The photo moved so that it fits the drawn texture: by a shift, then an affine map.

    This corrects a pose or a mesh that is a few pixels off. Motions above the limit are given up.

    Args:
        drawn, taken: (h, w, 3) RGB.
        mask: (h, w) pixels that show the texture.
        limit_px: largest shift, and largest motion by the rest of the map, pixels.
    """
    if mask.sum() < 60:
        return taken
    slow = _SLOW_ALIGN * float(max(np.ptp(np.nonzero(mask), axis=1)))
    du, dv = best_shift(drawn, taken, mask, limit_px=limit_px, slow=slow)
    flow = np.array([du, 0, 0, dv, 0, 0])
    basis = _basis(mask)
    found = _affine(drawn, taken, mask, flow, slow, basis)
    rest = found - flow
    if _largest(rest) <= limit_px:
        flow = found
    return _moved(taken, flow, basis)


def best_shift(
    drawn: Array32, taken: Array32, mask: Mask, *, limit_px: float, slow: float
) -> tuple[float, float]:
    """The shift of u and v within the limit at which smoothed pictures agree best, pixels."""
    reach = int(np.ceil(limit_px))
    fine = smoothed(drawn, mask, 2.0) - smoothed(drawn, mask, slow)
    photo = cv2.copyMakeBorder(
        passed(taken, 2.0, slow), reach, reach, reach, reach, cv2.BORDER_REPLICATE
    )
    # Every second pixel: the pictures are smooth.
    small, template = photo[::2, ::2], fine[::2, ::2]
    weight = np.repeat(mask[::2, ::2, None], 3, axis=2).astype(np.float32)
    h, w = template.shape[:2]
    small = small[: h + reach, : w + reach]
    score = cv2.matchTemplate(small, template, cv2.TM_CCOEFF_NORMED, mask=weight)
    score = np.where(np.isfinite(score), score, -1)
    v, u = np.mgrid[: score.shape[0], : score.shape[1]]
    du, dv = 2 * u - reach, 2 * v - reach
    # A slight preference for no shift decides where there is no texture.
    score = score - 0.05 * np.hypot(du, dv) / max(limit_px, 1)
    best = np.unravel_index(int(score.argmax()), score.shape)
    return float(du[best]), float(dv[best])


def _affine(
    drawn: Array32,
    taken: Array32,
    mask: Mask,
    flow: NDArray[np.float64],
    slow: float,
    full: Array32,
) -> NDArray[np.float64]:
    basis = full[mask].astype(np.float64)
    products = (basis[:, :, None] * basis[:, None, :]).reshape(-1, 9)
    pixels = mask.astype(np.uint8)
    flow = flow.copy()
    # Shear and scale move the texture less than shifts do, and noise determines them worse.
    stiff = np.array([0.003, 0.03, 0.03, 0.003, 0.03, 0.03])
    slow_drawn, slow_taken = smoothed(drawn, mask, slow), cv2.GaussianBlur(taken, (0, 0), slow)
    for sigma in _ALIGN_PX:
        a = standardised(smoothed(drawn, mask, sigma) - slow_drawn, mask)[mask]
        photo = cv2.GaussianBlur(taken, (0, 0), sigma) - slow_taken
        for _ in range(_ALIGN_STEPS):
            moved = _moved(photo, flow, full)
            mean, spread = (x[:3, 0] for x in cv2.meanStdDev(moved, mask=pixels))
            scale = 1 / max(float(spread.mean()), 1e-3)
            # Of the moved image in units of its deviation; a constant has no gradient.
            gx, gy = (
                cv2.Sobel(moved, cv2.CV_32F, *axes, ksize=3, scale=scale / 8)[mask]
                for axes in ((1, 0), (0, 1))
            )
            r = a - (moved[mask] - mean.astype(np.float32)) * np.float32(scale)
            weight = 1 / (1 + r * r)
            wx, wy = weight * gx, weight * gy
            # Rows of the Jacobian are the gradient times the basis: its channels are added first.
            xx, xy, yy, rx, ry = (
                np.einsum("nc,nc->n", p, q).astype(np.float64)
                for p, q in ((wx, gx), (wx, gy), (wy, gy), (wx, r), (wy, r))
            )
            A_xx, A_xy, A_yy = ((weights @ products).reshape(3, 3) for weights in (xx, xy, yy))
            A = np.block([[A_xx, A_xy], [A_xy.T, A_yy]])
            A += (np.trace(A) / 6 + 1e-6) * np.diag(stiff)
            step = np.linalg.solve(A, np.concatenate([rx @ basis, ry @ basis]))
            flow = flow + step
            if np.abs(step).max() < 0.1:
                break
    return flow


def passed(image: Array32, sigma: float, slow: float) -> Array32:
    """The image smoothed by a sigma, without what is left of it after much more smoothing."""
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), sigma) - cv2.GaussianBlur(image, (0, 0), slow),
        dtype=np.float32,
    )


def _basis(mask: Mask) -> Array32:
    """(h, w, 3): one, and the position about the middle of the mask in units of its extent."""
    v, u = np.nonzero(mask)
    grid_v, grid_u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    x = (grid_u - u.mean()) / max(float(np.ptp(u)), 1.0)
    y = (grid_v - v.mean()) / max(float(np.ptp(v)), 1.0)
    return np.stack([np.ones(mask.shape), x, y], axis=-1).astype(np.float32)


def _moved(image: Array32, flow: NDArray[np.float64], basis: Array32) -> Array32:
    """The image at positions moved by an affine flow."""
    return sampled(image, np.stack([basis @ flow[:3], basis @ flow[3:]], axis=-1))


def sampled(image: Array32, flow: NDArray[np.floating]) -> Array32:
    """The image at positions moved by a flow (h, w, 2) of u and v, pixels."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    map_u = (u + flow[..., 0]).astype(np.float32)
    map_v = (v + flow[..., 1]).astype(np.float32)
    return np.asarray(
        cv2.remap(image, map_u, map_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


def _largest(flow: NDArray[np.float64]) -> float:
    """Largest motion of a corner of the box."""
    corners = np.array([[1, i, j] for i in (-0.5, 0.5) for j in (-0.5, 0.5)])
    return float(np.hypot(corners @ flow[:3], corners @ flow[3:]).max())


def standardised(image: Array32, mask: Mask) -> Array32:
    """Channels in units of their common standard deviation over the mask, without their means."""
    inside = image[mask]
    centred = image - inside.mean(axis=0)
    return np.asarray(centred / max(float(inside.std(axis=0).mean()), 1e-3), dtype=np.float32)


def _gradients(image: Array32) -> Array32:
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return np.concatenate([gx, gy], axis=-1)


def _correlation(a: Array32, b: Array32) -> float:
    """Correlation over pixels and channels; each channel has its own mean and gain.

    A channel counts by its power in the first image: a channel without texture is noise.
    """
    a, b = (_clipped(x) for x in (a, b))
    power_a, power_b = (a * a).sum(axis=0), (b * b).sum(axis=0)
    if power_a.sum() <= 0:
        return 0.0
    each = (a * b).sum(axis=0) / np.sqrt(np.maximum(power_a * power_b, 1e-9))
    return float((each * power_a).sum() / power_a.sum())


def _clipped(x: Array32) -> Array32:
    """Values about their mean, those beyond 2.5 deviations cut off: highlights are bright."""
    x = x - x.mean(axis=0)
    limit = 2.5 * x.std(axis=0)
    return np.asarray(np.clip(x, -limit, limit), dtype=np.float32)


def _eroded(mask: Mask, px: int) -> Mask:
    padded = np.pad(mask.astype(np.uint8), px)
    small = cv2.erode(padded, np.ones((2 * px + 1, 2 * px + 1), np.uint8))
    return np.asarray(small[px:-px, px:-px] > 0)


def smoothed(image: Array32, mask: Mask, sigma: float) -> Array32:
    """Gaussian means over the pixels of the mask."""
    weight = mask.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), sigma)
    mixed = cv2.GaussianBlur(image * weight[..., None], (0, 0), sigma)
    return np.asarray(mixed / np.maximum(total, 1e-4)[..., None], dtype=np.float32)
