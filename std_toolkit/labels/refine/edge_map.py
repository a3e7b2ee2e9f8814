"""How much an image looks like an edge of a given direction, pixel by pixel.

A predicted contour is compared with the edges of an image without looking for each sample's edge:
a table of responses by direction is made once, and a pose that is tried only looks up. Responses
are ranks: what few pixels of the window reach counts for much, and the thousandth edge of a
printed table cloth for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array32 = NDArray[np.float32]

DIRECTIONS = 12
_SMOOTHING_PX = 0.7
# An edge is strong by comparison with its surroundings, so that faint borders of glass count.
_SURROUNDINGS_PX = 9
_NOISE_LEVELS = 2.0
_RANKS = 1024
# Bounds what a single pixel can be worth: -log of this.
_RAREST = 0.02


@dataclass(frozen=True, eq=False)
class EdgeMap:
    """Responses of a window of an image.

    Attributes:
        response: (DIRECTIONS, h, w), mean about 0, at most 2.9: how rare an edge of that
            direction as clear as the one here is in this window.
    """

    response: Array32

    @staticmethod
    def of(image: NDArray[np.uint8], *, tolerance: float) -> EdgeMap:
        """The map of an image (h, w, 3) whose contours are predicted to `tolerance` pixels."""
        smooth: Array32 = np.asarray(
            cv2.GaussianBlur(image.astype(np.float32), (0, 0), _SMOOTHING_PX), dtype=np.float32
        )
        strength, angle = edge_direction(smooth)
        around = cv2.blur(strength, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
        floor = 0.7 * around + 0.3 * float(np.median(strength)) + _NOISE_LEVELS
        clear = strength / (strength + floor)
        size = 2 * round(tolerance) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        spread = max(0.5, 0.7 * tolerance)
        response = np.empty((DIRECTIONS, *strength.shape), np.float32)
        for k in range(DIRECTIONS):
            centre = (k + 0.5) * np.pi / DIRECTIONS
            # Directions count modulo half a turn: dark on bright or the other way round.
            agreement = np.maximum(np.cos(2 * (angle - centre)), 0) ** 1.5
            near = cv2.dilate((clear * agreement).astype(np.float32), kernel)
            response[k] = cv2.GaussianBlur(near, (0, 0), spread)
        return EdgeMap(_rarity(response))

    def at(self, angle: Array32, v: NDArray[np.intp], u: NDArray[np.intp]) -> Array32:
        """Responses at pixels to contours whose normals have these angles, in [0, pi)."""
        k = np.minimum((angle * (DIRECTIONS / np.pi)).astype(np.intp), DIRECTIONS - 1)
        return self.response[k, v, u]


def edge_direction(image: Array32) -> tuple[Array32, Array32]:
    """Strength of the largest change at every pixel and its direction's angle in [0, pi).

    All channels vote together (Di Zenzo's structure tensor, without smoothing).

    Args:
        image: (h, w, channels).
    """
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=3)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=3)
    xx, xy, yy = (np.zeros(image.shape[:2], np.float32) for _ in range(3))
    for k in range(image.shape[2]):
        x, y = gx[..., k], gy[..., k]
        xx += x * x
        xy += x * y
        yy += y * y
    strength = np.sqrt(0.5 * (xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2)))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return strength, np.where(angle < 0, angle + np.float32(np.pi), angle)


def _rarity(values: Array32) -> Array32:
    """-log of the share of values that are as large, less its mean of about 1."""
    top = max(float(values.max()), 1e-6)
    level = np.minimum((values * (_RANKS / top)).astype(np.int32), _RANKS - 1)
    count = np.bincount(level.ravel(), minlength=_RANKS)
    below = (np.cumsum(count) - 0.5 * count) / level.size
    return (-np.log(1 - below + _RAREST) - 1).astype(np.float32)[level]
