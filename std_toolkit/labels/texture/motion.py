"""Where the texture of a mesh puts an object: a motion in six degrees of freedom, from all views.

The textured mesh is drawn at the label. In each view the picture is moved by a few pixels to where
it agrees best with the photo, and the motion that explains these shifts is the start. From there
all views are solved together: the motion of the object moves every pixel of the drawn texture, and
Gauss-Newton steps on the difference of the pictures find the one common motion (direct alignment,
B. D. Lucas and T. Kanade, "An iterative image registration technique", 1981).

A motion is a vector (6,): translation of the object's centre in metres, and rotation vector about
the centre in radians, both along the axes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.geometry import SE3
from std_toolkit.geometry.se3 import so3_exp, so3_log
from std_toolkit.labels.refine.problem import RefineObject
from std_toolkit.labels.texture.features import (
    Array32,
    agreement,
    best_shift,
    inner_mask,
    passed,
    sampled,
    smoothed,
    standardised,
)
from std_toolkit.labels.texture.scores import TextureWindow
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Weak expectation of a motion: metres and radians.
_PRIOR = np.array([0.05] * 3 + [0.3] * 3)
# Smoothing of both pictures, pixels; steps at each; drawings of the mesh in the course of them.
_SIGMAS_PX, _STEPS, _ROUNDS = (3.0, 1.5, 1.0), 6, 2
# The slow part of the colours, in parts of the longer side of the object.
_SLOW = 0.15
# Shifts and residuals of neighbouring pixels have one error in common.
_ALIKE_PX = 24.0


@dataclass(frozen=True, kw_only=True)
class TextureMotionSettings(Settings):
    """When a texture says where an object is, and how exactly."""

    reach: float = limit(0.12, source="faults of 15 mm on objects of 120 mm")
    """largest shift that is searched, in parts of the object's longer side"""
    fewest_views: int = limit(2, source="one view leaves the distance open")
    """views that a motion needs"""
    fewest_px: int = limit(150, unit="px", source=NOT_RECORDED)
    """pixels of texture that a view needs"""
    agreement: float = limit(0.35, source=NOT_RECORDED)
    """smallest correlation of texture and photos after the motion"""
    smallest_px: float = limit(0.25, unit="px", source=NOT_RECORDED)
    """smallest standard deviation of the place of a texture in one view"""
    placed_m: float = limit(
        0.0005, unit="m", source="the texture of a mesh is shifted on its sides"
    )
    """standard deviation of the place of the texture on the mesh"""


@dataclass(frozen=True, eq=False)
class TextureMotion:
    """A motion with its uncertainty.

    Attributes:
        vector: (6,), see the module.
        covariance: (6, 6).
        agreement: correlation of texture and photos after the motion, mean over the views.
        frames: ids of the views that were used.
    """

    vector: Array
    covariance: Array
    agreement: float
    frames: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Drawing:
    """The texture drawn at a pose in one window.

    Attributes:
        window: of the photo.
        color: (h, w, 3) drawn colours.
        mask: (h, w) pixels to compare.
        jacobian: (h, w, 2, 6) motion of each pixel by the motion of the object.
    """

    window: TextureWindow
    color: Array32
    mask: NDArray[np.bool_]
    jacobian: Array32


def texture_motion(
    windows: Sequence[tuple[int, TextureWindow]],
    surface: TexturedSurface,
    obj: RefineObject,
    *,
    free: Array | None = None,
) -> TextureMotion | None:
    """The motion of an object from its pose to where its texture agrees with the photos.

    Args:
        windows: frame ids and the parts of the photos around the object.
        surface: the mesh with its colours.
        obj: the object at its label.
        free: (N, 6) motions that its symmetry leaves open.

    Returns:
        None where the texture does not say.
    """
    limits = TextureMotionSettings.current()
    centre = obj.T_world_obj @ obj.centre
    prior = np.diag(1 / _PRIOR**2)
    for row in np.zeros((0, 6)) if free is None else free:
        prior += np.outer(row, row) / 1e-12
    T = obj.T_world_obj
    drawn = _draw(windows, surface, T, centre)
    if len(drawn) < limits.fewest_views:
        return None
    xi = _by_shifts(drawn, prior, limits.reach)
    for k in range(_ROUNDS):
        T = _moved(T, xi, centre)
        centre = centre + xi[:3]
        drawn = _draw(windows, surface, T, centre)
        if len(drawn) < limits.fewest_views:
            return None
        xi = _solve(drawn, prior, _SIGMAS_PX if k == 0 else _SIGMAS_PX[1:])
    T = _moved(T, xi, centre)
    start = obj.T_world_obj
    vector = np.concatenate([T @ obj.centre - start @ obj.centre, so3_log(T.R @ start.R.T)])
    found = _agreement(drawn, xi)
    if found < limits.agreement:
        return None
    covariance = _covariance(drawn, xi, prior, obj.radius)
    return TextureMotion(vector, covariance, found, tuple(i for i, _ in drawn))


