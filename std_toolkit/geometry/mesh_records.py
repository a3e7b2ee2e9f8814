"""PLY and STL files that trimesh refuses: faces of mixed sizes, strips, padding behind the end."""

from __future__ import annotations

import re
import struct
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    import trimesh

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
# Of colours by the type of their numbers; 255 in all others.
_LARGEST_COLOR = {"f4": 1.0, "f8": 1.0, "u2": 65535.0}
_LARGEST_HEADER = 1 << 16
_STL_HEADER, _STL_FACE = 84, 50


def read_records(path: Path) -> trimesh.Trimesh | None:
    """A mesh of a PLY file with faces of any size and triangle strips, or of a padded STL file.

    Returns:
        None if the file is neither.

    Raises:
        ToolkitError: a PLY file that is cut off or damaged.
    """
    suffix = path.suffix.lower()
    try:
        if suffix == ".ply":
            return _ply(named_ply_colors(path.read_bytes()))
        return _stl(path.read_bytes()) if suffix == ".stl" else None
    except (ValueError, KeyError, IndexError, struct.error, OverflowError) as error:
        raise ToolkitError(f"cannot read the mesh: {error}", path=path) from error


def _stl(data: bytes) -> trimesh.Trimesh | None:
    import trimesh

    if len(data) < _STL_HEADER:
        return None
    (count,) = struct.unpack_from("<I", data, 80)
    if count == 0 or _STL_HEADER + _STL_FACE * count > len(data):
        return None
    rows = np.frombuffer(data, np.uint8, _STL_FACE * count, _STL_HEADER).reshape(count, _STL_FACE)
    corners = np.ascontiguousarray(rows[:, 12:48]).view("<f4").reshape(-1, 3)
    return trimesh.Trimesh(
        corners.astype(np.float64), np.arange(3 * count).reshape(-1, 3), process=False
    )


class _Words:
    """Values of a PLY file in ASCII, one after the other."""

    def __init__(self, body: bytes) -> None:
        self.words, self.at = body.split(), 0

    def take(self, kind: str, count: int) -> NDArray[Any]:
        if self.at + count > len(self.words):
            raise ValueError("the mesh file is cut off")
        found = self.words[self.at : self.at + count]
        self.at += count
        return np.array([float(w) for w in found]).astype(kind)

    def rows(self, kinds: list[str], count: int) -> NDArray[np.float64]:
        return self.take("f8", len(kinds) * count).reshape(count, len(kinds))


class _Bytes:
    """The same of a binary file."""

    def __init__(self, body: bytes, order: str) -> None:
        self.body, self.order, self.at = body, order, 0

    def take(self, kind: str, count: int) -> NDArray[Any]:
        found = np.frombuffer(self.body, self.order + kind, count, self.at)
        self.at += found.nbytes
        return found

    def rows(self, kinds: list[str], count: int) -> NDArray[np.float64]:
        dtype = np.dtype([(f"f{i}", self.order + kind) for i, kind in enumerate(kinds)])
        found = np.frombuffer(self.body, dtype, count, self.at)
        self.at += found.nbytes
        columns = [found[name].astype(np.float64) for name in dtype.names or ()]
        return np.column_stack(columns) if columns else np.zeros((count, 0))


Property = tuple[str, str, str]  # name, type, type of the count of a list or ""


def _ply_header(head: str) -> tuple[str, list[tuple[str, int, list[Property]]]]:
    elements: list[tuple[str, int, list[Property]]] = []
    form = ""
    for line in head.splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1][2].append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[2], _TYPES[words[1]], ""))
    return form, elements


def _ply(data: bytes) -> trimesh.Trimesh:
    import trimesh

    end = data.find(b"end_header", 0, _LARGEST_HEADER)
    start = data.find(b"\n", end) + 1
    if end < 0 or not start:
        raise ValueError("the PLY file has no header")
    form, elements = _ply_header(data[:end].decode("ascii", "replace"))
    body: _Words | _Bytes
    if form == "ascii":
        body = _Words(data[start:])
    else:
        body = _Bytes(data[start:], ">" if "big" in form else "<")
    vertices, colors = np.zeros((0, 3)), None
    triangles: list[NDArray[np.int64]] = []
    for name, count, properties in elements:
        if count > len(data):
            raise ValueError("the mesh file is cut off")
        if any(counted for *_, counted in properties):
            for _ in range(count):
                triangles += _face(body, properties, strips="strip" in name)
            continue
        rows = body.rows([kind for _, kind, _ in properties], count)
        if name == "vertex":
            column = {p[0]: i for i, p in enumerate(properties)}
            vertices = rows[:, [column[c] for c in "xyz"]]
            if {"red", "green", "blue"} <= column.keys():
                stored = rows[:, [column[c] for c in ("red", "green", "blue")]]
                largest = _LARGEST_COLOR.get(properties[column["red"]][1], 255)
                colors = np.rint(stored * (255 / largest)).clip(0, 255)
                colors = colors.astype(np.uint8)
    faces = np.concatenate(triangles) if triangles else np.zeros((0, 3), np.int64)
    return trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)


def _face(
    body: _Words | _Bytes, properties: list[Property], *, strips: bool
) -> list[NDArray[np.int64]]:
    """Triangles of one face or of one list of strips, which -1 separates."""
    found = []
    for name, kind, counted in properties:
        if not counted:
            body.take(kind, 1)
            continue
        count = int(body.take(counted, 1)[0])
        if count < 0:
            raise ValueError("a list of negative length")
        index = body.take(kind, count)
        if name in ("vertex_indices", "vertex_index"):
            wide = index.astype(np.int64)
            if strips:
                found += _strips(wide)
            elif len(wide) >= 3:
                fan = [[wide[0], a, b] for a, b in pairwise(wide[1:])]
                found.append(np.array(fan, np.int64))
    return found


def _strips(index: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    found = []
    for strip in np.split(index, np.flatnonzero(index < 0)):
        strip = strip[strip >= 0]
        rows = [
            (strip[i], strip[i + 1], strip[i + 2])
            if i % 2 == 0
            else (strip[i + 1], strip[i], strip[i + 2])
            for i in range(len(strip) - 2)
        ]
        found.append(np.array([r for r in rows if len(set(r)) == 3], np.int64).reshape(-1, 3))
    return found


def named_ply_colors(data: bytes) -> bytes:
    """A PLY file whose vertex colours are red, green, blue, not r, g, b or diffuse_red, ...

    One that has the usual names stays as it is.
    """
    end = data.find(b"end_header", 0, _LARGEST_HEADER)
    if end < 0 or re.search(rb"property\s+\w+\s+red\s", data[:end]):
        return data
    head = re.sub(rb" diffuse_(red|green|blue)(?=\s)", rb" \1", data[:end])
    short = rb"(property\s+\w+\s+)(r|g|b)(?=\s)"
    if {m[1] for m in re.findall(short, head)} == {b"r", b"g", b"b"}:
        names = {b"r": b"red", b"g": b"green", b"b": b"blue"}
        head = re.sub(short, lambda m: m.group(1) + names[m.group(2)], head)
    return data if head == data[:end] else head + data[end:]
