"""Models of a BOP data set: vertices, diameter and symmetry; the mesh only for rendering."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_distances import ModelDistances
from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import Symmetry
from std_toolkit.geometry.mesh import (
    LARGEST_EXTENT_M,
    SMALLEST_EXTENT_M,
    hull_points,
    largest_distance,
    load_mesh,
)
from std_toolkit.importers import bop_documents, bop_objects
from std_toolkit.io.documents import read_document
from std_toolkit.rendering.mesh import RenderMesh, prepare_mesh

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_LONGEST_HEADER = 200  # lines


@dataclass(frozen=True, eq=False)
class BopModel:
    """A model in the frame of its BOP file, metres.

    Attributes:
        path: of the file.
        diameter_m: largest distance between two vertices.
        distances: MSSD and MSPD of the model.
    """

    path: Path
    diameter_m: float
    distances: ModelDistances

    @cached_property
    def mesh(self) -> RenderMesh:
        """For rendering.

        Raises:
            ToolkitError: the mesh is damaged.
        """
        return prepare_mesh(load_mesh(self.path, unit="mm"))


def read_model(root: Path, obj_id: int, *, symmetry_steps: int | None = None) -> BopModel:
    """Read a model, from models_eval/ where there is one, else models/.

    Args:
        root: of the data set.
        obj_id: number of the object.
        symmetry_steps: see `ModelDistances`.

    Returns:
        The model.

    Raises:
        ToolkitError: the model is missing or damaged.

    >>> import tempfile
    >>> import trimesh
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "models" / "obj_000001.ply"
    ...     path.parent.mkdir()
    ...     _ = trimesh.creation.box((30, 40, 120)).export(path)  # millimetres
    ...     round(read_model(Path(folder), 1).diameter_m, 6)
    0.13
    """
    folder = next((f for f in (root / "models_eval", root / "models") if f.is_dir()), None)
    if folder is None:
        raise ToolkitError("the data set's models are missing", path=root / "models")
    path = folder / f"obj_{obj_id:06d}.ply"
    info_path = folder / "models_info.json"
    infos = (
        read_document(info_path, dict[str, bop_documents.ModelInfo]) if info_path.is_file() else {}
    )
    info = infos.get(str(obj_id))
    with located(info_path, str(obj_id)):
        symmetry: Symmetry = bop_objects.symmetry_of(info, np.zeros(3)).symmetry()
    vertices = read_vertices(path)
    hull = hull_points(vertices)
    given = None if info is None else info.diameter
    diameter = largest_distance(hull) if given is None else given * bop_documents.MM
    return BopModel(path, diameter, ModelDistances(vertices, hull, symmetry, symmetry_steps))


def model_paths(root: Path, objects: Iterable[int]) -> list[Path]:
    """The files that `read_model` reads for objects.

    Args:
        root: folder of the data set.
        objects: their numbers.

    Returns:
        Paths, which need not exist: the table of the models, and a mesh for each object.

    >>> [path.name for path in model_paths(Path("lmo"), [5])]
    ['models_info.json', 'obj_000005.ply']
    """
    folder = root / ("models_eval" if (root / "models_eval").is_dir() else "models")
    return [folder / "models_info.json", *(folder / f"obj_{number:06d}.ply" for number in objects)]


def read_vertices(path: Path) -> NDArray[np.float64]:
    """(V, 3) vertices of a PLY file in millimetres, as metres.

    Reads nothing else of common files, which is several times as fast as reading the mesh.

    Args:
        path: of the file.

    Returns:
        The vertices in the order of the file.

    Raises:
        ToolkitError: the file is missing or damaged, or its size implausible.

    >>> import tempfile
    >>> import trimesh
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "box.ply"
    ...     _ = trimesh.creation.box((30, 40, 120)).export(path)  # millimetres
    ...     read_vertices(path).max(axis=0).tolist()
    [0.015, 0.02, 0.06]
    """
    if not path.is_file():
        raise ToolkitError("mesh file not found", path=path)
    with path.open("rb") as file:
        lines: list[str] = []
        while len(lines) < _LONGEST_HEADER and (not lines or lines[-1] != "end_header"):
            lines.append(file.readline(1000).decode("ascii", "replace").strip())
        rest = file.read()
    layout = _layout(lines)
    if layout is None:  # something unusual: the general reader
        return np.asarray(load_mesh(path, unit="mm").vertices, dtype=np.float64)
    kind, count, properties = layout
    try:
        if kind == "ascii":
            columns = [[name for name, _ in properties].index(axis) for axis in "xyz"]
            rows = rest.decode("ascii", "replace").splitlines()[:count]
            found = np.loadtxt(rows, usecols=columns, ndmin=2)
        else:
            order = "<" if kind == "binary_little_endian" else ">"
            table = np.frombuffer(rest, [(n, order + t) for n, t in properties], count)
            found = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    except (ValueError, IndexError) as error:
        raise ToolkitError(f"cannot read the mesh: {error}", path=path) from error
    found = found * bop_documents.MM
    if len(found) != count or not np.isfinite(found).all():
        raise ToolkitError("the mesh is cut off or has vertices that are not finite", path=path)
    largest = float(np.ptp(found, axis=0).max())
    if not SMALLEST_EXTENT_M <= largest <= LARGEST_EXTENT_M:
        raise ToolkitError(
            "the model has an implausible size",
            path=path,
            value=f"{largest:.4g} m",
            hint="BOP models are in millimetres",
        )
    return found


def _layout(lines: list[str]) -> tuple[str, int, list[tuple[str, str]]] | None:
    """Format, number of vertices and their properties; None if that is not the first element."""
    words = [line.split() for line in lines if line]
    if len(words) < 3 or words[0] != ["ply"] or words[-1] != ["end_header"]:
        return None
    kind, count, properties, element = "", 0, [], ""
    for word in words:
        if word[0] == "format":
            kind = word[1]
        elif word[0] == "element":
            if not element and word[1] != "vertex":
                return None
            element = word[1]
            count = int(word[2]) if element == "vertex" else count
        elif word[0] == "property" and element == "vertex":
            if word[1] not in _TYPES:
                return None
            properties.append((word[2], _TYPES[word[1]]))
    known = {"x", "y", "z"} <= {name for name, _ in properties} and count > 0
    return (kind, count, properties) if known else None