def _moved(T: SE3, xi: Array, centre: Array) -> SE3:
    """The pose after a motion about a centre in the world."""
    R = so3_exp(xi[3:])
    return SE3(R @ T.R, R @ (T.t - centre) + centre + xi[:3])


def _draw(
    windows: Sequence[tuple[int, TextureWindow]], surface: TexturedSurface, T: SE3, centre: Array
) -> list[tuple[int, _Drawing]]:
    limits = TextureMotionSettings.current()
    found = []
    for frame, window in windows:
        pose = window.T_cam_world @ T
        drawn = surface.draw(window.camera, pose, window=window.box)
        if drawn is None:
            continue
        shown = drawn.mask & (drawn.depth < window.hidden)
        mask = inner_mask(shown, drawn.normal) & drawn.sound
        if mask.sum() < limits.fewest_px:
            continue
        found.append(
            (frame, _Drawing(window, drawn.color, mask, _jacobian(window, drawn.depth, centre)))
        )
    return found


def _jacobian(window: TextureWindow, depth: Array32, centre: Array) -> Array32:
    x0, y0, x1, y1 = window.box
    v, u = np.mgrid[y0:y1, x0:x1].astype(np.float64)
    rays = window.camera.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)).reshape(*u.shape, 3)
    z = np.where(np.isfinite(depth), depth, 1.0).astype(np.float64)
    T_world_cam = window.T_cam_world.inverse()
    arm = (rays * z[..., None]) @ T_world_cam.R.T + T_world_cam.t - centre
    R = window.T_cam_world.R
    c = window.camera
    zero = np.zeros_like(z)
    by_point = (
        np.stack(
            [
                np.stack([c.fx / z, zero, -c.fx * rays[..., 0] / z], axis=-1),
                np.stack([zero, c.fy / z, -c.fy * rays[..., 1] / z], axis=-1),
            ],
            axis=-2,
        )
        @ R
    )
    turn = np.cross(arm[..., None, :], by_point)
    return np.concatenate([by_point, turn], axis=-1).astype(np.float32)


def _by_shifts(drawn: Sequence[tuple[int, _Drawing]], prior: Array, reach: float) -> Array:
    """The motion that explains the best shift of each view."""
    rows, shifts = [], []
    for _, d in drawn:
        flow = best_shift(
            d.color,
            d.window.color,
            d.mask,
            limit_px=max(3.0, reach * d.window.size),
            slow=_SLOW * d.window.size,
        )
        rows.append(d.jacobian[d.mask].mean(axis=0))
        shifts.append(flow)
    J, s = np.array(rows, dtype=np.float64), np.array(shifts)
    xi = np.zeros(6)
    for width in (8.0, 4.0, 2.0, 2.0):
        r = s - J @ xi
        w = 1 / (1 + (r**2).sum(axis=1) / width**2)
        # Shifts are known to about a pixel.
        A = np.einsum("vij,v,vik->jk", J, w, J) + prior
        xi = np.linalg.solve(A, np.einsum("vij,v,vi->j", J, w, s))
    return np.asarray(xi)


