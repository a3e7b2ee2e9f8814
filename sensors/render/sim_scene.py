"""A scene to render, and the exact maps of its views: depth, instances, NOCS, normals."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sensors.lighting.environment import EnvironmentMap
from sensors.materials.material_draw import DrawnMaterial
from std_toolkit.arrays import Floats
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.maps import Composition, compose, mask_of, surface_maps
from std_toolkit.rendering.mesh import RenderMesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import PlacedMesh


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """A triangle mesh, with texture coordinates if it has a texture of its own.

    Attributes:
        vertices: (V, 3) metres, in the object's frame.
        faces: (F, 3) vertex indices, counter-clockwise seen from outside.
        uv: (V, 2) texture coordinates, v upwards (as in OBJ files), or None.

    Raises:
        ToolkitError: an empty mesh, invalid indices, numbers that are not finite, or texture
            coordinates that do not match the vertices.
    """

    vertices: NDArray[np.floating]
    faces: NDArray[np.integer]
    uv: NDArray[np.floating] | None = None

    def __post_init__(self) -> None:
        if self.uv is not None and np.shape(self.uv) != (len(self.vertices), 2):
            raise ToolkitError(
                f"needs one pair per vertex, {len(self.vertices)} of them",
                field="uv",
                value=np.shape(self.uv),
            )
        _ = self.prepared  # checks the rest

    @cached_property
    def prepared(self) -> RenderMesh:
        """The form that the exact ray caster accepts."""
        return RenderMesh.from_arrays(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object in the scene.

    Attributes:
        instance_id: 1..254, as in the instance mask; 0 is background (floor, walls).
        mesh: its surface in metres. Objects may share one mesh.
        T_world_obj: maps mesh coordinates into the world.
        material: drawn numbers; `own_share` is the fraction of the next two.
        texture: (h, w, 3) uint8 sRGB image on `mesh.uv`, or None.
        color: the object's own linear RGB without a texture.
        texture_tile_m: for a texture without `mesh.uv`: extent of one repetition in metres.
        face_parts: (F,) number of the part that each face belongs to, 0 for the body; None: there
            are no other parts.
        largest_texture: longer side in pixels to which a larger texture is reduced. In a scene of
            many objects, each covers a few hundred pixels.
        part_materials: of the parts 1, 2, ...: caps and labels of glass bottles, for example.
    """

    instance_id: int
    mesh: SurfaceMesh
    T_world_obj: SE3
    material: DrawnMaterial
    texture: NDArray[np.uint8] | None = None
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    texture_tile_m: float = 1.0
    face_parts: NDArray[np.integer] | None = None
    part_materials: tuple[DrawnMaterial, ...] = ()
    largest_texture: int = 1024

    def __post_init__(self) -> None:
        if not 0 <= self.instance_id <= 254:
            raise ToolkitError("must lie in 0..254", field="instance_id", value=self.instance_id)
        t = self.texture
        if t is not None and (t.ndim != 3 or t.shape[2] != 3 or t.dtype != np.uint8):
            raise ToolkitError(
                "a texture is an (h, w, 3) image of uint8", field="texture", value=t.shape
            )
        parts = self.face_parts
        if parts is not None and (
            parts.shape != (len(self.mesh.faces),) or parts.max() > len(self.part_materials)
        ):
            raise ToolkitError(
                "needs one number per face, and a material of each",
                field="face_parts",
                value=parts.shape,
            )

    def surfaces(self) -> list[SceneObject]:
        """The object divided by its parts, each of one material."""
        if self.face_parts is None:
            return [self]
        materials = (self.material, *self.part_materials)
        return [
            replace(
                self,
                mesh=replace(self.mesh, faces=self.mesh.faces[self.face_parts == i]),
                material=materials[i],
                face_parts=None,
                part_materials=(),
            )
            for i in np.unique(self.face_parts)
        ]


