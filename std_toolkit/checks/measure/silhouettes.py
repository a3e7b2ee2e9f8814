"""Agreement of the silhouette of a mesh with the edges of an image, in about half a millisecond.

The image is reduced to a cut around the object with a map of edge strength for every direction.
The silhouette of a pose is drawn from points on the surface; its score is the mean strength under
its contour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.edges import noise_level
from std_toolkit.geometry import SE3, Camera
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Longest side of the object in cells of the reduced image, and points on its surface.
_CELLS, _SURFACE_POINTS = 110, 6000

# Reach of a contour to an edge, cells, and number of directions of edges.
_REACH, _DIRECTIONS = 1, 12


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings(Settings):
    """Silhouettes that are measured."""

    fewest: int = limit(30, source=NOT_RECORDED)
    """cells of a contour"""
    nearest_m: float = limit(0.05, unit="m", source=NOT_RECORDED)
    """a pose with a point nearer to the camera is not measured"""


@dataclass(frozen=True, eq=False)
class SampledSurface:
    """Points on a mesh, (N, 3) and (4, N) with ones, and the centre of its bounding box."""

    points: Array
    homogeneous: NDArray[np.float32]
    centre: Array

    @staticmethod
    def of(vertices: Array, faces: NDArray[np.integer]) -> SampledSurface:
        corners = vertices[faces]
        area = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        random = np.random.default_rng(0)
        pick = random.choice(len(corners), _SURFACE_POINTS, p=area / area.sum())
        u, v = random.uniform(size=(2, _SURFACE_POINTS, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        a, b, c = corners[pick].transpose(1, 0, 2)
        used = vertices[np.unique(faces)]
        points = a + u * (b - a) + v * (c - a)
        homogeneous = np.vstack([points.T, np.ones(len(points))]).astype(np.float32)
        return SampledSurface(points, homogeneous, (used.min(axis=0) + used.max(axis=0)) / 2)

    def about_centre(self, R: Array, shift: Array) -> SE3:
        return SE3(R, self.centre - R @ self.centre + shift)


@dataclass(frozen=True, eq=False)
class MeasuredContour:
    """Contour of a pose in one view: mean strength, number of points, cells (P, 2) as x, y."""

    score: float
    points: int
    cells: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class SilhouetteView:
    """Reduced image around an object.

    Attributes:
        origin, scale: a pixel is at (pixel - origin) * scale in the reduced image.
        strength: (D, h, w) strength of edges by direction of their normal, 0 to 1.
        hidden: (h, w) cells behind other objects or outside the image.
        away: (h, w) distance in cells to the contour at `pose`.
    """

    frame: int
    camera: Camera
    pose: SE3
    origin: Array
    scale: float
    strength: NDArray[np.float32]
    hidden: NDArray[np.bool_]
    away: NDArray[np.float32]

    @staticmethod
    def cut(
        frame: int,
        image: NDArray[np.uint8],
        camera: Camera,
        surface: SampledSurface,
        pose: SE3,
        others: Sequence[tuple[SampledSurface, SE3]],
        *,
        reach_m: float,
    ) -> SilhouetteView | None:
        """Cut an image around an object.

        Args:
            frame: frame id.
            image: (H, W, 3).
            camera: of the frame.
            surface, pose: the object and T_cam_obj.
            others: surfaces and T_cam_obj of objects that may hide it.
            reach_m: largest shift of the poses to be measured.

        Returns:
            None if the object is behind the camera, outside the image or too small.
        """
        seen = pose @ surface.points
        if seen[:, 2].min() < SilhouetteSettings.current().nearest_m:
            return None
        uv = camera.project(seen)
        uv = uv[np.isfinite(uv).all(axis=1)]
        if not len(uv):
            return None
        low, high = uv.min(axis=0), uv.max(axis=0)
        size = float((high - low).max())
        inside = ((uv > -0.5) & (uv < np.array(camera.size) - 0.5)).all(axis=1).mean()
        if size < 20 or inside < 0.3:
            return None
        z = float((pose @ surface.centre)[2])
        margin = 1.3 * reach_m * camera.fx / z + 0.15 * size
        scale = min(1.0, _CELLS / size)
        low = np.floor(low - margin)
        width, height = np.ceil((high + margin - low) * scale).astype(int)
        crop, outside = _reduced(image, low, scale, (int(width), int(height)))
        strength = _edge_strength(crop, noise_level(image) * scale)
        view = SilhouetteView(
            frame, camera, pose, low, scale, strength, outside, np.zeros_like(strength[0])
        )
        hidden = outside
        for other, T in others:
            if (T @ other.centre)[2] < z:
                mask = view._silhouette(other, T)
                if mask is not None:
                    hidden = hidden | (cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0)
        mask = view._silhouette(surface, pose)
        contour = None if mask is None else _outline(mask)
        if contour is None:
            return None
        blank = np.full(strength.shape[1:], 255, np.uint8)
        blank[contour[0][:, 1], contour[0][:, 0]] = 0
        away = cv2.distanceTransform(blank, cv2.DIST_L2, 3)
        return SilhouetteView(frame, camera, pose, low, scale, strength, hidden, away)  # type: ignore[arg-type]

    def measure(self, surface: SampledSurface, pose: SE3) -> MeasuredContour | None:
        """None if too little of the contour is visible."""
        mask = self._silhouette(surface, pose)
        outline = None if mask is None else _outline(mask)
        if outline is None:
            return None
        cells, bins = outline
        visible = ~self.hidden[cells[:, 1], cells[:, 0]]
        if visible.sum() < max(SilhouetteSettings.current().fewest, 0.2 * len(cells)):
            return None
        cells, bins = cells[visible], bins[visible]
        values = self.strength[bins, cells[:, 1], cells[:, 0]]
        return MeasuredContour(float(values.mean()), len(cells), cells)

    def distance(self, measured: MeasuredContour) -> float:
        """Mean distance in cells of a contour from the one at the pose."""
        return float(self.away[measured.cells[:, 1], measured.cells[:, 0]].mean())

    def _silhouette(self, surface: SampledSurface, pose: SE3) -> NDArray[np.uint8] | None:
        """(h, w) mask of a surface at T_cam_obj; None if none of it is in view."""
        limits = SilhouetteSettings.current()
        height, width = self.strength.shape[1:]
        if self.camera.is_distorted:
            seen = pose @ surface.points
            behind = seen[:, 2].min() < limits.nearest_m
            # Points beyond the distortion model are NaN, and so not inside.
            u, v = ((self.camera.project(seen) - self.origin) * self.scale).T
        else:
            # One product for pose, camera and reduction: this runs a thousand times a second.
            K = self.camera.K.copy()
            K[:2, 2] -= self.origin
            K[:2] *= self.scale
            P = (K @ pose.matrix()[:3]).astype(np.float32)
            x, y, z = P @ surface.homogeneous
            behind = z.min() < limits.nearest_m
            u, v = x / z, y / z
        if behind:
            return None
        inside = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
        cells = (v[inside] + 0.5).astype(np.int32) * width + (u[inside] + 0.5).astype(np.int32)
        if len(cells) < limits.fewest:
            return None
        mask = np.zeros(height * width, np.uint8)
        mask[cells] = 255
        return cv2.morphologyEx(mask.reshape(height, width), cv2.MORPH_CLOSE, _KERNEL)  # type: ignore[return-value]


# Closes the gaps between neighbouring surface points.
_KERNEL = np.ones((5, 5), np.uint8)


def _reduced(
    image: NDArray[np.uint8], origin: Array, scale: float, size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Reduced cut of an image, (h, w, 3), and its cells outside the image."""
    T = np.array([[scale, 0, -origin[0] * scale], [0, scale, -origin[1] * scale]])
    blurred = image.astype(np.float32)
    if scale < 1:
        blurred = cv2.GaussianBlur(blurred, (0, 0), 0.5 / scale)  # type: ignore[assignment]
    cut = cv2.warpAffine(blurred, T, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ones = np.ones(image.shape[:2], np.uint8)
    inside = cv2.warpAffine(ones, T, size, flags=cv2.INTER_NEAREST)
    return cut.astype(np.float32), cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=0) == 0