def _solve(drawn: Sequence[tuple[int, _Drawing]], prior: Array, sigmas: Sequence[float]) -> Array:
    xi = np.zeros(6)
    for sigma in sigmas:
        levels = [_level(d, sigma) for _, d in drawn]
        for _ in range(_STEPS):
            A, b = prior.copy(), np.zeros(6)
            for (_, d), (a, photo) in zip(drawn, levels, strict=True):
                G, r, w = _gradients(d, a, photo, xi)
                J = _by_motion(d, G)
                # Neighbouring pixels are no independent samples.
                JW = J * (w / _ALIKE_PX)[:, None]
                A += JW.T @ J
                b += JW.T @ r
            step = np.linalg.solve(A, b - prior @ xi)
            xi = xi + step
            if np.abs(step[:3]).max() < 2e-5 and np.abs(step[3:]).max() < 2e-4:
                break
    return xi


def _level(d: _Drawing, sigma: float) -> tuple[Array32, Array32]:
    slow = _SLOW * d.window.size
    fine = smoothed(d.color, d.mask, sigma) - smoothed(d.color, d.mask, slow)
    return standardised(fine, d.mask), passed(d.window.color, sigma, slow)


def _gradients(d: _Drawing, a: Array32, photo: Array32, xi: Array) -> tuple[Array, Array, Array]:
    """Gradients (N, 2), residuals (N,) and weights (N,) of the pixels and channels of one view.

    The mean of the gradients of both pictures makes the steps of second order (S. Benhimane and
    E. Malis, "Real-time image-based tracking of planes", 2004).
    """
    b = standardised(sampled(photo, d.jacobian @ xi.astype(np.float32)), d.mask)
    both = (a + b) / 2
    G = [
        cv2.Sobel(both, cv2.CV_32F, x, y, ksize=3, scale=1 / 8)[d.mask].reshape(-1)
        for x, y in ((1, 0), (0, 1))
    ]
    r = (a - b)[d.mask].reshape(-1).astype(np.float64)
    return np.stack(G, axis=1).astype(np.float64), r, 1 / (1 + r * r)


def _by_motion(d: _Drawing, G: Array) -> Array:
    """(N, 6) derivative of the pixels and channels by the motion."""
    by_pixel = np.repeat(d.jacobian[d.mask], 3, axis=0).astype(np.float64)
    return np.asarray(G[:, :1] * by_pixel[:, 0] + G[:, 1:] * by_pixel[:, 1])


def _agreement(drawn: Sequence[tuple[int, _Drawing]], xi: Array) -> float:
    values = [
        agreement(
            d.color,
            sampled(d.window.color, d.jacobian @ xi.astype(np.float32)),
            d.mask,
            d.window.size,
        )
        for _, d in drawn
    ]
    weights = [d.mask.sum() for _, d in drawn]
    return float(np.average(values, weights=weights))


def _covariance(
    drawn: Sequence[tuple[int, _Drawing]], xi: Array, prior: Array, radius: float
) -> Array:
    """(6, 6) covariance of the motion.

    Each view has one further shift of its own: what cameras, lens and mesh are wrong by.
    """
    limits = TextureMotionSettings.current()
    shifts, information = [], []
    for _, d in drawn:
        a, photo = _level(d, _SIGMAS_PX[-1])
        G, r, w = _gradients(d, a, photo, xi)
        J = _by_motion(d, G)
        GW = G * w[:, None]
        A = GW.T @ G
        shifts.append(np.linalg.solve(A + 1e-3 * np.trace(A) * np.eye(2), GW.T @ r))
        samples = float(np.clip(d.mask.sum() / _ALIKE_PX**2, 1.0, 9.0))
        # In pixels: a direction along which the texture does not change says nothing.
        information.append(samples * (J * w[:, None]).T @ J / max(np.trace(A) / 2, 1e-9))
    s = np.array(shifts)
    residual = float(np.sqrt((s**2).sum(axis=1).mean() / 2))
    # Six unknowns were fitted to two numbers of each view.
    free = max(2 * len(s) - 6, 2)
    std = np.hypot(limits.smallest_px, residual * np.sqrt(2 * len(s) / free))
    covariance = np.linalg.inv(np.sum(information, axis=0) / std**2 + prior)
    # A texture that is shifted on each side of the mesh looks like a shift and a turn.
    covariance[:3, :3] += limits.placed_m**2 * np.eye(3)
    covariance[3:, 3:] += (limits.placed_m / radius) ** 2 * np.eye(3)
    return np.asarray(covariance)
