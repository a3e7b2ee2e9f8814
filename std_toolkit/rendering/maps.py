"""Depth, instance mask, NOCS and normals of a frame, computed from one rendering per object.

Every object is drawn alone, which gives its amodal silhouette: the whole object, including hidden
parts and parts outside the image. Each pixel belongs to the nearest object. The point
`T_obj_cam @ unproject(depth)` gives the NOCS coordinate, and its triangle the normal. No map is
rendered as 8-bit colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh
from std_toolkit.rendering.renderer import (
    PlacedMesh,
    Raster,
    Renderer,
    Window,
    image_window,
    normalised_rays,
    object_window,
)

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry import SE3, Camera

Box = tuple[int, int, int, int]
"""x_min, y_min, x_max, y_max: the outermost pixels of an object."""


@dataclass(frozen=True, eq=False)
class Maps:
    """The maps of one frame.

    Attributes:
        depth: (H,W) float32 z-depth in metres, 0 = background.
        mask: (H,W) uint8 object id, 0 = background.
        nocs: (H,W,3) float32 in 0..1, 0 in the background.
        normals: (H,W,3) float32 unit normals, camera frame (OpenCV axes), towards the camera;
            0 in the background.
        silhouettes: object id to its amodal silhouette.
    """

    depth: np.ndarray
    mask: np.ndarray
    nocs: np.ndarray
    normals: np.ndarray
    silhouettes: Mapping[int, Silhouette]


@dataclass(frozen=True, eq=False)
class Composition:
    """Visible object and triangle of every pixel.

    Attributes:
        depth: (H,W) float32 metres, 0 = nothing.
        index: (H,W) int16 position in the list of placed meshes, -1 = nothing.
        face: (H,W) int32 triangle of that mesh, -1 = nothing.
        silhouettes: one per placed mesh.
    """

    depth: np.ndarray
    index: np.ndarray
    face: np.ndarray
    silhouettes: list[Silhouette]


def render_scene_maps(
    renderer: Renderer,
    camera: Camera,
    placed: Sequence[PlacedMesh],
    *,
    canvas: int = 1,
    smooth_normals: bool = True,
) -> Maps:
    """Render all maps of placed meshes, which occlude each other.

    Args:
        renderer: see `get_renderer`.
        camera: intrinsics, including distortion if the renderer supports it.
        placed: meshes with their poses; ids must be unique.
        canvas: 3 for silhouettes that extend beyond the image (slower for objects at its border).
        smooth_normals: interpolate vertex normals (edges sharper than 40 degrees stay sharp);
            otherwise use the normal of the triangle.

    Raises:
        ToolkitError: an id appears twice or is not in 1..254.
    """
    ids = [p.object_id for p in placed]
    if len(set(ids)) != len(ids) or not all(1 <= i <= 254 for i in ids):
        raise ToolkitError("object ids must be unique and in 1..254", field="object_id", value=ids)
    composition = compose(renderer, camera, placed, canvas=canvas)
    nocs, normals = surface_maps(camera, placed, composition, smooth_normals=smooth_normals)
    return Maps(
        composition.depth,
        mask_of(composition.index, ids),
        nocs,
        normals,
        dict(zip(ids, composition.silhouettes, strict=True)),
    )


def compose(
    renderer: Renderer, camera: Camera, placed: Sequence[PlacedMesh], *, canvas: int = 1
) -> Composition:
    """Draw every mesh alone and keep the nearest per pixel (the earlier one in a tie)."""
    shape = (camera.height, camera.width)
    depth = np.full(shape, np.inf, np.float32)
    index = np.full(shape, -1, np.int16)
    face = np.full(shape, -1, np.int32)
    silhouettes = []
    for i, item in enumerate(placed):
        silhouette = object_silhouette(
            renderer, camera, item.prepared, item.T_cam_obj, canvas=canvas
        )
        silhouettes.append(silhouette)
        if silhouette.image is None or silhouette.image_window is None:
            continue
        place = silhouette.image_window.slices_in(image_window(camera))
        raster = silhouette.image
        nearer = (raster.depth > 0) & (raster.depth < depth[place])
        np.copyto(depth[place], raster.depth, where=nearer)
        np.copyto(face[place], raster.face, where=nearer)
        np.copyto(index[place], i, where=nearer)
    depth[index < 0] = 0
    return Composition(depth, index, face, silhouettes)


def mask_of(index: np.ndarray, ids: Sequence[int]) -> np.ndarray:
    """Return the (H,W) uint8 mask of object ids from indices into `ids`, 0 for index -1."""
    table = np.zeros(256, np.uint8)
    table[: len(ids)] = ids
    return np.asarray(cv2.LUT(index.astype(np.uint8), table))  # -1 is 255


def surface_maps(
    camera: Camera,
    placed: Sequence[PlacedMesh],
    composition: Composition,
    *,
    smooth_normals: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return NOCS and normal map, (H,W,3) float32 each, of the pixels where `index` is not -1.

    Normals of triangles seen from behind (a bowl without thickness, a mesh with inverted winding)
    are flipped, so that they always point towards the camera.
    """
    from std_toolkit.rendering.surface_pixels import fill_maps  # loads numba

    shape = (camera.height, camera.width, 3)
    nocs, normals = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for i, item in enumerate(placed):
        window = composition.silhouettes[i].image_window
        if window is None:
            continue
        place = window.slices_in(image_window(camera))
        mesh, R = item.prepared, item.T_cam_obj.R
        size = (window.height, window.width)
        x, y = (np.broadcast_to(rays, size) for rays in normalised_rays(camera, window))
        fill_maps(
            composition.index[place],
            i,
            composition.depth[place],
            composition.face[place],
            x,
            y,
            np.ascontiguousarray(R),
            R @ mesh.centre + item.T_cam_obj.t,
            mesh.interpolation if smooth_normals else _NO_TABLE,
            mesh.face_normals,
            mesh.closed,
            1 / mesh.diagonal,
            nocs[place],
            normals[place],
        )
    return nocs, normals


_NO_TABLE = np.empty((0, 17), np.float32)


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Silhouette of an object on a canvas around the image.

    Attributes:
        window: position of `mask` on the pixel grid of the image; None if nothing is on the canvas.
        mask: (h,w) bool.
        image: the part inside the image, drawn with the distortion of the camera; None if empty.
        image_window: position of `image`.
    """

    window: Window | None
    mask: np.ndarray
    image_window: Window | None
    image: Raster | None

    @property
    def px_all(self) -> int:
        """Number of pixels on the canvas (BOP's px_count_all for a canvas of 3)."""
        return int(np.count_nonzero(self.mask))

    @property
    def box(self) -> Box | None:
        """Bounding box on the canvas."""
        return None if self.window is None else mask_box(self.mask, self.window)

    def image_mask(self, camera: Camera) -> np.ndarray:
        """Return the silhouette clipped to the image, (H,W) bool."""
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
        camera: intrinsics. A distortion model is not valid outside the image it was fitted on, so
            parts outside the image are drawn with the undistorted pinhole.
        mesh: mesh in metres.
        T_cam_obj: maps mesh coordinates into the camera frame.
        canvas: odd number; the canvas has `canvas` x `canvas` images with the image in its middle,
            3 x 3 in BOP. 1 clips to the image.

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
    """Return the outermost pixels of a mask, offset by the window's origin; None if empty."""
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
