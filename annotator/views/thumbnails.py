"""Small pictures of meshes for the library, drawn without OpenGL and kept on disk."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from annotator.placing.standing import standing_axis
from annotator.views.upright import front_rotation
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import read_color, write_color
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh

if TYPE_CHECKING:
    import trimesh

    from annotator.session import Snapshot
    from std_toolkit.scene import Model

# Neutral, as the window: nothing tints the judgement of an image.
PAPER = (38, 38, 38)
CLAY = (192, 192, 192)
_SAMPLES = 3
_FOLDER = Path(".std") / "annotate" / "thumbnails"


def model_picture(snapshot: Snapshot, model: Model, size: int) -> NDArray[np.uint8] | None:
    """The thumbnail of a model of the library, standing as it is placed; None without its mesh.

    Kept in the scene folder where that can be written. May run in any thread.
    """
    try:
        mesh = snapshot.meshes.mesh(model)
        axis = standing_axis(snapshot, model)
    except ToolkitError:
        return None  # told where the mesh itself is drawn
    if snapshot.writable:
        return cached_thumbnail(snapshot.scene.root, mesh, size, axis)
    return thumbnail(mesh, size, axis)


def thumbnail(mesh: trimesh.Trimesh | RenderMesh, size: int, axis: int = 2) -> NDArray[np.uint8]:
    """A mesh standing upright, from above its front: (size, size, 3) RGB uint8.

    Takes some tenths of a second for 50,000 faces, and may run in any thread.

    Args:
        axis: the coordinate axis (0, 1, 2) that is up.
    """
    from std_toolkit.rendering.maps import compose, surface_maps
    from std_toolkit.rendering.protocol import PlacedMesh
    from std_toolkit.rendering.raycast import RaycastRenderer

    prepared = prepare_mesh(mesh)
    large = size * _SAMPLES
    # From ten radii away it looks as drawn; the image just holds the bounding sphere.
    radius = prepared.diagonal / 2
    f = 10 * 0.96 * large / 2
    camera = Camera(large, large, f, f, (large - 1) / 2, (large - 1) / 2)
    T_cam_obj = _front_view(prepared, axis, 10 * radius)
    placed = [PlacedMesh(1, prepared, T_cam_obj)]
    drawn = compose(RaycastRenderer(threads=1), camera, placed, canvas=1)
    _, normals = surface_maps(camera, placed, drawn)
    picture = _shaded(normals, drawn.depth > 0)
    return np.asarray(cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA), np.uint8)


def cached_thumbnail(
    root: Path, mesh: trimesh.Trimesh | RenderMesh, size: int, axis: int = 2
) -> NDArray[np.uint8]:
    """`thumbnail`, kept in the scene folder under the mesh's digest if that can be written."""
    prepared = prepare_mesh(mesh)
    # With the look in its name: what an earlier version drew is not shown.
    path = root / _FOLDER / f"{prepared.digest[:24]}-{size}-{'xyz'[axis]}-grey.png"
    if path.is_file():
        try:
            return read_color(path, size=(size, size))
        except ToolkitError:  # damaged, or of an earlier version: drawn anew
            pass
    picture = thumbnail(prepared, size, axis)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_color(path, picture)
    except (OSError, ToolkitError):
        # A folder that may only be read is no reason to show no pictures.
        pass
    return picture


def _front_view(mesh: RenderMesh, axis: int, distance: float) -> SE3:
    R = front_rotation(axis)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = mesh.centre + (low + high) / 2
    return SE3(R, np.array([0.0, 0.0, distance]) - R @ middle)


def _shaded(normals: NDArray[np.floating], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Light from the upper left, and a little from everywhere."""
    n = np.asarray(normals, dtype=np.float64)
    # Scans have faces wound either way; seen from outside, a normal points to the eye.
    n = n * np.where(n[..., 2:] > 0, -1.0, 1.0)
    light = np.array([-0.45, -0.65, -0.62])
    bright = 0.30 + 0.70 * np.clip(n @ (light / np.linalg.norm(light)), 0, 1)
    shine = np.clip(-n[..., 2], 0, 1) ** 24 * 0.10
    picture = bright[..., None] * np.array(CLAY) + 255 * shine[..., None]
    shaded = np.where(mask[..., None], np.clip(picture, 0, 255), np.array(PAPER))
    return np.asarray(shaded, np.uint8)
