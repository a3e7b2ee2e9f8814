"""Depth, instance mask, NOCS and normals of a frame, from what a renderer draws per object.

Every object is drawn alone (that gives its amodal silhouette), the nearest one wins each pixel,
and what a pixel shows is computed from its depth: the point `T_obj_cam @ unproject(depth)` gives
the NOCS coordinate, the triangle under it the normal. No map passes through 8-bit colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.protocol import PlacedMesh, Renderer
from std_toolkit.rendering.silhouette import Silhouette, object_silhouette
from std_toolkit.rendering.windows import image_window, normalised_rays

if TYPE_CHECKING:
    from std_toolkit.geometry.camera import Camera
    from std_toolkit.geometry.se3 import SE3


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
    """Which object and triangle every pixel shows.

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
    """Draw placed meshes, each of which occludes the others, into all maps.

    Args:
        renderer: see `get_renderer`.
        camera: intrinsics, distortion included where the renderer handles it.
        placed: meshes with their poses; ids must differ.
        canvas: 3 for silhouettes that reach beyond the image (slower for objects at its border).
        smooth_normals: interpolate vertex normals (edges sharper than 40 degrees stay); otherwise
            the triangle's own normal.

    Raises:
        ToolkitError: an id appears twice or is not 1..254.
    """
    ids = [p.object_id for p in placed]
    if len(set(ids)) != len(ids) or not all(1 <= i <= 254 for i in ids):
        raise ToolkitError("object ids must differ and lie in 1..254", field="object_id", value=ids)
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
    """Draw every mesh alone and let the nearest win each pixel (the earlier one a tie)."""
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
    """(H,W) uint8 mask of object ids from positions in a list, 0 where the position is -1."""
    return np.array([*ids, 0], np.uint8)[index]


def surface_maps(
    camera: Camera,
    placed: Sequence[PlacedMesh],
    composition: Composition,
    *,
    smooth_normals: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """NOCS map and normal map, (H,W,3) float32 each, of the pixels that `index` still names."""
    shape = (camera.height, camera.width, 3)
    nocs, normals = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    inside = image_window(camera)
    for i, item in enumerate(placed):
        window = composition.silhouettes[i].image_window
        if window is None:
            continue
        rows, columns = window.slices_in(inside)
        chosen = composition.index[rows, columns] == i
        if not chosen.any():
            continue
        x, y = (np.broadcast_to(a, chosen.shape)[chosen] for a in normalised_rays(camera, window))
        z = composition.depth[rows, columns][chosen].astype(np.float64)
        points = np.stack([x * z, y * z, z], axis=1)
        mesh = item.prepared
        local = _to_mesh(points, mesh, item.T_cam_obj)
        nocs[rows, columns][chosen] = local * np.float32(1 / mesh.diagonal) + np.float32(0.5)
        normals[rows, columns][chosen] = surface_normals(
            mesh,
            composition.face[rows, columns][chosen],
            local,
            item.T_cam_obj,
            smooth=smooth_normals,
        )
    return nocs, normals


def _to_mesh(points: np.ndarray, mesh: RenderMesh, T_cam_obj: SE3) -> np.ndarray:
    """(N,3) camera-frame points in the mesh's centred coordinates, float32.

    The subtraction happens in float64: centred coordinates are small beside the distance.
    """
    origin = T_cam_obj.R @ mesh.centre + T_cam_obj.t
    return ((points - origin) @ T_cam_obj.R).astype(np.float32)


def surface_normals(
    mesh: RenderMesh, face: np.ndarray, local: np.ndarray, T_cam_obj: SE3, *, smooth: bool = True
) -> np.ndarray:
    """Unit normals in the camera frame at points of triangles.

    Args:
        mesh: prepared mesh.
        face: (N,) triangle of each point.
        local: (N,3) points in the mesh's centred coordinates.
        T_cam_obj: maps mesh coordinates into the camera frame.
        smooth: interpolate corner normals; otherwise the triangle's own.

    Returns:
        (N,3) float32. Triangles seen from behind (a bowl without thickness, a mesh wound the
        wrong way) have their normal turned, so that it always points to the camera's side.
    """
    normal = _interpolated(mesh, face, local) if smooth else mesh.face_normals[face]
    if not mesh.closed:
        camera_centre = (-(T_cam_obj.R.T @ T_cam_obj.t) - mesh.centre).astype(np.float32)
        sight = local - camera_centre
        behind = np.einsum("ij,ij->i", mesh.face_normals[face], sight) > 0
        normal[behind] *= -1
    return normal @ T_cam_obj.R.T.astype(np.float32)


def _interpolated(mesh: RenderMesh, face: np.ndarray, local: np.ndarray) -> np.ndarray:
    """(N,3) float32 unit normals in mesh coordinates, interpolated within the triangles."""
    table = mesh.interpolation.take(face, axis=0)
    x, y, z = local[:, 0], local[:, 1], local[:, 2]
    # Depth rounding may put the point a hair outside its triangle: hence the clip.
    v, w = (
        np.clip(table[:, k] * x + table[:, k + 1] * y + table[:, k + 2] * z + table[:, k + 3], 0, 1)
        for k in (0, 4)
    )
    normal = table[:, 8:11] + v[:, None] * table[:, 11:14] + w[:, None] * table[:, 14:17]
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    normal /= np.maximum(length, np.float32(1e-12))[:, None]
    return normal
