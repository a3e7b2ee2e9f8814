"""A small recording with exact truth: a textured table and two blocks, seen along an arc."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene import CameraModel, Frame, Frames, Scene, SceneInfo

CAMERA = Camera(480, 360, 420.0, 421.0, 238.0, 182.5)
# (height, half size, centre x, centre y): the table and the tops of two blocks, metres.
PLANES = ((0.0, 0.60, 0.0, 0.0), (0.06, 0.08, 0.12, 0.05), (0.11, 0.07, -0.13, -0.04))
DEPTH_SCALE = 0.0001


@dataclass(frozen=True)
class Recording:
    """Images, depth and true poses."""

    colors: list[NDArray[np.uint8]]
    depths: list[NDArray[np.float32]]
    truth: list[SE3]  # T_world_cam

    def write(self, root: Path, *, depth: bool = True, factor: float = 1.0) -> Scene:
        frames = []
        for i, color in enumerate(self.colors):
            name = f"{i:06d}"
            write_color(root / "color" / f"{name}.png", color)
            if depth:
                path = root / "depth" / f"{name}.png"
                write_depth_png16(path, self.depths[i] * factor, scale=DEPTH_SCALE)
            frames.append(
                Frame(
                    id=i,
                    name=name,
                    color=f"color/{name}.png",
                    depth=f"depth/{name}.png" if depth else None,
                )
            )
        info = SceneInfo(
            name="blocks",
            cameras={"color": CameraModel.of(CAMERA)},
            depth_scale=DEPTH_SCALE if depth else None,
        )
        return Scene.create(root, info, Frames(frames=frames))


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> SE3:
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), eye)


def render(T_world_cam: SE3, textures: list[NDArray[np.uint8]]) -> tuple[NDArray, NDArray]:
    rays = CAMERA.rays() @ T_world_cam.R.T
    best = np.full(rays.shape[:2], np.inf)
    color = np.full((*rays.shape[:2], 3), 90, dtype=np.uint8)
    for (height, half, cx, cy), texture in zip(PLANES, textures, strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (height - T_world_cam.t[2]) / rays[..., 2]
        p = T_world_cam.t + z[..., None] * rays
        x, y = p[..., 0] - cx, p[..., 1] - cy
        hit = (z > 0) & (z < best) & (np.abs(x) < half) & (np.abs(y) < half)
        size = texture.shape[0]
        u = ((x / half + 1) / 2 * size - 0.5).astype(np.float32)
        v = ((y / half + 1) / 2 * size - 0.5).astype(np.float32)
        sampled = cv2.remap(texture, u, v, cv2.INTER_LINEAR)
        color[hit] = sampled[hit]
        best[hit] = z[hit]
    depth = np.where(np.isfinite(best), best, 0).astype(np.float32)
    return color, depth


def make_recording(count: int, *, arc_deg: float = 60.0, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    textures = []
    for _, half, _, _ in PLANES:
        size = int(2 * half / 0.001)
        noise = rng.normal(size=(size, size, 3))
        fine, coarse = (cv2.GaussianBlur(noise, (0, 0), s) * s for s in (2.0, 6.0))
        textures.append(np.clip(128 + 110 * (fine + coarse), 0, 255).astype(np.uint8))
    colors, depths, truth = [], [], []
    for i in range(count):
        a = np.radians(arc_deg * (i / (count - 1) - 0.5))
        eye = np.array([0.55 * np.sin(a), -0.55 * np.cos(a), 0.45 + 0.03 * np.sin(3 * a)])
        T = look_at(eye, np.array([0.02 * np.sin(5 * a), 0.0, 0.02]))
        color, depth = render(T, textures)
        colors.append(color)
        depths.append(depth)
        truth.append(T)
    return Recording(colors, depths, truth)


@pytest.fixture(scope="session")
def recording() -> Recording:
    return make_recording(14)
