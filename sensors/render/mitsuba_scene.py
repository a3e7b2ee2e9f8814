"""A scene in Mitsuba's form: meshes, scattering, textures, the environment.

There is only one kind of opaque surface code, with every number a parameter: Mitsuba compiles a
kernel per kind, and scenes of any materials share it. Glass is the path tracer's (`render.glass`);
the variant without a compiler gets a mixture of Mitsuba's own that comes near.

The material and the object's own texture are mixed once into one base-colour image, so that a
renderer needs a single texture per object. In infrared the same image has other grey levels: dyes
that absorb visible light hardly absorb at 850 nm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.lighting.environment import LUMINANCE
from sensors.materials.material_draw import DrawnMaterial
from sensors.materials.textures import make_texture, to_linear, to_srgb
from sensors.render.sim_scene import SceneObject, SimScene, SurfaceMesh

_SMOOTHEST = 2e-3
"""Smallest roughness; a perfect mirror would need another kind of code."""

_VALUES = (
    "metallic",
    "roughness",
    "spec_tint",
    "anisotropic",
    "sheen",
    "sheen_tint",
    "clearcoat",
    "clearcoat_gloss",
)


@dataclass(eq=False)
class Shapes:
    """Mitsuba scenes of a scene's surfaces, without light.

    Attributes:
        everything: all of them.
        opaque, glass: surfaces that block shadow rays, and those that pass a fraction; None if
            there are none.
    """

    everything: Any
    opaque: Any
    glass: Any


def build(
    mi: Any, scene: SimScene, *, infrared: bool = False
) -> tuple[Shapes, list[tuple[Any, SceneObject]]]:
    """The surfaces, in colour or in infrared, for the active variant of the module `mi`.

    Returns:
        Mitsuba's scenes, and each mesh with the object or the part of one that it is.
    """
    items = [part for item in (*scene.objects, *scene.contents) for part in item.surfaces()]
    meshes = [_mesh(mi, item, f"object{i}", infrared) for i, item in enumerate(items)]
    clear = [item.material.glass is not None for item in items]
    shapes = Shapes(
        _group(mi, meshes),
        _group(mi, [m for m, c in zip(meshes, clear, strict=True) if not c]),
        _group(mi, [m for m, c in zip(meshes, clear, strict=True) if c]),
    )
    return shapes, list(zip(meshes, items, strict=True))


def _group(mi: Any, meshes: list[Any]) -> Any:
    if not meshes:
        return None
    parts = {f"object{i}": mesh for i, mesh in enumerate(meshes)}
    # Merging shapes with equal material would only cost time here.
    return mi.load_dict({"type": "scene", **parts}, optimize=False)


def _mesh(mi: Any, item: SceneObject, name: str, infrared: bool) -> Any:
    prepared = item.mesh.prepared
    look = appearance(item)
    if infrared:
        look = infrared_appearance(look, item.material)
    R, T = item.T_world_obj.R, item.T_world_obj
    # Corners are not shared: at creases and texture seams they have different normals and
    # coordinates.
    corners = T @ (prepared.vertices[prepared.faces].reshape(-1, 3) + prepared.centre)
    normals = prepared.corner_normals.reshape(-1, 3) @ R.T
    count = len(corners)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_scattering(mi, item.material, look.image))
    mesh = mi.Mesh(
        name,
        vertex_count=count,
        face_count=count // 3,
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(corners, np.float32).ravel()
    parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    parameters["vertex_texcoords"] = _texcoords(look)
    parameters["faces"] = np.arange(count, dtype=np.uint32)
    parameters.update()
    return mesh


def repaint(mi: Any, mesh: Any, item: SceneObject, *, infrared: bool) -> None:
    """Give a mesh of `build` another opaque material, without new code for a kernel."""
    look = appearance(item)
    if infrared:
        look = infrared_appearance(look, item.material)
    parameters = mi.traverse(mesh)
    parameters["vertex_texcoords"] = _texcoords(look)
    for name, value in opaque_values(item.material).items():
        key = f"bsdf.brdf_0.{name}"
        parameters[key if key in parameters else f"{key}.value"] = value
    image = mi.Bitmap(np.ascontiguousarray(look.image))
    texture = mi.load_dict({"type": "bitmap", "bitmap": image})
    parameters["bsdf.brdf_0.base_color.data"] = mi.traverse(texture)["data"]
    parameters.update()


def _texcoords(look: Appearance) -> NDArray[np.float32]:
    # Mitsuba's v runs along the rows of an image, ours upwards.
    uv = look.uv.reshape(-1, 2) * np.array([1, -1]) + np.array([0, 1])
    return np.ascontiguousarray(uv, np.float32).ravel()


def opaque_values(material: DrawnMaterial) -> dict[str, float]:
    """Parameters of Mitsuba's BSDF. A value of exactly 0 would create another kind of code."""
    values = {name: max(float(getattr(material, name)), 1e-3) for name in _VALUES}
    return {**values, "specular": float(np.clip(material.specular, 1e-3, 0.999))}


