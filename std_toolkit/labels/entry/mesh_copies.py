"""Copies of mesh files inside a scene: in metres, with their materials and textures."""

from __future__ import annotations

import re
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import UNITS_IN_M, decimate_mesh, load_mesh
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.images import image_size
from std_toolkit.log import logger
from std_toolkit.scene.document import safe_name

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VERTEX = re.compile(rf"^(v\s+)({_NUMBER})(\s+)({_NUMBER})(\s+)({_NUMBER})")


def plan_mesh_copy(source: Path, *, unit: str, faces: int | None = None) -> dict[str, bytes]:
    """The files that a scene stores for a mesh, by name; the first one is the mesh.

    OBJ files keep their text (only vertices are scaled and references renamed), which preserves
    texture coordinates and vertex order; their materials and textures are copied too. Other
    formats are copied unchanged, or rewritten if the unit is not metres. With `faces`, a mesh of
    more faces is decimated to this number and stored as PLY with vertex colours.

    Raises:
        ToolkitError: `load_mesh` rejects the mesh, or the mesh refers to a file outside its folder
            or to a file that is not an image.
    """
    # The copy keeps the text of an OBJ file, or vertex colours: corners are not needed.
    mesh = load_mesh(source, unit=unit, corners=False)
    name = safe_name(source.name)
    if faces is not None and len(mesh.faces) > faces:
        coarse = decimate_mesh(mesh, faces).export(file_type="ply")
        assert isinstance(coarse, bytes)
        return {f"{safe_name(source.stem)}.ply": coarse}
    if source.suffix.lower() == ".obj":
        return _obj_files(source, name, UNITS_IN_M[unit])
    if unit == "m" and source.suffix.lower() != ".gltf":
        return {name: source.read_bytes()}
    # GLB embeds its textures; trimesh writes it deterministically.
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    return {f"{safe_name(source.stem)}.glb": data}


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
    files: dict[str, bytes] = {name: b""}
    lines = []
    for line in source.read_text(encoding="utf-8", errors="surrogateescape").splitlines():
        if factor != 1.0 and line.startswith(("v ", "v\t")):
            line = _scaled(line, factor)
        elif line.startswith("mtllib"):
            material = _referenced(source, line[len("mtllib") :].strip())
            if material is None:
                continue
            if material.suffix.lower() != ".mtl":
                raise ToolkitError("not a material file", path=source, value=material.name)
            target = safe_name(material.name)
            files[target] = b""
            textures, text = _material(material)
            files.update(textures)
            files[target] = text
            line = f"mtllib {target}"
        lines.append(line)
    files[name] = ("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape")
    return files


def _scaled(line: str, factor: float) -> str:
    def scale(match: re.Match[str]) -> str:
        head, x, s1, y, s2, z = match.groups()
        values = (repr(float(f"{float(n) * factor:.9g}")) for n in (x, y, z))
        a, b, c = values
        return f"{head}{a}{s1}{b}{s2}{c}"

    return _VERTEX.sub(scale, line)


def _material(path: Path) -> tuple[dict[str, bytes], bytes]:
    textures: dict[str, bytes] = {}
    lines = []
    for line in path.read_text(encoding="utf-8", errors="surrogateescape").splitlines():
        words = line.split(maxsplit=1)
        keyword = words[0].lower() if words else ""
        if keyword.startswith("map_") or keyword in ("bump", "disp", "decal", "norm"):
            value = words[1].strip() if len(words) > 1 else ""
            # Options such as "-s 1 1 1" precede the file name.
            candidate = value if not value.startswith("-") else value.split()[-1]
            texture = _referenced(path, candidate)
            if texture is None:
                continue
            image_size(texture)
            target = safe_name(texture.name)
            textures[target] = texture.read_bytes()
            line = line.replace(candidate, target)
        lines.append(line)
    return textures, ("\n".join(lines) + "\n").encode("utf-8", errors="surrogateescape")


def _referenced(source: Path, text: str) -> Path | None:
    """The file that a line of `source` names; None if it is missing.

    Files outside the folder of the mesh are rejected, because an untrusted mesh could refer to any
    file.
    """
    name = text.strip().strip('"').replace("\\", "/")
    folder = source.parent.resolve()
    path = (folder / name).resolve()
    if not name or not path.is_relative_to(folder):
        raise ToolkitError(
            "the mesh refers to a file outside its folder",
            path=source,
            value=text,
            hint="put materials and textures in the folder of the mesh",
        )
    if not path.is_file():
        logger.warning("%s: %s is missing; the mesh is copied without it", source, text)
        return None
    return path
