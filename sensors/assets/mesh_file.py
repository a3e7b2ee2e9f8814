"""Read a mesh file as an asset: vertices, colours, texture and rotational symmetry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from sensors.assets import asset
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES, OTHER_MESHES, UNITS_IN_M, check_mesh_size
from std_toolkit.geometry.obj_files import FilesBeside
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.log import logger

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

_PLAIN = (180, 180, 180)

_SAMPLES = 2000

# Squares and cubes of coordinates must stay far from where numbers end, in any unit.
_FARTHEST = 1e9

# Largest distance between a rotated surface and the original, as a fraction of the diagonal; one
# point in a hundred may be further away. A faceted cylinder of 16 sides deviates from the round one
# by 2 % of its radius.
_TOLERANCE = 0.012


@dataclass(frozen=True)
class SurfaceColors:
    """Colours and texture of a mesh file; see `Asset`."""

    face_colors: NDArray[np.uint8]
    corner_uv: NDArray[np.float32] | None
    texture: NDArray[np.uint8] | None


def read_asset(
    path: Path,
    *,
    asset_id: str,
    category: str,
    unit: str | None = None,
    symmetry: Symmetry | None = None,
    up: str = "y",
) -> asset.Asset:
    """Read a mesh file as an asset.

    A surface that is not closed is used, with a warning: its volume is not defined.

    Args:
        unit: unit of the file's coordinates, which then give the asset its real size; None if
            they have no unit, as in ShapeNet.
        symmetry: None to detect whether the shape is symmetric under rotations about y.
        up: the file's vertical axis, "y" or "z".

    Raises:
        ToolkitError: unreadable, without faces, vertices that are not finite, or, with a unit, a
            size outside the range of objects on a table.
    """
    import trimesh

    parts = _read(path)
    vertices, faces = _joined(parts)
    if len(faces) == 0:
        raise ToolkitError("the mesh holds no faces", path=path)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ToolkitError(
            "the mesh has faces of vertices that do not exist", path=path, value=int(faces.max())
        )
    if not np.isfinite(vertices).all():
        raise ToolkitError("the mesh holds vertices that are not finite", path=path)
    if np.abs(vertices).max() > _FARTHEST:
        raise ToolkitError(
            "the mesh holds vertices implausibly far away", path=path,
            value=float(np.abs(vertices).max()),
        )  # fmt: skip
    if up == "z":
        vertices = vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    try:
        canonical, diagonal = asset.canonical_frame(vertices, faces)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, field=error.field) from error
    diagonal_m = None
    if unit is not None:
        diagonal_m = diagonal * UNITS_IN_M[unit]
        check_mesh_size(trimesh.Trimesh(canonical * diagonal_m, faces, process=False), path=path)
    look = _surface_colors(parts)
    # Vertices duplicated at texture seams are one point of the surface.
    places, corners, kept = asset.welded(canonical, faces)
    mesh = trimesh.Trimesh(places, corners, process=False)
    if not mesh.is_watertight:
        logger.warning("%s: the surface is not closed; its volume is a guess", path)
    return asset.Asset(
        id=asset_id,
        category=category,
        mesh=mesh,
        symmetry=turn_symmetry(places, corners) if symmetry is None else symmetry,
        face_colors=look.face_colors[kept],
        corner_uv=None if look.corner_uv is None else look.corner_uv[kept],
        texture=look.texture,
        diagonal_m=diagonal_m,
    )


def _read(path: Path) -> list[trimesh.Trimesh]:
    import trimesh

    if not path.is_file():
        raise ToolkitError("mesh file not found", path=path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ToolkitError("not a mesh format", path=path, value=path.suffix, hint=OTHER_MESHES)
    try:
        beside = cast("Any", FilesBeside(path.parent))
        loaded = trimesh.load(path, process=False, maintain_order=True, resolver=beside)
        found = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    except Exception as error:  # trimesh's parsers raise whatever their file makes them raise
        raise ToolkitError(f"cannot read the mesh: {error}", path=path) from error
    return [m for m in found if isinstance(m, trimesh.Trimesh) and len(m.faces)]


def _joined(parts: list[trimesh.Trimesh]) -> tuple[Array, NDArray[np.int64]]:
    if not parts:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0, *(len(m.vertices) for m in parts[:-1])])
    vertices = np.concatenate([np.asarray(m.vertices, dtype=np.float64) for m in parts])
    faces = [np.asarray(m.faces, np.int64) + s for m, s in zip(parts, starts, strict=True)]
    return vertices, np.concatenate(faces)


def _surface_colors(parts: list[trimesh.Trimesh]) -> SurfaceColors:
    """Colours of all faces; also the texture, if one image covers all of them."""
    pictures = [_picture(m) for m in parts]
    uvs = [_uv(m) for m in parts]
    colors = [_colors(m, p, uv) for m, p, uv in zip(parts, pictures, uvs, strict=True)]
    first = pictures[0]
    one = first is not None and all(
        p is not None and uv is not None and (p is first or np.array_equal(p, first))
        for p, uv in zip(pictures, uvs, strict=True)
    )
    if not one:
        return SurfaceColors(np.concatenate(colors), None, None)
    uv = np.concatenate([u for u in uvs if u is not None]).astype(np.float32)
    return SurfaceColors(np.concatenate(colors), uv, first)


def _picture(mesh: trimesh.Trimesh) -> NDArray[np.uint8] | None:
    material = getattr(mesh.visual, "material", None)
    image: Any = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is None:
        return None
    try:
        return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except Exception as error:  # a broken picture must not cost the shape
        logger.warning("a texture cannot be read: %s", error)
        return None


def _uv(mesh: trimesh.Trimesh) -> Array | None:
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or len(uv) != len(mesh.vertices) or not np.isfinite(uv).all():
        return None
    return np.asarray(uv, dtype=np.float64)[mesh.faces]


def _colors(
    mesh: trimesh.Trimesh, picture: NDArray[np.uint8] | None, uv: Array | None
) -> NDArray[np.uint8]:
    count = len(mesh.faces)
    visual: Any = mesh.visual
    if picture is not None and uv is not None:
        u, v = np.moveaxis(uv.mean(axis=1) % 1, -1, 0)
        height, width = picture.shape[:2]
        column = np.minimum((u * width).astype(int), width - 1)
        row = np.minimum(((1 - v) * height).astype(int), height - 1)
        return picture[row, column]
    if visual.kind in ("face", "vertex"):
        return np.asarray(visual.face_colors[:, :3], dtype=np.uint8)
    material = getattr(visual, "material", None)
    color = getattr(material, "main_color", None) if material is not None else None
    rgb = _PLAIN if color is None or visual.kind is None else color[:3]
    return np.tile(np.asarray(rgb, dtype=np.uint8), (count, 1))


# Fractions of a full rotation after which no regular polygon below 17 corners repeats.
_ANGLES = tuple(2 * np.pi * x for x in (0.093, 0.269, 0.41))


def turn_symmetry(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> Symmetry:
    """Full rotational symmetry about y, if the shape has it; colours are ignored.

    Args:
        vertices: (V, 3) canonical.
        faces: (F, 3).
    """
    points = asset.surface_points(np.asarray(vertices, np.float64), faces, _SAMPLES)
    if len(points) == 0:
        return asset.NO_SYMMETRY
    caster = RayCaster(vertices, faces)
    for angle in _ANGLES:
        c, s = np.cos(angle), np.sin(angle)
        turned = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
        if np.quantile(caster.distance(turned), 0.99) > _TOLERANCE:
            return asset.NO_SYMMETRY
    return asset.TURN_Y
