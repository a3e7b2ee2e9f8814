"""Search of one image for an object that is not where its label puts it.

A camera pose that is wrong, or an object that was moved, displaces the object by more than the
profiles along its contour reach. The contour is shifted over a wide part of the image, and the
edges at the best places are measured in full.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.checks.measure.contours import Contour, LabelCaster, trace_contour
from std_toolkit.checks.measure.edges import noise_level, read_profiles, smooth_image
from std_toolkit.checks.measure.motion import MotionEquations, motion_equations
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.settings import Settings, limit

# Slopes are read at half the resolution, on a grid of this step in px of the image.
_SCALE = 2
_STEP_PX = 4.0
_BLUR_PX = 1.5
_SAMPLE = 100


@dataclass(frozen=True, kw_only=True)
class WideSearchSettings(Settings):
    """Where an object is looked for, and how many places are measured."""

    reach: float = limit(
        0.16,
        source="100 mm at a distance of 0.6 m with a field of view of 56 degrees",
    )
    """largest shift as a part of the width of the image"""
    nearest_px: float = limit(
        6.0, unit="px", source="nearer places lie within the profiles of the label"
    )
    """smallest shift"""
    places: int = limit(
        8, source="the right place was among the first 8 in 16 of 18 frames of seed 1"
    )
    """places that are measured"""


@dataclass(frozen=True, eq=False)
class SearchedView:
    """One object in one image.

    Attributes:
        caster: holds the object; the others hide it.
        object_id: of the object.
        camera: of the image.
        T_world_cam: pose of the camera, in the world in which the caster has the label.
        smoothed: from `smooth_image`.
        noise: from `noise_level`.
        reach_px: length of a profile on both sides.
        shown: (H, W) where nothing else hides the object; None: what the caster says.
    """

    caster: LabelCaster
    object_id: int
    camera: Camera
    T_world_cam: SE3
    smoothed: NDArray[np.float32]
    noise: float
    reach_px: float
    shown: NDArray[np.bool_] | None = None

    @staticmethod
    def of_image(
        image: NDArray[np.uint8],
        caster: LabelCaster,
        object_id: int,
        camera: Camera,
        T_world_cam: SE3,
        *,
        reach_px: float,
    ) -> SearchedView:
        """The view with its image smoothed."""
        smoothed, noise = smooth_image(image), noise_level(image)
        return SearchedView(caster, object_id, camera, T_world_cam, smoothed, noise, reach_px)

    @property
    def centre(self) -> Array:
        """(3,) centre of the object in the world, metres."""
        return self.caster.corners[self.object_id].mean(axis=0)

    def contour(self, motion: Array) -> Contour | None:
        """The outline of the object after a motion (6,)."""
        T = self._moved_camera(motion)
        window = self.caster.window(self.object_id, self.camera, T)
        if window is None:
            return None
        x0, y0, x1, y1 = window
        possible = self.caster.within(self.object_id, self.camera, T, window)
        mask = np.zeros((y1 - y0, x1 - x0), bool)
        hits = self.caster.cast_pixels(self.camera, T, possible, origin=(x0, y0))
        mask[possible] = hits.object_id == self.object_id
        shown = None if self.shown is None else self.shown[y0:y1, x0:x1]
        return trace_contour(
            self.caster, self.camera, T, self.object_id, mask, origin=(x0, y0), shown=shown
        )

    def equations(self, motion: Array) -> MotionEquations | None:
        """Edges near the contour after a motion (6,); offsets and motions count from the label."""
        there = self.contour(motion)
        if there is None:
            return None
        profiles = read_profiles(self.smoothed, there, reach_px=self.reach_px, noise=self.noise)
        if profiles is None:
            return None
        T = self._moved_camera(motion)
        found = motion_equations(there, profiles, self.camera, T, self.centre)
        return None if found is None else found.after(-motion)

    def places(self) -> list[Array]:
        """Motions (6,) of the object to the most likely other places in the image, best first."""
        contour = self.contour(np.zeros(6))
        if contour is None or not contour.own.any():
            return []
        z = float((self.T_world_cam.inverse() @ self.centre)[2])
        return [
            np.concatenate(
                [
                    self.T_world_cam.R
                    @ np.array([x * z / self.camera.fx, y * z / self.camera.fy, 0.0]),
                    np.zeros(3),
                ]
            )
            for x, y in self._shifts(contour)
        ]

    def _moved_camera(self, motion: Array) -> SE3:
        """The camera that sees the label as this one sees the object after a motion."""
        turn = so3_exp(motion[3:])
        moved = SE3(turn, self.centre + motion[:3] - turn @ self.centre)
        return moved.inverse() @ self.T_world_cam

    def _shifts(self, contour: Contour) -> list[tuple[float, float]]:
        """Shifts x, y in px at which most of the contour lies on slopes along its normals."""
        from std_toolkit.checks.measure.edge_sums import strength_on_grid  # loads numba

        limits = WideSearchSettings.current()
        reach = round(limits.reach * self.camera.width / _STEP_PX) * _STEP_PX
        own = np.flatnonzero(contour.own)
        own = own[np.linspace(0, len(own) - 1, min(len(own), _SAMPLE)).round().astype(int)]
        points = contour.points[own]
        low = np.maximum(np.floor(points.min(axis=0) - reach - 8), 0).astype(int)
        high = np.ceil(points.max(axis=0) + reach + 8).astype(int)
        part = self.smoothed[low[1] : high[1], low[0] : high[0]]
        size = part.shape[1] // _SCALE, part.shape[0] // _SCALE
        if min(size, default=0) < 2:
            return []
        small = cv2.resize(part, size, interpolation=cv2.INTER_AREA).mean(axis=2)
        small = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
        gx = cv2.Sobel(small, cv2.CV_32F, 1, 0, scale=1 / 8)
        gy = cv2.Sobel(small, cv2.CV_32F, 0, 1, scale=1 / 8)
        grid = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
        dx, dy = np.meshgrid(grid, grid)
        at = (points - low - (_SCALE - 1) / 2) / _SCALE
        threshold = 1.5 * max(self.noise, 1.5)
        score = strength_on_grid(
            at, contour.normals[own], gx, gy, dx.ravel() / _SCALE, dy.ravel() / _SCALE, threshold
        ).reshape(dx.shape)
        peak = score >= cv2.dilate(score, np.ones((5, 5), np.uint8))
        rows = np.flatnonzero(peak & (np.hypot(dx, dy) >= limits.nearest_px))
        rows = rows[np.argsort(-score.ravel()[rows])][: limits.places]
        return [(float(dx.ravel()[r]), float(dy.ravel()[r])) for r in rows]
