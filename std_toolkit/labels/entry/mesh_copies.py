"""Copies of mesh files inside a scene: in metres, with their materials and textures."""

from __future__ import annotations

import re
from pathlib import Path

from std_toolkit.geometry.mesh import (
    SECOND_READER,
    UNITS_IN_M,
    decimate_mesh,
    load_mesh,
)
from std_toolkit.geometry.mesh_proof import check_copy
from std_toolkit.geometry.obj_files import read_obj
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.scene.document import safe_name

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_VERTEX = re.compile(rf"^(v\s+)({_NUMBER})(\s+)({_NUMBER})(\s+)({_NUMBER})")


def plan_mesh_copy(source: Path, *, unit: str, faces: int | None = None) -> dict[str, bytes]:
    """The files that a scene stores for a mesh, by name; the first one is the mesh.

    OBJ files keep their text (only vertices are scaled and references renamed), which preserves
    texture coordinates and vertex order; their materials and textures are copied too. Other
    formats are copied unchanged, or rewritten if the unit is not metres. With `faces`, a mesh of
    more faces is decimated to this number and stored as PLY with vertex colours.

    Textures are named by their content. The copy is loaded and compared with the mesh.

    Raises:
        ToolkitError: `load_mesh` rejects the mesh, the mesh refers to a file outside its folder or
            to a file that is not an image, or the copy differs from the mesh.
    """
    # The copy keeps the text of an OBJ file, or vertex colours: corners are not needed.
    mesh = load_mesh(source, unit=unit, corners=False)
    name = f"{safe_name(source.stem)}{source.suffix.lower()}"
    if faces is not None and len(mesh.faces) > faces:
        coarse = decimate_mesh(mesh, faces).export(file_type="ply")
        assert isinstance(coarse, bytes)
        return {f"{safe_name(source.stem)}.ply": coarse}
    if source.suffix.lower() == ".obj":
        files = _obj_files(source, name, UNITS_IN_M[unit])
        check_copy(files, mesh, source)
        return files
    if mesh.metadata.get(SECOND_READER):
        plain = mesh.export(file_type="ply")
        assert isinstance(plain, bytes)
        files = {f"{safe_name(source.stem)}.ply": plain}
        check_copy(files, mesh, source)
        return files
    # The texture of a PLY file is a file of its own, as those of glTF.
    suffix = source.suffix.lower()
    is_painted = suffix == ".ply" and getattr(mesh.visual, "kind", None) == "texture"
    if unit == "m" and suffix != ".gltf" and not is_painted:
        return {name: source.read_bytes()}
    # GLB embeds its textures; trimesh writes it deterministically.
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    files = {f"{safe_name(source.stem)}.glb": data}
    check_copy(files, mesh, source)
    return files


def write_mesh_copy(folder: Path, files: dict[str, bytes]) -> Path:
    """Write the files of `plan_mesh_copy` atomically; the mesh last. Returns the mesh's path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in reversed(files.items()):
        path = folder / name
        if path.is_file() and path.read_bytes() == data:
            continue
        write_bytes_atomic(path, data)
    return folder / next(iter(files))


def _obj_files(source: Path, name: str, factor: float) -> dict[str, bytes]:
    files = read_obj(source, strict=True)
    data = files.data
    if factor != 1.0:
        text = data.decode("utf-8", "surrogateescape")
        lines = [
            _scaled(line, factor) if line.startswith(("v ", "v\t")) else line
            for line in text.splitlines()
        ]
        data = ("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape")
    return {name: data, **files.files}


def _scaled(line: str, factor: float) -> str:
    def scale(match: re.Match[str]) -> str:
        head, x, s1, y, s2, z = match.groups()
        values = (repr(float(f"{float(n) * factor:.9g}")) for n in (x, y, z))
        a, b, c = values
        return f"{head}{a}{s1}{b}{s2}{c}"

    return _VERTEX.sub(scale, line)
