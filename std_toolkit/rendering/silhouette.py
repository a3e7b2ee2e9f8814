"""Amodal silhouettes: all of an object, hidden or outside the image as it may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.rendering.protocol import Raster, Renderer, Window
from std_toolkit.rendering.windows import image_window, object_window

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3

Box = tuple[int, int, int, int]
"""x_min, y_min, x_max, y_max: the outermost pixels that belong to the thing."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """An object's silhouette on a canvas around the image.

    Attributes:
        window: where `mask` lies on the image's pixel grid; None when nothing is on the canvas.
        mask: (h,w) bool.
        image: the part inside the image, drawn with the camera's distortion; None if empty.
        image_window: where `image` lies.
    """

    window: Window | None
    mask: np.ndarray
    image_window: Window | None
    image: Raster | None

    @property
    def px_all(self) -> int:
        """Pixels of the silhouette on the canvas (BOP's px_count_all for a canvas of 3)."""
        return int(np.count_nonzero(self.mask))

    @property
    def box(self) -> Box | None:
        """Bounding box on the canvas."""
        return None if self.window is None else mask_box(self.mask, self.window)

    def image_mask(self, camera: Camera) -> np.ndarray:
        """(H,W) bool: the silhouette clipped to the image."""
        mask = np.zeros((camera.height, camera.width), bool)
        if self.image is not None and self.image_window is not None:
            mask[self.image_window.slices_in(image_window(camera))] = self.image.depth > 0
        return mask


def object_silhouette(
    renderer: Renderer,
    camera: Camera,
    mesh: trimesh.Trimesh | RenderMesh,
    T_cam_obj: SE3,
    *,
    canvas: int = 3,
) -> Silhouette:
    """Draw one object alone.

    Args:
        renderer: any renderer.
        camera: intrinsics. A distortion model tells nothing about the world outside the image it
            was fitted on, so what lies outside the image is drawn by the undistorted pinhole.
        mesh: in metres.
        T_cam_obj: maps mesh coordinates into the camera frame.
        canvas: odd; the canvas has `canvas` x `canvas` images with the image in its middle, as
            BOP's 3 x 3. 1 clips to the image.

    Returns:
        The silhouette and, for the part inside the image, depth and triangles.
    """
    prepared = prepare_mesh(mesh)
    inner = image_window(camera)
    if not camera.is_distorted:
        window = object_window(camera, prepared, T_cam_obj, canvas=canvas)
        if window is None:
            return _nothing()
        raster = renderer.draw(camera, prepared, T_cam_obj, window=window)
        part = window.intersect(inner)
        if part is None:
            return Silhouette(window, raster.depth > 0, None, None)
        rows, columns = part.slices_in(window)
        clipped = Raster(raster.depth[rows, columns], raster.face[rows, columns])
        return Silhouette(window, raster.depth > 0, part, clipped)

    part = object_window(camera, prepared, T_cam_obj)
    inside = None
    if part is not None:
        inside = renderer.draw(camera, prepared, T_cam_obj, window=part)
    pinhole = camera.without_distortion()
    outer = object_window(pinhole, prepared, T_cam_obj, canvas=canvas)
    if outer is not None and outer.intersect(inner) == outer:
        outer = None  # nothing beyond the image
    window = _union(part, outer)
    if window is None:
        return _nothing()
    mask = np.zeros((window.height, window.width), bool)
    if outer is not None:
        drawn = renderer.draw(pinhole, prepared, T_cam_obj, window=outer)
        mask[outer.slices_in(window)] = drawn.depth > 0
        overlap = outer.intersect(inner)
        if overlap is not None:
            mask[overlap.slices_in(window)] = False
    if part is not None and inside is not None:
        mask[part.slices_in(window)] = inside.depth > 0
    return Silhouette(window, mask, part, inside)


def mask_box(mask: np.ndarray, window: Window | None = None) -> Box | None:
    """Outermost pixels of a mask, moved to the window's place on the grid; None when empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return None
    x, y = (0, 0) if window is None else (window.x, window.y)
    return int(columns[0]) + x, int(rows[0]) + y, int(columns[-1]) + x, int(rows[-1]) + y


def _nothing() -> Silhouette:
    return Silhouette(None, np.zeros((0, 0), bool), None, None)


def _union(a: Window | None, b: Window | None) -> Window | None:
    if a is None or b is None:
        return a or b
    x, y = min(a.x, b.x), min(a.y, b.y)
    return Window(x, y, max(a.x1, b.x1) - x, max(a.y1, b.y1) - y)
