"""Meshes in the formats of the layouts: PLY in millimetres for BOP, OBJ for STD and NOCS."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.io.atomic import write_bytes_atomic

if TYPE_CHECKING:
    import trimesh


def transformed(mesh: trimesh.Trimesh, *, centre: Array, factor: float) -> trimesh.Trimesh:
    """A copy with vertices `(v - centre) * factor` and the same texture and colours."""
    copy = mesh.copy()
    normals = np.array(mesh.vertex_normals)
    copy.vertices = (np.asarray(mesh.vertices) - centre) * factor
    # Set after the vertices: trimesh drops cached normals when they change.
    copy.vertex_normals = normals  # type: ignore[method-assign]
    return copy


def ply_files(mesh: trimesh.Trimesh, name: str) -> dict[str, bytes]:
    """An ASCII PLY with vertex normals, as bop_toolkit reads it, and its texture.

    Vertices have texture coordinates (and the header names the texture file) or, without a
    texture, the colours of the mesh, if any.

    Args:
        name: name of the PLY file.

    Returns:
        File name to content; the PLY comes first.
    """
    texture, uv, colors = _appearance(mesh)
    columns = [np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)]
    formats = ["%.6f"] * 3 + ["%.6f"] * 3
    properties = [f"property float {p}" for p in ("x", "y", "z", "nx", "ny", "nz")]
    header = ["ply", "format ascii 1.0"]
    files: dict[str, bytes] = {name: b""}
    if texture is not None and uv is not None:
        texture_name = Path(name).with_suffix(".png").name
        files[texture_name] = texture
        header.append(f"comment TextureFile {texture_name}")
        columns.append(uv)
        formats += ["%.7f"] * 2
        properties += ["property float texture_u", "property float texture_v"]
    elif colors is not None:
        columns.append(colors)
        formats += ["%d"] * 4
        properties += [f"property uchar {c}" for c in ("red", "green", "blue", "alpha")]
    header += [f"element vertex {len(mesh.vertices)}", *properties]
    header += [f"element face {len(mesh.faces)}", "property list uchar int vertex_indices"]
    header.append("end_header")
    out = io.BytesIO()
    out.write(("\n".join(header) + "\n").encode())
    table = np.concatenate([np.asarray(c, dtype=np.float64) for c in columns], axis=1)
    # Negative zero would make the files of equal meshes differ.
    np.savetxt(out, np.where(np.abs(table) < 5e-8, 0.0, table), fmt=" ".join(formats))
    np.savetxt(out, np.insert(np.asarray(mesh.faces), 0, 3, axis=1), fmt="%d")
    files[name] = out.getvalue()
    return files


def obj_files(mesh: trimesh.Trimesh, name: str) -> dict[str, bytes]:
    """An OBJ, its material and its texture: file name to content; the OBJ comes first."""
    import trimesh.exchange.obj as obj

    stem = Path(name).stem
    mesh = mesh.copy()
    material = getattr(mesh.visual, "material", None)
    if material is not None:
        # The material name becomes a file name; that of the source may be invalid as one.
        material.name = f"{stem}_material"
    text, extra = obj.export_obj(
        mesh,
        include_normals=True,
        include_color=False,
        return_texture=True,
        mtl_name=f"{stem}.mtl",
        digits=9,
        header="",
    )
    files: dict[str, bytes] = {name: text.lstrip("# \n").encode() + b"\n"}
    for key, content in sorted(extra.items()):
        files[key] = content.encode() if isinstance(content, str) else content
    return files


def write_files(folder: Path, files: dict[str, bytes]) -> list[Path]:
    """Write the files atomically; returns their paths."""
    for name, content in files.items():
        write_bytes_atomic(folder / name, content)
    return [folder / name for name in files]


def evenly_split(mesh: trimesh.Trimesh, *, largest_edge: float) -> trimesh.Trimesh:
    """The same surface with no edge longer than `largest_edge`, without texture.

    Errors over vertices (ADD) depend on the distribution of the vertices. Splitting edges makes it
    more uniform and, unlike resampling, keeps the surface.
    """
    import trimesh as tm

    vertices, faces = tm.remesh.subdivide_to_size(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), max_edge=largest_edge
    )
    merged, inverse = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    return tm.Trimesh(merged, inverse.reshape(-1)[faces], process=False, validate=False)


def _appearance(
    mesh: trimesh.Trimesh,
) -> tuple[bytes | None, NDArray[Any] | None, NDArray[Any] | None]:
    """Texture PNG, (V, 2) texture coordinates, (V, 4) uint8 colours; None for what is absent."""
    import trimesh as tm

    visual = mesh.visual
    if isinstance(visual, tm.visual.TextureVisuals):
        uv = visual.uv
        image = getattr(visual.material, "image", None)
        if image is None:
            image = getattr(visual.material, "baseColorTexture", None)
        if uv is not None and image is not None and len(uv) == len(mesh.vertices):
            buffer = io.BytesIO()
            image.convert("RGB").save(buffer, format="PNG")
            return buffer.getvalue(), np.asarray(uv), None
        return None, None, None
    if visual is not None and visual.kind == "vertex":
        return None, None, np.asarray(visual.vertex_colors, dtype=np.uint8)
    return None, None, None
