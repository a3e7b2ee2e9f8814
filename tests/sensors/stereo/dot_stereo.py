"""Stereo pairs of dotted surfaces whose exact disparity is known by formula.

A projector halfway between the two cameras throws gaussian dots; each pixel of each camera is the
pattern at the direction in which the projector sees the pixel's surface point. Nothing is
resampled, and gaussians with a spread of 0.7 px or more hold next to nothing that is finer than
the pixel grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], Array]


@dataclass(frozen=True, kw_only=True)
class Rig:
    """Two cameras and a projector between them, a quarter of a D415's picture by default.

    Attributes:
        dot_px: standard deviation of a dot.
        spacing_px: mean distance of dots.
        noise: standard deviation, in grey levels, of the noise at level 50; it goes with the root.
    """

    width: int = 320
    height: int = 180
    focal_px: float = 443.9
    baseline_m: float = 0.0548
    dot_px: float = 0.9
    spacing_px: float = 4.4
    noise: float = 0.0
    seed: int = 0

    def pair(self, surface: Surface) -> tuple[NDArray[np.uint8], NDArray[np.uint8], Array]:
        """Left image, right image, exact disparity of the left image's pixels."""
        v, u = np.mgrid[: self.height, : self.width].astype(np.float64)
        centre = np.array([(self.width - 1) / 2, (self.height - 1) / 2])
        rays = np.stack([(u - centre[0]) / self.focal_px, (v - centre[1]) / self.focal_px,
                         np.ones_like(u)], axis=-1)  # fmt: skip
        rng = np.random.default_rng(self.seed)
        grid = np.mgrid[-60 : self.height + 60 : self.spacing_px,
                        -60 : self.width + 60 : self.spacing_px]  # fmt: skip
        dots = grid[::-1].reshape(2, -1).T
        dots = dots + rng.uniform(-0.45, 0.45, dots.shape) * self.spacing_px
        power = rng.uniform(0.6, 1.0, len(dots))
        tree = cKDTree(dots)
        images = []
        for x in (0.0, self.baseline_m):
            eye = np.array([x, 0, 0])
            point = eye + rays * surface(eye, rays)[..., None]
            seen = point - [self.baseline_m / 2, 0, 0]
            at = seen[..., :2] / seen[..., 2:] * self.focal_px + centre
            distance, index = tree.query(at.reshape(-1, 2), k=10)
            light = (power[index] * np.exp(-0.5 * (distance / self.dot_px) ** 2)).sum(axis=1)
            grey = 15 + 160 * light.reshape(at.shape[:2])
            grey = grey + rng.normal(size=grey.shape) * self.noise * np.sqrt(grey / 50)
            images.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
        depth = surface(np.zeros(3), rays)
        return images[0], images[1], self.focal_px * self.baseline_m / depth


def plane(normal: tuple[float, float, float], distance_m: float) -> Surface:
    """Points with normal . p = distance."""
    n = np.array(normal)
    return lambda eye, rays: (distance_m - eye @ n) / (rays @ n)


def sphere(centre: tuple[float, float, float], radius_m: float, behind: Surface) -> Surface:
    """A ball before another surface."""
    c = np.array(centre)

    def depth(eye: Array, rays: Array) -> Array:
        to = eye - c
        a, b = (rays**2).sum(axis=-1), rays @ to
        root = b**2 - a * (to @ to - radius_m**2)
        with np.errstate(invalid="ignore"):
            hit = (-b - np.sqrt(root)) / a
        return np.where(root > 0, hit, behind(eye, rays))

    return depth


def bias_by_fraction(error: Array, exact: Array, parts: int = 10) -> Array:
    """Mean error per part of a pixel of the exact disparity: what pixel locking bends."""
    part = ((exact % 1) * parts).astype(int)
    return np.array([error[part == k].mean() for k in range(parts)])