def _edge_strength(crop: NDArray[np.float32], noise: float) -> NDArray[np.float32]:
    """Strength of edges by the direction of their normal, (D, h, w), with a reach of some cells."""
    smooth = cv2.GaussianBlur(crop, (0, 0), 0.8)
    dx, dy = cv2.Sobel(smooth, -1, 1, 0, scale=1 / 8), cv2.Sobel(smooth, -1, 0, 1, scale=1 / 8)
    found = []
    steps = np.hypot(dx, dy).mean(axis=2)
    half = max(2.0, 2 * noise, 0.5 * float(np.percentile(steps, 90)))
    kernel = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8)
    for angle in np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        slope = np.abs(np.cos(angle) * dx + np.sin(angle) * dy).max(axis=2)
        across = np.abs(-np.sin(angle) * dx + np.cos(angle) * dy).max(axis=2)
        strength = np.maximum(slope - across, 0) / (slope + half)
        found.append(cv2.blur(cv2.dilate(strength, kernel), (3, 3)))
    return np.stack(found).astype(np.float32)


def _outline(mask: NDArray[np.uint8]) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Cells of the outlines (P, 2) and the direction of their normals as a bin (P,)."""
    chains, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cells, bins = [], []
    for chain in chains:
        if len(chain) < 20:
            continue
        p = chain.reshape(-1, 2)
        way = np.roll(p, -4, axis=0) - np.roll(p, 4, axis=0)
        angle = np.arctan2(way[:, 0], -way[:, 1]) % np.pi
        cells.append(p)
        bins.append(np.rint(angle / np.pi * _DIRECTIONS).astype(np.intp) % _DIRECTIONS)
    if not cells:
        return None
    return np.concatenate(cells).astype(np.intp), np.concatenate(bins)
