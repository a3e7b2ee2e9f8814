"""A strip of pictures of an attempt: camera image, depth of the planner, and stages of the grasp.

Rendered by ray casting, so that no GPU or display is needed: shaded surfaces, see-through glass,
metal in grey, the gripper in orange.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.evaluation.depth_panels import DepthScale, depth_picture
from benchmark.metrics.grasp.gripper import PANDA, Gripper
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop.round import Attempt
from benchmark.tabletop.trial import Stage
from sensors.physics import PhysicalObject
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.rendering import maps, mesh, raycast, renderer

Image = NDArray[np.uint8]
PANELS = ("seen", "depth given", "pre-grasp", "closed", "lifted")
WIDTH, HEIGHT = 288, 216
_BAND = 18
# Viewed from the right of the camera and further away, so that the lifted gripper is in view.
_EYE, _TARGET = (0.42, -0.55, 0.42), (0.0, 0.0, 0.14)
_COLORS = {"transparent": (175, 205, 235), "specular": (185, 185, 190)}
# Glass: the tint of what is seen through it where it faces the eye, by how many pixels its edges
# bend that, the light that they and a lamp's highlight mirror, and where the lamp is.
_TINT, _BEND_PX, _MIRRORED, _SHINE = (0.93, 0.97, 0.98), 26.0, 250.0, 200.0
_LAMP = np.array([-0.45, -0.65, -0.61]) / np.linalg.norm([-0.45, -0.65, -0.61])
_HAND, _TABLE = (235, 140, 60), (232, 226, 214)


def attempt_strip(attempt: Attempt, *, gripper: Gripper | SuctionCup = PANDA) -> Image:
    """Return `PANELS` side by side, (h, w, 3) uint8; stages that were not reached are empty."""
    frame = attempt.observation.frame
    known = frame.depth_true
    scale = DepthScale(float(known.min()) - 0.02, float(np.quantile(known, 0.98)))
    pictures = [_fit(frame.color), _fit(depth_picture(attempt.given.depth, scale))]
    titles = [PANELS[0], PANELS[1]]
    stages = () if attempt.executed is None else attempt.executed.stages
    for stage in stages:
        pictures.append(_stage_picture(attempt, stage, gripper))
        titles.append(stage.name)
    while len(pictures) < len(PANELS):
        pictures.append(np.full((HEIGHT, WIDTH, 3), 40, np.uint8))
        titles.append("")
    titles[0] += f" ({attempt.number}: {attempt.outcome})"
    return np.hstack([_titled(p, t) for p, t in zip(pictures, titles, strict=True)])


def _stage_picture(attempt: Attempt, stage: Stage, gripper: Gripper | SuctionCup) -> Image:
    from sensors.viewpoints.views import look_at

    camera = Camera(WIDTH, HEIGHT, 260.0, 260.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    T_world_cam = look_at(_EYE, _TARGET)
    T_cam_world = T_world_cam.inverse()
    placed: list[renderer.PlacedMesh] = []
    glass: list[int] = []
    colors: list[tuple[int, int, int]] = []
    for obj, T in zip(attempt.before.objects, stage.poses, strict=True):
        placed.append(renderer.PlacedMesh(len(placed) + 1, _mesh(obj.body), T_cam_world @ T))
        colors.append(_COLORS.get(obj.material.material_class, (200, 200, 120)))
        if obj.material.material_class == "transparent":
            glass.append(len(placed) - 1)
    boxes = gripper.boxes([stage.opening], [0.0])
    for low, high in zip(boxes.low[0], boxes.high[0], strict=True):
        placed.append(
            renderer.PlacedMesh(len(placed) + 1, _box(low, high), T_cam_world @ stage.T_world_hand)
        )
        colors.append(_HAND)
    image, normals, index = _drawn(camera, T_world_cam, placed, colors)
    through = np.isin(index, glass)
    if through.any():
        solid = [k for k in range(len(placed)) if k not in glass]
        behind, _, _ = _drawn(
            camera, T_world_cam, [placed[k] for k in solid], [colors[k] for k in solid]
        )
        image = np.where(through[..., None], through_glass(behind, normals), image)
    return np.rint(np.clip(image, 0, 255)).astype(np.uint8)


def through_glass(behind: NDArray[np.float64], normals: NDArray[np.float32]) -> NDArray[np.float64]:
    """Picture (h, w, 3) of what is behind glass of given normals (camera frame), as seen through
    it: bent towards its edges, which mirror the surroundings, with the highlight of a lamp."""
    h, w = behind.shape[:2]
    slant = 1 - np.clip(-normals[..., 2], 0, 1)
    v, u = np.mgrid[:h, :w].astype(np.float32)
    bent = cv2.remap(
        behind.astype(np.float32),
        u + _BEND_PX * slant * normals[..., 0],
        v + _BEND_PX * slant * normals[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REFLECT,
    )
    edge = slant**3
    # Just inside the bright edge, light comes from so far aside that it is dark.
    dark = 1 - 0.45 * np.exp(-(((slant - 0.62) / 0.18) ** 2))
    shine = np.clip((normals @ _LAMP.astype(np.float32) - 0.975) / 0.025, 0, 1)
    seen = bent * np.array(_TINT) * (dark * (1 - edge))[..., None]
    return seen + (_MIRRORED * 0.85 * edge + _SHINE * shine)[..., None]


def _drawn(
    camera: Camera,
    T_world_cam: SE3,
    placed: Sequence[renderer.PlacedMesh],
    colors: Sequence[tuple[int, int, int]],
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.int64]]:
    """Picture (h, w, 3) of meshes on the table, their normals, and the mesh of each pixel or -1."""
    renumbered = [replace(one, object_id=k) for k, one in enumerate(placed, start=1)]
    seen = maps.compose(raycast.RaycastRenderer(threads=1), camera, renumbered)
    normals = maps.surface_maps(camera, renumbered, seen)[1]
    rays = camera.rays()
    down = rays @ T_world_cam.R[2]
    table = np.where(down < 0, -T_world_cam.t[2] / np.where(down < 0, down, -1), 0)
    on_table = (table > 0) & ((seen.index < 0) | (seen.depth > table))
    shade = np.clip(-normals[..., 2], 0, 1) * 0.65 + 0.35
    image = np.full((HEIGHT, WIDTH, 3), 250.0)
    there = (seen.index >= 0) & ~on_table
    image[there] = np.array(colors, float)[seen.index[there]] * shade[there][:, None]
    points = T_world_cam @ (rays * table[..., None]).reshape(-1, 3)
    checks = (np.floor(points[:, :2] / 0.05).astype(np.int64).sum(axis=1) % 2).reshape(table.shape)
    image[on_table] = (np.array(_TABLE, float) - 10.0 * checks[..., None])[on_table]
    return image, normals, np.where(there, seen.index, -1)


def _mesh(obj: PhysicalObject) -> mesh.RenderMesh:
    return mesh.RenderMesh.from_arrays(obj.asset.vertices * obj.diagonal_m, obj.asset.faces)


def _box(low: NDArray[np.float64], high: NDArray[np.float64]) -> mesh.RenderMesh:
    import trimesh

    box = trimesh.creation.box(bounds=np.stack([low, high]))
    return mesh.RenderMesh.from_arrays(np.asarray(box.vertices), np.asarray(box.faces))


def _fit(image: Image) -> Image:
    """The centre of a wide picture, resized to a panel."""
    h, w = image.shape[:2]
    wanted = round(h * WIDTH / HEIGHT)
    if w > wanted:
        left = (w - wanted) // 2
        image = image[:, left : left + wanted]
    fitted = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return np.asarray(fitted, np.uint8)


def _titled(image: Image, title: str) -> Image:
    band = np.full((_BAND, image.shape[1], 3), 255, np.uint8)
    cv2.putText(band, title, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (40, 40, 40), 1, cv2.LINE_AA)
    framed = np.vstack([band, image])
    framed[:, -1] = 255
    return framed
