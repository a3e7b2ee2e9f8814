"""Box sides of the CAD models that lie beside scenes in the layouts of DREDS and STD.

`cad_model/[PART/]CLASS/INSTANCE/bbox.txt` beside the scenes or up to three folders above; its two
rows are the corners of the model's bounding box. `model.obj` beside it tells where a mug's handle
is.
"""

from __future__ import annotations

from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.data.mug_handle import MugHandle, find_handle
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    import trimesh

FOLDER = "cad_model"
FILE, MESH = "bbox.txt", "model.obj"
_LEVELS_ABOVE = 4


def model_sides(scene: Path, class_folder: str, instance_folder: str) -> NDArray[np.float64] | None:
    """Sides (3,) of a model's bounding box, of length 1 together; None where it is not there.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: as the scene's meta file names them.

    Raises:
        ToolkitError: a damaged file.
    """
    for place in _places(scene.resolve()):
        path = place / class_folder / instance_folder / FILE
        sides = _read(path)
        if sides is not None:
            return sides
    return None


def model_handle(scene: Path, class_folder: str, instance_folder: str) -> MugHandle | None:
    """Where the handle of a mug is; None where the model is not there, or has none.

    Args:
        scene: folder of the scene.
        class_folder, instance_folder: as the scene's meta file names them.

    Raises:
        ToolkitError: a damaged mesh.
    """
    for place in _places(scene.resolve()):
        path = place / class_folder / instance_folder / MESH
        if path.is_file():
            return _read_handle(path)
    return None


def mesh_handle(mesh: trimesh.Trimesh) -> MugHandle | None:
    """Where the handle of a mug is, from its mesh of any unit."""
    from std_toolkit.geometry.mesh import nocs_frame

    centre, diagonal = nocs_frame(mesh)
    return find_handle((mesh.triangles_center - centre) / diagonal, mesh.area_faces)


@lru_cache(maxsize=4096)
def _read_handle(path: Path) -> MugHandle | None:
    from std_toolkit.geometry.mesh import load_mesh

    return mesh_handle(load_mesh(path))


@lru_cache(maxsize=4096)
def _read(path: Path) -> NDArray[np.float64] | None:
    if not path.is_file():
        return None
    try:
        corners = np.loadtxt(path, dtype=np.float64)
    except (OSError, ValueError) as error:
        raise ToolkitError("cannot read the box", path=path) from error
    if corners.shape != (2, 3) or not np.isfinite(corners).all():
        raise ToolkitError("a box is two rows of three numbers", path=path, value=corners.shape)
    sides = np.abs(corners[0] - corners[1])
    length = float(np.linalg.norm(sides))
    if not length > 0:
        raise ToolkitError("the box has no extent", path=path)
    return sides / length


@cache
def _places(scene: Path) -> tuple[Path, ...]:
    found: list[Path] = []
    for above in list(scene.parents)[:_LEVELS_ABOVE]:
        top = above / FOLDER
        if top.is_dir():
            found += [top, *sorted(p for p in top.iterdir() if p.is_dir())]
    return tuple(found)
