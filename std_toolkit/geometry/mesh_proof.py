"""Whether the copy of a mesh is the mesh: it is loaded back before anything refers to it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import mesh_bounds, mesh_extents, parse_mesh
from std_toolkit.geometry.obj_files import ObjFiles
from std_toolkit.geometry.surface_colors import SurfaceColors

if TYPE_CHECKING:
    import trimesh

# Faces whose colours are compared, the mean difference in grey levels (textures may be stored
# anew as JPEG), and the difference of bounds (single precision) as a fraction of the size.
_SAMPLED, _LEVELS, _BOUNDS = 300, 6.0, 1e-5


def check_copy(files: Mapping[str, bytes], mesh: trimesh.Trimesh, source: Path) -> None:
    """Load a planned copy and compare it with its mesh.

    Args:
        files: content by name; the first one is the mesh.
        mesh: what was copied, in the same unit.
        source: its file, for errors.

    Raises:
        ToolkitError: it has other faces, bounds or colours.
    """
    name, data = next(iter(files.items()))
    kind = name.rpartition(".")[2].lower()
    try:
        if kind == "obj":
            copy = parse_mesh(ObjFiles(data, {k: v for k, v in files.items() if k != name}))
        else:
            copy = parse_mesh(source, data=data, kind=kind)
    except Exception as error:  # the parsers of trimesh raise many kinds of errors
        raise ToolkitError(f"the copy of the mesh cannot be read: {error}", path=source) from error
    check_same_mesh(copy, mesh, path=source)


def check_same_mesh(copy: Any, mesh: trimesh.Trimesh, *, path: Path | str) -> None:
    """Check that a copy has the faces, the bounds and the colours of its mesh.

    Raises:
        ToolkitError: they differ.
    """
    if len(getattr(copy, "faces", ())) != len(mesh.faces):
        raise ToolkitError(
            "the copy of the mesh has another number of faces", path=path,
            value=[len(getattr(copy, "faces", ())), len(mesh.faces)],
        )  # fmt: skip
    off = float(np.abs(mesh_bounds(copy) - mesh_bounds(mesh)).max())
    if off > _BOUNDS * float(mesh_extents(mesh).max()):
        raise ToolkitError("the copy of the mesh has another size", path=path, value=off)
    colors = [SurfaceColors.from_mesh(m, largest=None) for m in (copy, mesh)]
    if (colors[0] is None) != (colors[1] is None):
        raise ToolkitError("the copy of the mesh lost its colours", path=path)
    if colors[0] is None or colors[1] is None:
        return
    faces = np.unique(np.linspace(0, len(mesh.faces) - 1, _SAMPLED).astype(np.int64))
    weights = np.full((len(faces), 2), 1 / 3)
    values = [c.at(faces, weights) for c in colors if c is not None]
    if float(np.abs(values[0] - values[1]).mean()) > _LEVELS:
        raise ToolkitError("the copy of the mesh has other colours", path=path)
