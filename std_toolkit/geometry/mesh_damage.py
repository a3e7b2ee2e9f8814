"""Damaged mesh files: cut off, which parsers of text read as smaller meshes, or piled faces."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

if TYPE_CHECKING:
    import trimesh

_HEADER_BYTES = 65536
_TAIL_BYTES = 65536
_MOST_AT_AN_EDGE = 1000  # two in a closed surface
_CORNER = re.compile(r"-?\d+(/-?\d*){0,2}")
# Numbers after the keyword of a line of an OBJ file.
_FEWEST = {"v": 3, "vt": 2, "vn": 3}


def check_whole(path: Path, vertices: int, faces: int) -> None:
    """Check that a text mesh was read to its end.

    Args:
        path: of the file.
        vertices, faces: numbers that were read.

    Raises:
        ToolkitError: a PLY or OFF file, or an OBJ file with the number of faces in a comment, has
            fewer elements than it says, or the last line of an OBJ file is incomplete.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        announced = _ply_counts(path)
    elif suffix == ".off":
        announced = _off_counts(path)
    else:
        announced = {}
        if suffix == ".obj":
            _check_last_line(path)
            announced = _obj_counts(path)
    for name, found in (("vertices", vertices), ("faces", faces)):
        wanted = announced.get(name, 0)
        if found < wanted:
            raise ToolkitError(
                f"the mesh file is cut off: its header announces {wanted} {name}",
                path=path,
                field=name,
                value=found,
                hint="export or copy it again",
            )


def _ply_counts(path: Path) -> dict[str, int]:
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).split(b"end_header")[0].decode("ascii", "replace")
    counts = {}
    for name, key in (("vertices", "vertex"), ("faces", "face")):
        found = re.search(rf"^element {key} (\d{{1,12}})\s*$", head, re.MULTILINE)
        if found:
            counts[name] = int(found.group(1))
    return counts


def _obj_counts(path: Path) -> dict[str, int]:
    """The number in a comment of MeshLab: `# Faces: 12`. Readers may leave loose vertices out."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).decode("ascii", "replace")
    found = re.search(r"^# ?faces: (\d{1,12})\s*$", head, re.MULTILINE | re.IGNORECASE)
    return {"faces": int(found.group(1))} if found else {}


def warn_of_loose_vertices(path: Path, vertices: int, faces: NDArray[np.int64]) -> None:
    """Warn about an OBJ file whose vertices do not all belong to a face.

    It lists the vertices first and announces no counts, so that a file that was cut off between
    two faces is a valid one with loose vertices.
    """
    if path.suffix.lower() != ".obj":
        return
    used = np.zeros(vertices, bool)
    used[faces.reshape(-1)] = True
    loose = vertices - int(used.sum())
    if loose:
        logger.warning(
            "%s: %d of %d vertices belong to no face; is the file cut off?", path, loose, vertices
        )


def warn_of_unread_colors(path: Path, mesh: trimesh.Trimesh) -> None:
    """Warn about colours of a file that the mesh has lost: those of an OFF file, a plain one.

    Materials of OBJ files have notes of their own (`obj_files.read_obj`).
    """
    suffix = path.suffix.lower()
    if suffix == ".off":
        with path.open("rb") as file:
            if b"COFF" in file.read(16).split(b"\n")[0]:
                logger.warning("%s: colours of OFF files are not read", path)
    material = getattr(mesh.visual, "material", None)
    factor = getattr(material, "baseColorFactor", None)
    if suffix not in (".glb", ".gltf") or factor is None:
        return
    color = np.asarray(factor, float)[:3]
    if getattr(material, "baseColorTexture", None) is None and np.ptp(color) > 0:
        logger.warning(
            "%s: one colour, baseColorFactor %s, and no texture: it is not shown, and tells "
            "no pose",
            path,
            " ".join(f"{c:g}" for c in color),
        )


def _off_counts(path: Path) -> dict[str, int]:
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).decode("ascii", "replace")
    lines = [line.split("#")[0].strip() for line in head.splitlines()]
    words = " ".join(lines).replace("OFF", " ", 1).split()[:2]
    if len(words) == 2 and all(w.isdigit() and len(w) < 13 for w in words):
        return {"vertices": int(words[0]), "faces": int(words[1])}
    return {}


def _check_last_line(path: Path) -> None:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _TAIL_BYTES))
        text = file.read().decode("utf-8", "replace")
    lines = [line.split(" #")[0] for line in text.splitlines()[-50:]]
    lines = [line for line in lines if line.strip()]
    if text.endswith(("\n", "\r")) or len(lines) < 2:
        return
    last = lines[-1].split()
    if last[0] == "f":
        corners = [w for w in last[1:] if _CORNER.fullmatch(w)]
        before = next((x.split() for x in reversed(lines[:-1]) if x.startswith("f ")), None)
        # Every corner of a file names the same things: v, v/vt, v//vn or v/vt/vn.
        whole = len(corners) == len(last) - 1 >= 3 and (
            before is None or _slashes(last[-1]) == _slashes(before[-1])
        )
    else:
        whole = len(last) - 1 >= _FEWEST.get(last[0], 0)
    if not whole:
        raise ToolkitError(
            "the mesh file is cut off: its last line is incomplete",
            path=path,
            value=lines[-1][:40],
            hint="export or copy it again",
        )


def _slashes(corner: str) -> tuple[int, bool]:
    return corner.count("/"), corner.endswith("/")


def refuse_piles(path: Path, vertices: Array, faces: NDArray[np.integer]) -> None:
    """Refuse a mesh in which more than a thousand faces lie on each other or share an edge.

    All of them are as near to a point as one: a search for the nearest surface visits each, and
    takes minutes where it takes milliseconds else.

    Args:
        path: its file.
        vertices: (V, 3) finite coordinates.
        faces: (F, 3) indices.

    Raises:
        ToolkitError: it is such a mesh.
    """
    if len(faces) <= _MOST_AT_AN_EDGE:
        return
    x, y, z = np.asarray(vertices, dtype=np.float64).T
    with np.errstate(over="ignore", invalid="ignore"):
        # One number for each place, so that vertices that were written twice are one.
        corners = (x + math.pi * y + math.e * z)[np.asarray(faces)]
        others = np.roll(corners, -1, axis=1)
        low, high = np.minimum(corners, others), np.maximum(corners, others)
        edges = np.sort((math.sqrt(2) * low + math.sqrt(3) * high)[low < high])
    if (edges[_MOST_AT_AN_EDGE:] == edges[:-_MOST_AT_AN_EDGE]).any():
        raise ToolkitError(
            f"more than {_MOST_AT_AN_EDGE} faces of the mesh lie on each other or share an edge",
            path=path,
            hint="remove repeated faces, as MeshLab and Blender do",
        )
