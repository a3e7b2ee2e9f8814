"""Scenes of one table with textured boxes, from different camera paths and in different worlds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.rendering.texture import TexturedSurface
from std_toolkit.scene import (
    CameraModel,
    Frame,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)
from tests.annotator.textured_scene import write_box
from tests.scene_on_disk import camera_poses

CAMERA = Camera(480, 360, 420.0, 420.0, 241.0, 178.0)
HALF_M, PIXEL_M = 0.5, 0.001
TAG_MM, GAP_MM = 48, 16


def standing(x: float, y: float, turn: float) -> SE3:
    """T_table_obj of a box of `textured_scene` that stands at (x, y) metres."""
    return SE3(so3_exp([0.0, 0.0, turn]), np.array([x, y, 0.09]))


BOXES = {"box_a": standing(-0.1, 0.05, 0.3), "box_b": standing(0.12, 0.02, -0.8)}
ELSEWHERE = SE3.exp([0.4, -0.3, 1.1, 0.9, -0.4, 0.6])


def table(seed: int = 0, *, period: int = 0) -> NDArray[np.uint8]:
    """A printed table, (1000, 1000, 3); with a period in pixels a repeated pattern."""
    rng = np.random.default_rng(seed)
    size = period or int(2 * HALF_M / PIXEL_M)
    noise = rng.normal(size=(size, size, 3))
    if period:
        noise = np.tile(noise, (3, 3, 1))
    fine, coarse = (cv2.GaussianBlur(noise, (0, 0), s) * s for s in (3.0, 8.0))
    texture = np.clip(128 + 110 * (fine + coarse), 0, 255).astype(np.uint8)
    if period:
        tile = texture[size : 2 * size, size : 2 * size]
        count = -(-int(2 * HALF_M / PIXEL_M) // size)
        texture = np.tile(tile, (count, count, 1))[:1000, :1000]
    return texture


def plain() -> NDArray[np.uint8]:
    """A table without a print."""
    return np.full((1000, 1000, 3), 190, np.uint8)


def with_board(texture: NDArray[np.uint8], x: int = 380, y: int = 540) -> NDArray[np.uint8]:
    """The table with a sheet of 4 x 3 AprilTags whose corner is at a pixel of its texture."""
    texture = texture.copy()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    step = TAG_MM + GAP_MM
    texture[y - GAP_MM : y + 3 * step, x - GAP_MM : x + 4 * step] = 255
    for number in range(12):
        row, column = divmod(number, 4)
        tag = cv2.aruco.generateImageMarker(dictionary, number, TAG_MM)
        at = y + row * step, x + column * step
        texture[at[0] : at[0] + TAG_MM, at[1] : at[1] + TAG_MM] = tag[..., None]
    return texture


def write_board(path: Path) -> Path:
    """The file of the board of `with_board`."""
    step, tags = TAG_MM + GAP_MM, {}
    for number in range(12):
        row, column = divmod(number, 4)
        u, v = column * step - 0.5, row * step - 0.5
        corners = ((0, 0), (TAG_MM, 0), (TAG_MM, TAG_MM), (0, TAG_MM))
        tags[str(number)] = [[u + a, -(v + b), 0.0] for a, b in corners]
    path.write_text(json.dumps(tags))
    return path


def path_of_camera(count: int, *, start: float, arc: float, height: float) -> list[SE3]:
    """T_table_cam along an arc in degrees, at a height in metres."""
    poses = []
    for k in range(count):
        a = np.radians(start + arc * k / max(count - 1, 1))
        eye = np.array([0.55 * np.sin(a), -0.55 * np.cos(a), height + 0.02 * np.sin(3 * a)])
        z = np.array([0.0, 0.0, 0.05]) - eye
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        poses.append(SE3(np.stack([x, np.cross(z, x), z], axis=1), eye))
    return poses


FIRST = path_of_camera(6, start=-35, arc=50, height=0.42)
SECOND = path_of_camera(6, start=-10, arc=50, height=0.48)


def write_table_scene(
    root: Path,
    cameras: Sequence[SE3] = FIRST,
    *,
    T_world_table: SE3 | None = None,
    texture: NDArray[np.uint8] | None = None,
    boxes: Mapping[str, SE3] = BOXES,
    labelled: bool = False,
    depth: bool = True,
    registered: Sequence[int] | None = None,
    scale: float = 1.0,
) -> Scene:
    """A scene of the table in its world; a labelled one has the true labels, propagated.

    Args:
        cameras: T_table_cam.
        boxes: T_table_obj by name; each box has its own print, by its name.
        registered: frames with a camera pose; default: all.
        scale: of the camera positions, to be wrong.
    """
    texture = table() if texture is None else texture
    world = SE3.identity() if T_world_table is None else T_world_table
    surfaces, models = {}, []
    for name in boxes:
        path = root / f"models/{name}/{name}.obj"
        mesh = write_box(path, seed=sum(map(ord, name)))
        surfaces[name] = TexturedSurface.from_mesh(mesh)
        if labelled:
            models.append(model_of(name, mesh))
    frames = []
    for k, T_table_cam in enumerate(cameras):
        image, z = _seen(T_table_cam, texture)
        # The farther first.
        order = sorted(boxes, key=lambda n, T=T_table_cam: -np.linalg.norm(T.t - boxes[n].t))
        for name in order:
            drawn = surfaces[name].draw(CAMERA, T_table_cam.inverse() @ boxes[name])
            if drawn is not None:
                h, w = drawn.mask.shape
                part = np.s_[drawn.y : drawn.y + h, drawn.x : drawn.x + w]
                image[part][drawn.mask], z[part][drawn.mask] = drawn.color[drawn.mask], 0
        write_color(root / f"color/{k:06d}.png", image)
        if depth:
            write_depth_png16(root / f"depth/{k:06d}.png", z, scale=0.0001)
        file = f"depth/{k:06d}.png" if depth else None
        frames.append(Frame(id=k, name=f"{k:06d}", color=f"color/{k:06d}.png", depth=file))
    objects = [
        Object(id=i, name=name, model=name, material="raw")
        for i, name in enumerate(boxes if labelled else (), start=1)
    ]
    scene = Scene.create(
        root,
        SceneInfo(
            name=root.name,
            cameras={"color": CameraModel.of(CAMERA)},
            depth_scale=0.0001 if depth else None,
        ),
        Frames(frames=frames),
        ObjectTable(models=sorted(models, key=lambda m: m.id), objects=objects),
    )
    posed = [world @ SE3(T.R, scale * T.t) for T in cameras]
    known = range(len(cameras)) if registered is None else registered
    scene.save_poses(camera_poses([T if k in known else None for k, T in enumerate(posed)]))
    if labelled:
        rows = [
            Label(
                object=o.id,
                frame=0,
                T_cam_obj=(cameras[0].inverse() @ boxes[o.name]).flat(),
                T_world_obj=(world @ boxes[o.name]).flat(),
            )
            for o in objects
        ]
        scene.save_labels(Labels(labels=rows))
    return scene


def model_of(name: str, mesh: trimesh.Trimesh) -> Model:
    return Model(
        id=name,
        mesh=f"models/{name}/{name}.obj",
        size_m=[float(x) for x in mesh.extents],
        diameter_m=float(np.linalg.norm(mesh.extents)),
    )


def errors_of(scene: Scene, cameras: Sequence[SE3], boxes: Mapping[str, SE3] = BOXES) -> NDArray:
    """(N, 2) distance in mm and angle in degrees between the labels and the true poses."""
    rows = []
    for label in scene.labels.labels:
        name = scene.objects.object(label.object).name
        true = cameras[label.frame].inverse() @ boxes[name]
        found = SE3.from_matrix(label.T_cam_obj)
        turn = np.trace(found.R.T @ true.R)
        angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
        rows.append((1000 * np.linalg.norm(found.t - true.t), angle))
    return np.array(rows)


def _seen(T_table_cam: SE3, texture: NDArray[np.uint8]) -> tuple[NDArray, NDArray]:
    """The image of the empty table, and its z-depth in metres."""
    rays = CAMERA.rays() @ T_table_cam.R.T
    with np.errstate(divide="ignore", invalid="ignore"):
        z = -T_table_cam.t[2] / rays[..., 2]
    p = T_table_cam.t + z[..., None] * rays
    inside = (z > 0) & (np.abs(p[..., :2]).max(axis=-1) < HALF_M)
    middle = (texture.shape[0] - 1) / 2
    u = (p[..., 0] / PIXEL_M + middle).astype(np.float32)
    v = (-p[..., 1] / PIXEL_M + middle).astype(np.float32)
    small = cv2.GaussianBlur(texture, (0, 0), 0.7)  # a pixel of the image is 1.3 of the print
    image = cv2.remap(small, u, v, cv2.INTER_LINEAR)
    image[~inside] = 60
    return image, np.where(inside, z, 0.0)
