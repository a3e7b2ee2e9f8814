"""Photos of an object with known cameras, and the grid of voxels around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array, Floats, Mask
from std_toolkit.geometry import SE3, Camera

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class View:
    """One photo with its camera.

    Attributes:
        name: file name of the photo.
        image: (H, W, 3) RGB, undistorted.
        camera: its intrinsics, without distortion.
        T_world_cam: pose; the world is z up, in metres, with the table at z = 0.
        mask: (H, W) pixels that show the object; None before segmentation.
        hidden: (H, W) pixels where another object stands before this one; None for none.
        sensor: (H, W) z-depth of a depth sensor, metres, undistorted, 0 for none; None without one.
    """

    name: str
    image: NDArray[np.uint8]
    camera: Camera
    T_world_cam: SE3
    mask: Mask | None = None
    hidden: Mask | None = None
    sensor: Floats | None = None

    @property
    def P(self) -> Array:
        """(3, 4) projection of world points to homogeneous pixels."""
        return np.asarray(self.camera.K @ self.T_world_cam.inverse().matrix()[:3])

    @property
    def centre(self) -> Array:
        """(3,) camera centre in the world."""
        return self.T_world_cam.t

    @property
    def shown(self) -> Mask:
        """The mask; everything if there is none."""
        return np.ones(self.image.shape[:2], bool) if self.mask is None else self.mask

    @property
    def possible(self) -> Mask:
        """Pixels whose rays may meet the object: the mask and what hides the object."""
        return self.shown if self.hidden is None else self.shown | self.hidden

    def with_mask(self, mask: Mask, hidden: Mask | None = None) -> View:
        return replace(self, mask=mask, hidden=hidden)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Pixels (N, 2) and z-depths (N,) of world points (N, 3); NaN behind the camera."""
        local = self.T_world_cam.inverse() @ points
        return self.camera.project(local), local[:, 2]

    def grey(self) -> Floats:
        """(H, W) grey values, 0 to 255."""
        return cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY).astype(np.float32)


@dataclass(frozen=True)
class Grid:
    """Voxels of a box; index order is z, y, x.

    Attributes:
        origin: (x, y, z) of the centre of the first voxel, world frame, metres.
        step: distance of neighbouring voxels in metres.
        shape: number of voxels along z, y, x.
    """

    origin: tuple[float, float, float]
    step: float
    shape: tuple[int, int, int]

    @staticmethod
    def around(low: Array, high: Array, step: float, *, margin: int = 3) -> Grid:
        """The grid of a box with a margin of some voxels on every side."""
        size = np.ceil((high - low) / step).astype(int) + 1 + 2 * margin
        x, y, z = low - margin * step
        return Grid(
            (float(x), float(y), float(z)), step, (int(size[2]), int(size[1]), int(size[0]))
        )

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    def points(self, index: NDArray[np.integer]) -> Array:
        """World points (N, 3) of indices (N, 3) in the order z, y, x."""
        return np.asarray(self.origin) + index[:, ::-1] * self.step

    @property
    def box(self) -> tuple[Array, Array]:
        """Corners (3,) of the box of all voxels, world."""
        low = np.asarray(self.origin, np.float64)
        return low, low + np.array(self.shape[::-1]) * self.step

    def at(self, values: Floats, points: Array) -> Floats:
        """Values (N,) of the voxels interpolated at world points (N, 3)."""
        from scipy.ndimage import map_coordinates

        index = ((points - np.asarray(self.origin)) / self.step)[:, ::-1].T
        return np.asarray(map_coordinates(values, index, order=1, mode="nearest"), np.float32)


def in_threads(
    fn: Callable[[Item], Result], items: Sequence[Item], *, threads: int
) -> list[Result]:
    """Results of a function that releases the GIL, in the order of the items."""
    if threads <= 1 or len(items) <= 1:
        return [fn(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(fn, items))
