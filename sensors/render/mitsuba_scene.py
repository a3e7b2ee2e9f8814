"""A scene in Mitsuba's terms: meshes, scattering, the environment.

There are two kinds of surface code only, one opaque and one of glass, with every number a
parameter: Mitsuba compiles a kernel per kind of code, and scenes of any materials then share it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sensors.materials.draw import DrawnMaterial
from sensors.render.appearance import appearance, infrared_appearance
from sensors.render.scene import SceneObject, SimScene

_SMOOTHEST = 2e-3
"""Smallest roughness; a perfect mirror would be another kind of code."""


@dataclass(eq=False)
class Shapes:
    """Mitsuba scenes of a scene's surfaces, without light.

    Attributes:
        everything: all of them.
        opaque, glass: those that stop shadow rays, and those that let a share pass; None where
            there are none.
    """

    everything: Any
    opaque: Any
    glass: Any


def build(mi: Any, scene: SimScene, *, infrared: bool = False) -> Shapes:
    """The surfaces, in colour or in infrared, for the active variant of the module `mi`."""
    meshes = [_mesh(mi, item, f"object{i}", infrared) for i, item in enumerate(scene.objects)]
    clear = [item.material.glass is not None for item in scene.objects]
    return Shapes(
        _group(mi, meshes),
        _group(mi, [m for m, c in zip(meshes, clear, strict=True) if not c]),
        _group(mi, [m for m, c in zip(meshes, clear, strict=True) if c]),
    )


def _group(mi: Any, meshes: list[Any]) -> Any:
    if not meshes:
        return None
    parts = {f"object{i}": mesh for i, mesh in enumerate(meshes)}
    # Merging shapes of equal material would only cost time here.
    return mi.load_dict({"type": "scene", **parts}, optimize=False)


def _mesh(mi: Any, item: SceneObject, name: str, infrared: bool) -> Any:
    prepared = item.mesh.prepared
    look = appearance(item)
    if infrared:
        look = infrared_appearance(look, item.material)
    R, T = item.T_world_obj.R, item.T_world_obj
    # Corners are not shared: creases and texture seams give them different normals and
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
    # Mitsuba's v runs along the rows of an image, ours upwards.
    uv = look.uv.reshape(-1, 2) * np.array([1, -1]) + np.array([0, 1])
    parameters["vertex_positions"] = np.ascontiguousarray(corners, np.float32).ravel()
    parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    parameters["vertex_texcoords"] = np.ascontiguousarray(uv, np.float32).ravel()
    parameters["faces"] = np.arange(count, dtype=np.uint32)
    parameters.update()
    return mesh


def _scattering(mi: Any, material: DrawnMaterial, image: np.ndarray) -> dict[str, Any]:
    glass = material.glass
    if glass is None:
        # A value of exactly 0 would leave a part out and make another kind of code.
        values = {
            name: max(float(getattr(material, name)), 1e-3)
            for name in (
                "metallic",
                "roughness",
                "spec_tint",
                "anisotropic",
                "sheen",
                "sheen_tint",
                "clearcoat",
                "clearcoat_gloss",
            )
        }
        opaque = {
            "type": "principled",
            "base_color": _bitmap(mi, image),
            "specular": float(np.clip(material.specular, 1e-3, 0.999)),
            **values,
        }
        return {"type": "twosided", "surface": opaque}
    # Light through the mask stays straight: the projector reaches what lies behind only so.
    tint = {"type": "rgb", "value": list(material.color)}
    return {
        "type": "mask",
        "opacity": 1.0 - glass.see_through,
        "surface": {
            "type": "blendbsdf",
            "weight": glass.gloss,
            "refracting": {
                "type": "roughdielectric",
                "distribution": "ggx",
                "alpha": max(glass.roughness**2, _SMOOTHEST),
                "int_ior": glass.ior,
                "specular_transmittance": tint,
            },
            "glossy": {
                "type": "roughconductor",
                "distribution": "ggx",
                "material": "none",
                "alpha": max(glass.gloss_roughness**2, _SMOOTHEST),
            },
        },
    }


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
    # Its own up is y.
    return mi.load_dict(
        {
            "type": "envmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(scene.environment.pixels)),
            "to_world": turn @ mi.ScalarTransform4f().rotate([1, 0, 0], 90),
        }
    )
