"""What stands on a turntable: the mesh with its material, and the printed board below it."""

from typing import Any

import numpy as np

from sensors.materials.material_draw import DrawnMaterial, plain_look
from sensors.render.sim_scene import SceneObject, SurfaceMesh
from sensors.simulation.options import TurntableOptions
from sensors.simulation.world_builder import palette_surface
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.poses.board_sheet import BoardSheet

OBJECT_ID = 1

# The sheet lies on the table and the object on the sheet, with gaps that no photo shows: surfaces
# in one place would flicker.
GAP_M = 1e-4

# One object fills the photo: texture on it is as fine as the photo's pixels.
_LARGEST_TEXTURE = 4096


def standing_pose(mesh: Any, options: TurntableOptions) -> SE3:
    """T_world_obj of the mesh on the middle of the board."""
    to_z = {
        "x": so3_exp(np.array([0, -np.pi / 2, 0])),
        "y": so3_exp(np.array([np.pi / 2, 0, 0])),
        "z": np.eye(3),
    }
    R = to_z[options.up]
    if options.flipped:
        R = so3_exp(np.array([np.pi, 0, 0])) @ R
    turned = mesh.copy()
    turned.vertices = mesh.vertices @ R.T
    low, high = mesh_bounds(turned)
    middle = (low + high) / 2
    return SE3(R, np.array([-middle[0], -middle[1], GAP_M - low[2]]))


def turntable_material(options: TurntableOptions) -> DrawnMaterial:
    """The material that the options ask for."""
    if options.material == "own":
        return _own_look(roughness=0.6, specular=0.25)
    return plain_look("matt" if options.material == "sprayed" else options.material, options.seed)


def _own_look(*, roughness: float, specular: float) -> DrawnMaterial:
    """A material that shows the colours of the object."""
    return DrawnMaterial(
        name="raw",
        material_class="raw",
        color=(0.5, 0.5, 0.5),
        own_share=1.0,
        roughness=roughness,
        specular=specular,
    )


def mesh_object(mesh: Any, material: DrawnMaterial, T_world_obj: SE3) -> SceneObject:
    """The mesh with its own texture or colours."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    look = SurfaceColors.from_mesh(mesh, largest=None)
    texture = None
    if look is None:
        surface = SurfaceMesh(vertices, faces)
    elif look.texture is None:
        colors = np.rint(look.corners.mean(axis=1)).astype(np.uint8)
        surface, texture = palette_surface(vertices, faces, colors)
    else:
        texture = look.texture.astype(np.uint8)
        # A corner each: at seams, one vertex has several coordinates.
        each = np.arange(faces.size).reshape(-1, 3)
        uv = look.corners.reshape(-1, 2).astype(np.float64)
        surface = SurfaceMesh(vertices[faces].reshape(-1, 3), each, uv)
    return SceneObject(
        OBJECT_ID,
        surface,
        T_world_obj,
        material,
        texture=texture,
        color=(0.5, 0.5, 0.5),
        largest_texture=_LARGEST_TEXTURE,
    )


def sheet_objects(sheet: BoardSheet) -> tuple[SceneObject, SceneObject]:
    """Paper, and the black cells on it as surfaces: an image would blur their edges."""
    width, height = sheet.paper_mm
    parts = []
    for number, level, rectangles, shade in (
        (2, -GAP_M / 2, [(-width / 2, -height / 2, width, height)], 0.82),
        (3, -GAP_M / 4, sheet.cells(), 0.015),
    ):
        corners = [
            [[x, y, 0], [x + w, y, 0], [x + w, y + h, 0], [x, y + h, 0]]
            for x, y, w, h in rectangles
        ]
        first = 4 * np.arange(len(corners))[:, None]
        parts.append(
            SceneObject(
                number,
                SurfaceMesh(
                    np.asarray(corners, np.float64).reshape(-1, 3) / 1000,
                    (first[:, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
                ),
                SE3(np.eye(3), np.array([0, 0, level])),
                # Ink is not black and paper not white.
                _own_look(roughness=0.8, specular=0.2),
                color=(shade, shade, shade),
            )
        )
    return parts[0], parts[1]
