"""A scanned model, and its files: OBJ with MTL and PNG, GLB, PLY, all in metres."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.arrays import Array
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.images import write_png
from std_toolkit.scanning.model.bake import Texture, vertex_colors, vertex_guessed
from std_toolkit.scanning.photos.views import View

SUFFIXES = ("obj", "mtl", "png", "glb", "ply")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """A finished scan.

    Attributes:
        name: name of the model.
        vertices: (V, 3) metres, frame of the model.
        faces: (F, 3).
        texture: its texture.
        supported: (F,) faces that depth maps support; the others are from outlines alone.
        views: photos with masks, in the frame of the model.
        facts: name and value of what was measured.
        warnings: sentences on what to do better.
        seconds: time of each stage.
        faults: why the mesh must not be used; empty for a good one.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    texture: Texture
    supported: NDArray[np.bool_]
    views: Sequence[View]
    facts: dict[str, Any]
    warnings: list[str]
    seconds: dict[str, float] = field(default_factory=dict)
    faults: Sequence[str] = ()


def file_names(name: str) -> list[str]:
    """Names of all files of a scan of this name."""
    model = [f"{name}.{s}" for s in SUFFIXES]
    return [*model, guessed_name(name), "symmetry.json", "report.html", "scan.json"]


def guessed_name(name: str) -> str:
    """Name of the image of the texels that no photo shows."""
    return f"{name}_guessed.png"


def write_model(
    folder: Path, name: str, vertices: Array, faces: NDArray[np.int64], texture: Texture
) -> dict[str, Path]:
    """Write `NAME.obj`, `NAME.mtl`, `NAME.png`, `NAME_guessed.png`, `NAME.glb` and `NAME.ply`.

    Args:
        folder: receives the files.
        name: name of the model.
        vertices: (V, 3) metres, frame of the model.
        faces: (F, 3).
        texture: its texture.

    Returns:
        Path by suffix.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = {s: folder / f"{name}.{s}" for s in SUFFIXES}
    write_png(paths["png"], texture.image)
    write_png(folder / guessed_name(name), np.where(texture.guessed, 255, 0).astype(np.uint8))
    material = f"newmtl {name}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd {paths['png'].name}\n"
    write_bytes_atomic(paths["mtl"], material.encode())
    write_bytes_atomic(paths["obj"], _obj(name, vertices, faces, texture))
    write_bytes_atomic(paths["glb"], _glb(vertices, faces, texture))
    write_bytes_atomic(paths["ply"], _ply(vertices, faces, texture))
    return paths


def _obj(name: str, vertices: Array, faces: NDArray[np.int64], texture: Texture) -> bytes:
    flat = texture.uv.reshape(-1, 2)
    uv, index = np.unique(np.round(flat, 7), axis=0, return_inverse=True)
    corner = index.reshape(-1, 3) + 1
    out = io.StringIO()
    out.write(f"# metres\nmtllib {name}.mtl\no {name}\n")
    np.savetxt(out, vertices, fmt="v %.7f %.7f %.7f")
    np.savetxt(out, uv, fmt="vt %.7f %.7f")
    out.write(f"usemtl {name}\n")
    both = np.stack([faces + 1, corner], axis=2).reshape(-1, 6)
    np.savetxt(out, both, fmt="f %d/%d %d/%d %d/%d")
    return out.getvalue().encode()


def _glb(vertices: Array, faces: NDArray[np.int64], texture: Texture) -> bytes:
    import trimesh
    from PIL import Image

    # One vertex for each pair of place and texture coordinate.
    both = np.concatenate(
        [faces.reshape(-1, 1).astype(np.float64), np.round(texture.uv.reshape(-1, 2), 7)], axis=1
    )
    unique, index = np.unique(both, axis=0, return_inverse=True)
    visual = trimesh.visual.TextureVisuals(
        uv=unique[:, 1:],
        material=trimesh.visual.material.PBRMaterial(
            baseColorTexture=Image.fromarray(texture.image), metallicFactor=0.0, roughnessFactor=0.9
        ),
    )
    mesh = trimesh.Trimesh(
        vertices[unique[:, 0].astype(np.int64)], index.reshape(-1, 3), visual=visual, process=False
    )
    data: Any = mesh.export(file_type="glb")
    return bytes(data)


def _ply(vertices: Array, faces: NDArray[np.int64], texture: Texture) -> bytes:
    """PLY with vertex colours, closed as the mesh is; `guessed` is 1 where no photo shows them."""
    import trimesh

    color = vertex_colors(len(vertices), faces, texture)
    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=color, process=False)
    guessed = vertex_guessed(len(vertices), faces, texture)
    mesh.vertex_attributes["guessed"] = guessed.astype(np.uint8)
    data: Any = mesh.export(file_type="ply")
    return bytes(data)