@dataclass(frozen=True, eq=False)
class SimScene:
    """A static scene. World frame: z up, metres.

    Attributes:
        objects: with distinct ids above 0.
        environment: environment light.
        environment_rotation_rad: rotation of it about the world's z axis.
        contents: surfaces inside closed objects, liquids for example: seen through glass, but in
            no exact map.
    """

    objects: tuple[SceneObject, ...]
    environment: EnvironmentMap
    environment_rotation_rad: float = 0.0
    contents: tuple[SceneObject, ...] = ()

    def __post_init__(self) -> None:
        ids = [o.instance_id for o in self.objects if o.instance_id]
        if len(set(ids)) != len(ids):
            raise ToolkitError("instance ids must differ", field="instance_id", value=ids)
        if not self.objects:
            raise ToolkitError("a scene needs at least one object", field="objects")


@dataclass(frozen=True, eq=False)
class Projector:
    """A point light that projects an image (a perspective image of the dot pattern).

    Attributes:
        pattern: (h, w) float or uint8 relative power; row 0 is up, column 0 left, seen along
            its axis. Nothing is lit outside it.
        fov_x_deg: full angle between the image's left and right edges; pixels are square.
        T_world_projector: OpenCV axes: z along the axis, x right, y down.
        power: irradiance in W/m^2 on a surface that faces it at 1 m, where the pattern is 1.
    """

    pattern: NDArray[np.generic]
    fov_x_deg: float
    T_world_projector: SE3 = field(default_factory=SE3.identity)
    power: float = 1.0

    def __post_init__(self) -> None:
        if self.pattern.ndim != 2 or min(self.pattern.shape) < 2:
            raise ToolkitError(
                "a pattern is one grey image", field="pattern", value=self.pattern.shape
            )
        if not 1 <= self.fov_x_deg <= 170:
            raise ToolkitError("must lie in 1..170", field="fov_x_deg", value=self.fov_x_deg)

    @cached_property
    def image(self) -> Floats:
        """(h, w) float32 in 0..1."""
        scale = 255 if self.pattern.dtype == np.uint8 else 1
        return np.ascontiguousarray(self.pattern, np.float32) / np.float32(scale)

    @property
    def tan_half(self) -> tuple[float, float]:
        """Tangents of the half angles, horizontal and vertical."""
        half = float(np.tan(np.deg2rad(self.fov_x_deg) / 2))
        h, w = self.pattern.shape
        return half, half * h / w


@dataclass(frozen=True, eq=False)
class TruthMaps:
    """Ground truth at the camera's pixel centres.

    Attributes:
        depth: (H, W) float32 z-depth in metres of the first surface, glass and floor included;
            0 where there is none.
        mask: (H, W) uint8 instance id, 0 on the background.
        nocs: (H, W, 3) float32 in 0..1 on instances, else 0.
        normals: (H, W, 3) float32 camera frame, towards the camera; 0 where there is no surface.
    """

    depth: Floats
    mask: NDArray[np.uint8]
    nocs: Floats
    normals: Floats


class TruthCaster:
    """Exact maps of one scene from any view; keeps the meshes' acceleration structures.

    Args:
        scene: the scene to cast.
        threads: per cast; 0 uses all.
    """

    def __init__(self, scene: SimScene, *, threads: int = 1) -> None:
        self._objects = scene.objects
        self._renderer = RaycastRenderer(threads=threads)

    def maps(self, camera: Camera, T_world_cam: SE3) -> TruthMaps:
        """Exact maps of a view; lens distortion is supported."""
        placed, composition, mask = self._seen(camera, T_world_cam)
        nocs, normals = surface_maps(camera, placed, composition)
        nocs[mask == 0] = 0
        return TruthMaps(composition.depth, mask, nocs, normals)

    def depth_and_mask(self, camera: Camera, T_world_cam: SE3) -> tuple[Floats, NDArray[np.uint8]]:
        """The depth and the mask of `maps` alone."""
        _, composition, mask = self._seen(camera, T_world_cam)
        return composition.depth, mask

    def _seen(
        self, camera: Camera, T_world_cam: SE3
    ) -> tuple[list[PlacedMesh], Composition, NDArray[np.uint8]]:
        T_cam_world = T_world_cam.inverse()
        placed = [
            PlacedMesh(o.instance_id, o.mesh.prepared, T_cam_world @ o.T_world_obj)
            for o in self._objects
        ]
        composition = compose(self._renderer, camera, placed)
        return (
            placed,
            composition,
            mask_of(composition.index, [o.instance_id for o in self._objects]),
        )
