"""Meshes of foreign layouts become mesh files of the scene, in metres."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.geometry.mesh import check_mesh_size, mesh_diameter, mesh_extents
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, Model, SymmetryModel

if TYPE_CHECKING:
    import trimesh


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write a mesh in metres; the suffix (.ply or .glb) chooses the format.

    Raises:
        ToolkitError: its size is implausible in metres.
    """
    check_mesh_size(mesh, path=path)
    data = mesh.export(file_type=path.suffix.lower().lstrip("."))
    assert isinstance(data, bytes)  # both formats are binary
    write_bytes_atomic(path, data)


def mesh_suffix(mesh: trimesh.Trimesh) -> str:
    """ ".glb" for a mesh with a texture, which PLY cannot hold; else ".ply"."""
    material = getattr(mesh.visual, "material", None)
    pictures = (getattr(material, key, None) for key in ("image", "baseColorTexture"))
    return ".glb" if any(picture is not None for picture in pictures) else ".ply"


def model_of_mesh(
    mesh: trimesh.Trimesh,
    *,
    model_id: str,
    category: str,
    symmetry: SymmetryModel | None = None,
    class_id: int | None = None,
    suffix: str = ".ply",
) -> Model:
    """The table row of a mesh in metres."""
    return Model(
        id=model_id,
        mesh=f"models/{model_id}/{model_id}{suffix}",
        category=category,
        class_id=CATEGORY_CLASS_IDS.get(category, 0) if class_id is None else class_id,
        size_m=[float(x) for x in mesh_extents(mesh)],
        diameter_m=mesh_diameter(mesh),
        symmetry=symmetry or SymmetryModel(),
    )
