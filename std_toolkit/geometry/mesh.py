"""Meshes in metres, refused when they are evidently in another unit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    import trimesh

MESH_SUFFIXES = (".obj", ".ply", ".glb", ".gltf", ".stl", ".off")
# What a person can put on a table: 3 mm to 3 m. A mug in millimetres is 100 "metres" high,
# a mug in metres taken for millimetres 0.1 mm.
SMALLEST_EXTENT_M = 0.003
LARGEST_EXTENT_M = 3.0
UNITS_IN_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def load_mesh(path: Path | str, *, unit: str = "m") -> trimesh.Trimesh:
    """Read a mesh as one `trimesh.Trimesh`, vertices in metres, vertex order kept.

    Args:
        path: OBJ, PLY, GLB, STL or OFF file.
        unit: unit of the file, "m", "cm" or "mm".

    Raises:
        ToolkitError: unreadable, without faces, with vertices that are not finite, or with a size
            that no table-top object has (the mark of a wrong unit).
    """
    import trimesh

    path = Path(path)
    if unit not in UNITS_IN_M:
        raise ToolkitError("unknown unit", path=path, value=unit, hint="one of m, cm, mm")
    if not path.is_file():
        raise ToolkitError("mesh file not found", path=path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ToolkitError(
            "not a mesh format", path=path, value=path.suffix, hint=f"one of {MESH_SUFFIXES}"
        )
    try:
        loaded = trimesh.load(path, process=False, maintain_order=True)
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    except Exception as error:  # trimesh's parsers raise whatever their file makes them raise
        raise ToolkitError(f"cannot read the mesh: {error}", path=path) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ToolkitError("the mesh holds no faces", path=path)
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise ToolkitError(
            "the mesh has faces of vertices that do not exist",
            path=path,
            value=int(mesh.faces.max()),
        )
    if not np.isfinite(mesh.vertices).all():
        raise ToolkitError("the mesh holds vertices that are not finite", path=path)
    if unit != "m":
        mesh.apply_scale(UNITS_IN_M[unit])
    check_mesh_size(mesh, path=path)
    return mesh


def check_mesh_size(mesh: trimesh.Trimesh, *, path: Path | str | None = None) -> None:
    """Refuse a mesh whose size no table-top object has.

    Raises:
        ToolkitError: the largest extent is outside 3 mm to 3 m.
    """
    largest = float(mesh_extents(mesh).max())
    size = " x ".join(f"{x:.4g}" for x in mesh_extents(mesh))
    if largest > LARGEST_EXTENT_M:
        raise ToolkitError(
            "the mesh is implausibly large in metres",
            path=path,
            value=f"{size} m",
            hint="millimetres? give --mesh-unit mm (or cm)",
        )
    if largest < SMALLEST_EXTENT_M:
        raise ToolkitError(
            "the mesh is implausibly small in metres",
            path=path,
            value=f"{size} m",
            hint="was a metre mesh scaled as if it were in millimetres?",
        )


def mesh_bounds(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(2, 3) smallest and largest coordinates of the vertices that faces use, metres."""
    used = mesh.vertices[np.unique(mesh.faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])


def mesh_extents(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(3,) size of the axis-aligned bounding box in the mesh frame, metres."""
    low, high = mesh_bounds(mesh)
    return high - low


def hull_vertices(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """(H, 3) vertices of the convex hull; those of the outline where the mesh is flat."""
    from scipy.spatial import ConvexHull, QhullError

    used = np.asarray(mesh.vertices[np.unique(mesh.faces)], dtype=np.float64)
    # A flat mesh (a board, a picture) has its hull in the plane or line that it fills.
    _, extent, axes = np.linalg.svd(used - used.mean(axis=0), full_matrices=False)
    rank = int((extent > 1e-9 * extent[0]).sum())
    along = (used - used.mean(axis=0)) @ axes[:rank].T
    if rank == 1:
        return used[[int(along.argmin()), int(along.argmax())]]
    try:
        return used[ConvexHull(along if rank < 3 else used).vertices]
    except QhullError:
        return used


def mesh_diameter(mesh: trimesh.Trimesh) -> float:
    """Largest distance between two vertices, metres (BOP's diameter). Exact, by the convex hull."""
    from scipy.spatial.distance import cdist

    hull = hull_vertices(mesh)
    # In blocks: all pairs of a finely meshed ball, whose hull holds every vertex, fill the memory.
    blocks = range(0, len(hull), 512)
    return max(float(cdist(hull[i : i + 512], hull[i:]).max()) for i in blocks)


def nocs_frame(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], float]:
    """Centre (3,) and diagonal of the bounding box, metres: NOCS = (p - centre)/diagonal + 0.5."""
    low, high = mesh_bounds(mesh)
    return (low + high) / 2, float(np.linalg.norm(high - low))
