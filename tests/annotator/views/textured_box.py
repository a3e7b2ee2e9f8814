"""A box whose texture tells its sides: red above green in front, blue behind, grey elsewhere."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from views_desk import Desk, write_scene

from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_color
from std_toolkit.scene import Scene

SIZE = np.array([0.10, 0.16, 0.06])
RED, GREEN, BLUE = (220, 30, 30), (30, 190, 40), (40, 60, 220)
GREY = (150, 150, 150)

# With the front towards the camera and its red half up.
FRONT = SE3(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.5]))
HALF_TURN = SE3(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))


def texture(side: int = 64) -> NDArray[np.uint8]:
    """Left half: red above green. Right half: blue above grey."""
    image = np.empty((side, side, 3), np.uint8)
    half = side // 2
    image[:half, :half], image[half:, :half] = RED, GREEN
    image[:half, half:], image[half:, half:] = BLUE, GREY
    return image


def color_at(point: NDArray[np.float64]) -> tuple[int, int, int]:
    """The texture at a point (3,) of the surface, by its position alone."""
    if point[2] > SIZE[2] / 2 - 1e-6:
        return RED if point[1] > 0 else GREEN
    return BLUE if point[2] < -SIZE[2] / 2 + 1e-6 else GREY


def textured_box(divisions: int = 0) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray]:
    """Vertices (V, 3), faces (F, 3), and texture coordinates (F, 3, 2) of the faces' corners."""
    box = trimesh.creation.box(SIZE)
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    for _ in range(divisions):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    corners = vertices[faces]
    share = corners / SIZE + 0.5  # 0 to 1
    uv = np.stack([0.6 + 0.3 * share[..., 2], 0.1 + 0.3 * share[..., 1]], axis=-1)
    front = (corners[..., 2] > SIZE[2] / 2 - 1e-9).all(axis=1)
    back = (corners[..., 2] < -SIZE[2] / 2 + 1e-9).all(axis=1)
    uv[front] = np.stack([0.02 + 0.46 * share[front, :, 0], share[front, :, 1]], axis=-1)
    uv[back] = np.stack([0.52 + 0.46 * share[back, :, 0], 0.52 + 0.46 * share[back, :, 1]], axis=-1)
    return vertices, faces, uv


def write_obj(path: Path, *, divisions: int = 0, side: int = 64) -> Path:
    """The box as an OBJ file: faces share vertices, each has texture coordinates of its own."""
    vertices, faces, uv = textured_box(divisions)
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["mtllib box.mtl", "usemtl texture"]
    lines += ["v " + " ".join(f"{x:.6f}" for x in v) for v in vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv.reshape(-1, 2)]
    for i, face in enumerate(faces):
        lines.append("f " + " ".join(f"{v + 1}/{3 * i + k + 1}" for k, v in enumerate(face)))
    path.write_text("\n".join(lines) + "\n")
    (path.parent / "box.mtl").write_text("newmtl texture\nKd 0.6 0.6 0.6\nmap_Kd texture.png\n")
    write_color(path.parent / "texture.png", texture(side))
    return path


def painted(mesh: trimesh.Trimesh, image: NDArray[np.uint8], uv: NDArray) -> trimesh.Trimesh:
    """The mesh with a texture; uv (V, 2)."""
    material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(image))
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return mesh


def desk_with_box(root: Path, *, pose: SE3 = FRONT, divisions: int = 0, side: int = 64) -> Desk:
    """A main view and a side view of the textured box and a ring without a texture."""
    write_scene(root)
    write_obj(root / "models/box/box.obj", divisions=divisions, side=side)
    scene = Scene.open(root)
    models = [
        msgspec.structs.replace(
            m,
            mesh="models/box/box.obj",
            size_m=SIZE.tolist(),
            diameter_m=float(np.linalg.norm(SIZE)),
        )
        if m.id == "box"
        else m
        for m in scene.objects.models
    ]
    scene.save_objects(msgspec.structs.replace(scene.objects, models=models))
    labels = scene.labels
    rows = [
        msgspec.structs.replace(row, T_cam_obj=pose.flat(), T_world_obj=None)
        if row.object == 2
        else row
        for row in labels.labels
    ]
    Scene.open(root).save_labels(msgspec.structs.replace(labels, labels=rows))
    desk = Desk(root)
    desk.controller.set_options(opacity=1.0)
    desk.settle()
    return desk


def hue_is(pixel: NDArray[np.uint8], color: tuple[int, int, int]) -> bool:
    """Whether a pixel has a colour, darkened by the light or not."""
    p, c = np.asarray(pixel, float), np.asarray(color, float)
    scale = float(p @ c) / float(c @ c)
    return bool(0.35 < scale < 1.2 and np.abs(p - scale * c).max() < 28)
