"""Antialiased 2D strokes as triangles.

Stroke edges fade out over a pixel, so antialiasing needs no driver support or multisampling.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

Color = tuple[float, float, float, float]
"""Red, green, blue, opacity; each 0 to 1."""

# Width of the soft edge, pixels.
FADE_PX = 1.0


class Strokes:
    """Collects 2D shapes in drawing order; later ones are on top."""

    def __init__(self) -> None:
        self._points: list[Array] = []
        self._colors: list[NDArray[np.uint8]] = []
        self._faces: list[NDArray[np.int64]] = []
        self._count = 0

    def arrays(self) -> tuple[Array, NDArray[np.uint8], NDArray[np.int64]]:
        """Return vertices (V, 2) in screen positions, colours (V, 4) uint8, triangles (F, 3)."""
        if not self._points:
            return np.zeros((0, 2)), np.zeros((0, 4), np.uint8), np.zeros((0, 3), np.int64)
        return (
            np.concatenate(self._points),
            np.concatenate(self._colors),
            np.concatenate(self._faces),
        )

    def segments(self, ends: NDArray[np.floating], width: float, color: Color) -> None:
        """Add separate lines; `ends` (N, 2, 2) screen positions, `width` in pixels."""
        ends = ends[np.isfinite(ends).all(axis=(1, 2))]
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along = np.divide(along, length, out=np.zeros_like(along), where=length > 1e-9)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        core = max((width - FADE_PX) / 2, 0.0)
        # Lines thinner than the soft edge are drawn with lower opacity.
        strength = min(1.0, width / FADE_PX)
        offsets = np.array([-core - FADE_PX, -core, core, core + FADE_PX])
        # (N, 2 ends, 4 across)
        grid = ends[:, :, None] + across[:, None, None] * offsets[:, None]
        alphas = np.tile(np.array([0.0, strength, strength, 0.0]), (len(ends), 2, 1))
        strip = [[0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 6], [2, 6, 3], [3, 6, 7]]
        faces = np.arange(len(ends))[:, None, None] * 8 + np.array(strip)
        self._add(grid.reshape(-1, 2), alphas.ravel(), color, faces.reshape(-1, 3))

    def line(self, points: ArrayLike, width: float, color: Color, *, closed: bool = False) -> None:
        """Add a polyline through `points` (N, 2), with mitred joints."""
        p = np.asarray(points, dtype=np.float64)
        p = p[np.isfinite(p).all(axis=1)]
        if len(p) < 2:
            return
        nexts = np.roll(p, -1, axis=0) if closed else np.concatenate([p[1:], p[-1:]])
        lasts = np.roll(p, 1, axis=0) if closed else np.concatenate([p[:1], p[:-1]])
        before, after = _unit(p - lasts), _unit(nexts - p)
        if not closed:
            before[0], after[-1] = after[0], before[-1]
        mitre = _unit(before + after)
        across = np.stack([-mitre[:, 1], mitre[:, 0]], axis=1)
        # Limits the mitre of sharp corners.
        stretch = 1 / np.clip(np.einsum("ij,ij->i", mitre, after), 0.4, 1.0)
        core = max((width - FADE_PX) / 2, 0.0)
        strength = min(1.0, width / FADE_PX)
        offsets = np.array([-core - FADE_PX, -core, core, core + FADE_PX])
        grid = p[:, None] + (across * stretch[:, None])[:, None] * offsets[:, None]
        alphas = np.tile(np.array([0.0, strength, strength, 0.0]), (len(p), 1))
        at = np.arange(len(p) if closed else len(p) - 1)
        a, b = 4 * at, 4 * ((at + 1) % len(p))
        faces = [
            np.stack(part, axis=1)
            for k in range(3)
            for part in ((a + k, b + k, a + k + 1), (a + k + 1, b + k, b + k + 1))
        ]
        self._add(grid.reshape(-1, 2), alphas.ravel(), color, np.concatenate(faces))

    def polygon(self, points: ArrayLike, color: Color) -> None:
        """Add a filled convex polygon (N, 2) with a soft edge."""
        p = np.asarray(points, dtype=np.float64)
        if len(p) < 3 or not np.isfinite(p).all():
            return
        middle = p.mean(axis=0)
        n = len(p)
        at = np.arange(n)
        fan = np.stack([np.full(n, n), at, (at + 1) % n], axis=1)
        self._add(np.concatenate([p, middle[None]]), np.ones(n + 1), color, fan)
        self.line(p, FADE_PX, color, closed=True)

    def disc(self, middle: ArrayLike, radius: float, color: Color) -> None:
        self.polygon(circle(middle, radius), color)

    def ring(self, middle: ArrayLike, radius: float, width: float, color: Color) -> None:
        self.line(circle(middle, radius), width, color, closed=True)

    def cross(self, middle: ArrayLike, size: float, width: float, color: Color) -> None:
        """Add an upright cross with a gap in the middle that shows the pixel."""
        x, y = np.asarray(middle, dtype=np.float64)
        near, far = 0.35 * size, size
        ends = [
            [[x + dx * near, y + dy * near], [x + dx * far, y + dy * far]]
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
        ]
        self.segments(np.array(ends), width, color)

    def _add(self, points: Array, alphas: Array, color: Color, faces: NDArray[np.integer]) -> None:
        rgba = np.empty((len(points), 4))
        rgba[:, :3] = color[:3]
        rgba[:, 3] = alphas * color[3]
        self._points.append(points)
        self._colors.append((255 * rgba).round().astype(np.uint8))
        self._faces.append(faces.astype(np.int64) + self._count)
        self._count += len(points)


def circle(middle: ArrayLike, radius: float) -> Array:
    """Return (N, 2) points of a circle on the screen, dense enough to look round."""
    n = int(np.clip(radius * 2, 16, 96))
    angle = 2 * np.pi * np.arange(n) / n
    ring: Array = np.asarray(middle, dtype=np.float64) + radius * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )
    return ring


def rgba(color: str | Sequence[float], opacity: float = 1.0) -> Color:
    """Return a colour "#rrggbb" or (r, g, b) with an opacity."""
    if isinstance(color, str):
        r, g, b = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    else:
        r, g, b = color
    return (r, g, b, opacity)


def _unit(v: Array) -> Array:
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.divide(v, length, out=np.zeros_like(v), where=length > 1e-9)
