"""A box with a texture, and pictures of it from an arc of cameras."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh
from PIL import Image

from std_toolkit.geometry import SE3, Camera, Symmetry, so3_exp
from std_toolkit.geometry.surface_colors import SurfaceColors
from std_toolkit.labels.refine.problem import RefineObject, RefineView
from std_toolkit.rendering.texture import TexturedSurface

CAMERA = Camera(320, 240, 420.0, 420.0, 159.5, 119.5)
SIZE = np.array([0.12, 0.05, 0.18])


def box_mesh(image: Image.Image | None) -> trimesh.Trimesh:
    """A box about the origin; each face shows its own sixth of the picture."""
    corners, uv, faces = [], [], []
    for axis in range(3):
        for side in (-1, 1):
            i, j = (m for m in range(3) if m != axis)
            number = 2 * axis + (side > 0)
            u0, v0 = (number % 3) / 3, (number // 3) / 2
            start = len(corners)
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                p = np.zeros(3)
                p[axis], p[i], p[j] = side, a, b
                corners.append(p * SIZE / 2)
                uv.append([u0 + (a + 1) / 6, v0 + (b + 1) / 4])
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    mesh = trimesh.Trimesh(np.array(corners), np.array(faces), process=False)
    if image is not None:
        mesh.visual = trimesh.visual.TextureVisuals(uv=np.array(uv), image=image)
    return mesh


def textured_picture(seed: int) -> Image.Image:
    """Letters and patches in many colours."""
    random = np.random.default_rng(seed)
    picture = np.full((256, 384, 3), 220, np.uint8)
    for _ in range(120):
        x, y = random.integers(0, 384), random.integers(0, 256)
        color = tuple(int(c) for c in random.integers(0, 255, 3))
        if random.random() < 0.5:
            w, h = random.integers(8, 40, 2)
            cv2.rectangle(picture, (int(x), int(y)), (int(x + w), int(y + h)), color, -1)
        else:
            text = chr(65 + int(random.integers(26)))
            cv2.putText(picture, text, (int(x), int(y)), 0, 1.2, color, 3)
    return Image.fromarray(picture)


def box_object(mesh: trimesh.Trimesh, pose: SE3, symmetry: Symmetry | None = None) -> RefineObject:
    return RefineObject(
        "box",
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces, dtype=np.int64),
        pose,
        symmetry=symmetry or Symmetry(),
        texture=TexturedSurface.from_mesh(mesh),
    )


def cameras(count: int) -> list[SE3]:
    """Camera poses on an arc about the origin, half a metre away."""
    found = []
    for angle in np.linspace(-0.9, 0.9, count):
        R = so3_exp([0, angle, 0]) @ so3_exp([0.45, 0, 0])
        found.append(SE3(R, R @ np.array([0, 0, -0.5])))
    return found


def photos(
    mesh: trimesh.Trimesh,
    pose: SE3,
    *,
    gain: tuple[float, ...] = (1, 1, 1),
    seed: int = 0,
    where: Sequence[SE3] | None = None,
) -> list[RefineView]:
    """Pictures of the mesh before a grey table, lit from one side, with noise."""
    surface = TexturedSurface.from_mesh(mesh)
    random = np.random.default_rng(seed)
    views = []
    for number, T in enumerate(cameras(4) if where is None else where):
        image = np.full((240, 320, 3), 120.0)
        T_cam_obj = T.inverse() @ pose
        if surface is None:
            plain = TexturedSurface(
                np.asarray(mesh.vertices, dtype=np.float64),
                mesh.faces,
                SurfaceColors(np.full((len(mesh.faces), 3, 3), 180, np.float32), None),
            )
            drawn = plain.draw(CAMERA, T_cam_obj)
        else:
            drawn = surface.draw(CAMERA, T_cam_obj)
        assert drawn is not None
        h, w = drawn.mask.shape
        light = 0.55 + 0.45 * np.clip(drawn.normal @ (pose.R.T @ [0.6, -0.5, -0.6]), 0, 1)
        part = image[drawn.y : drawn.y + h, drawn.x : drawn.x + w]
        part[drawn.mask] = (drawn.color * light[..., None])[drawn.mask]
        image = image * np.array(gain) + random.normal(0, 4, image.shape)
        views.append(RefineView(CAMERA, T, np.clip(image, 0, 255).astype(np.uint8), frame=number))
    return views


POSE = SE3(so3_exp([1.4, 0.1, 0.2]), np.array([0.01, 0.0, 0.02]))
HALF = SE3(so3_exp([0, 0, np.pi]), np.zeros(3))