def _scattering(mi: Any, material: DrawnMaterial, image: np.ndarray) -> dict[str, Any]:
    glass = material.glass
    if glass is None:
        opaque = {
            "type": "principled",
            "base_color": _bitmap(mi, image),
            **opaque_values(material),
        }
        return {"type": "twosided", "surface": opaque}
    if mi.variant().startswith("scalar"):
        # Light through the mask is not refracted; only so can the projector reach surfaces behind.
        facing = ((glass.ior - 1) / (glass.ior + 1)) ** 2
        passed = glass.transmission**0.25 * (1 - facing)
        return {
            "type": "mask",
            "opacity": 1.0 - passed,
            "surface": {
                "type": "roughdielectric",
                "distribution": "ggx",
                "alpha": max(glass.roughness**2, _SMOOTHEST),
                "int_ior": glass.ior,
                "specular_transmittance": {"type": "rgb", "value": list(material.color)},
            },
        }
    return {"type": "null"}


def _bitmap(mi: Any, image: np.ndarray) -> dict[str, Any]:
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(image)),
        "wrap_mode": "repeat",
        "filter_type": "bilinear",
    }


def environment(mi: Any, scene: SimScene) -> Any:
    """The scene's environment as an emitter of strength 1."""
    turn = mi.ScalarTransform4f().rotate([0, 0, 1], np.rad2deg(scene.environment_rotation_rad))
    # Mitsuba's environment has y up.
    return mi.load_dict(
        {
            "type": "envmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(scene.environment.pixels)),
            "to_world": turn @ mi.ScalarTransform4f().rotate([1, 0, 0], 90),
        }
    )


INFRARED_RANGE = (0.02, 0.98)


"""Limits of the reflectance of any point: black rubber, and silver."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """Corners of triangles with their colours.

    Attributes:
        uv: (F, 3, 2) float32 texture coordinates of the corners, v upwards.
        image: (h, w, 3) uint8 sRGB; repeats beyond 0..1.
    """

    uv: NDArray[np.float32]
    image: NDArray[np.uint8]


def appearance(item: SceneObject) -> Appearance:
    """Mix an object's own texture or colour with its material's by `own_share`."""
    material, share = item.material, item.material.own_share
    if material.texture is None:
        tile = _flat(np.asarray(material.color))
        tile_m = 1.0
    else:
        tile = make_texture(material.texture, material.color)
        tile_m = material.texture.tile_m
    if item.texture is None or share == 0:
        own = np.asarray(item.color, np.float32)
        mixed = tile if share == 0 else to_srgb(share * own + (1 - share) * to_linear(tile))
        return Appearance(box_uv(item.mesh) / np.float32(tile_m), mixed)
    own_image = _reduced(item.texture, item.largest_texture)
    if item.mesh.uv is None:
        mixed = _mix(own_image, tile, share, item.texture_tile_m / tile_m)
        return Appearance(box_uv(item.mesh) / np.float32(item.texture_tile_m), mixed)
    uv = np.asarray(item.mesh.uv, np.float32)[item.mesh.faces]
    # A UV-mapped surface covers the image about once; its metric scale is that of the mesh.
    mixed = _mix(own_image, tile, share, item.mesh.prepared.diagonal / tile_m)
    return Appearance(uv, mixed)


def infrared_appearance(look: Appearance, material: DrawnMaterial) -> Appearance:
    """The same surface at 850 nm: at the material's infrared reflectance, with less contrast.

    Args:
        look: appearance in visible light.
        material: of the object; without an infrared value the look is returned unchanged.
    """
    if material.infrared is None:
        return look
    share = material.own_share
    mean = share * material.own_infrared + (1 - share) * material.infrared
    seen = to_linear(look.image) @ LUMINANCE
    pattern = seen / max(float(seen.mean()), 1e-3) - 1
    light = np.clip(mean * (1 + material.infrared_pattern * pattern), *INFRARED_RANGE)
    return Appearance(look.uv, to_srgb(np.repeat(light[..., None], 3, axis=-1)))


def box_uv(mesh: SurfaceMesh) -> NDArray[np.float32]:
    """(F, 3, 2) coordinates in metres: every triangle projected along its normal's largest axis."""
    prepared = mesh.prepared
    axis = np.argmax(np.abs(prepared.face_normals), axis=1)
    # Along x the other two are y, z; along y they are x, z; along z they are x, y.
    across = np.array([1, 0, 0])[axis]
    up = np.array([2, 2, 1])[axis]
    corners = prepared.vertices[prepared.faces]
    rows = np.arange(len(corners))
    u = corners[rows, :, across]
    v = corners[rows, :, up]
    return np.stack([u, v], axis=-1).astype(np.float32)


def _mix(
    own: NDArray[np.uint8], tile: NDArray[np.uint8], share: float, repeats: float
) -> NDArray[np.uint8]:
    """The object's own image mixed with a tile that repeats a whole number of times across it."""
    height, width = own.shape[:2]
    count = int(np.clip(round(repeats), 1, 32))
    small = cv2.resize(
        tile,
        (max(1, width // count), max(1, height // count)),
        interpolation=cv2.INTER_AREA if len(tile) > height // count else cv2.INTER_LINEAR,
    )
    tiled = np.tile(small, (height // len(small) + 1, width // small.shape[1] + 1, 1))
    material = to_linear(np.asarray(tiled[:height, :width], np.uint8))
    return to_srgb(share * to_linear(own) + (1 - share) * material)


def _flat(color: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.broadcast_to(to_srgb(color), (4, 4, 3)).copy()


def _reduced(image: NDArray[np.uint8], largest: int) -> NDArray[np.uint8]:
    scale = largest / max(image.shape[:2])
    if scale >= 1:
        return image
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
