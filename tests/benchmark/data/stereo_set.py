"""Infrared pairs of a textured plane, exact in every camera."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.data.infrared import InfraredPair
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.io.images import write_png
from tests.dreds_on_disk import dreds_camera, write_dreds_scene, write_equal

SIZE = (320, 180)
LEFT = Camera(*SIZE, 222.0, 222.0, 158.0, 92.0)
COLOR = dreds_camera(SIZE)
BASELINE_M = 0.055
# As of a D415: colour 15 mm beside the left camera, a little turned.
T_COLOR_LEFT = SE3(so3_exp(np.array([0.002, -0.004, 0.003])), np.array([0.015, 0.001, -0.0005]))
# Points X of the plane, in the left camera: NORMAL @ X = DISTANCE_M.
NORMAL = np.array([0.25, -0.3, 1.0]) / np.linalg.norm([0.25, -0.3, 1.0])
DISTANCE_M = 0.7


def plane_depth(camera: Camera, T_camera_left: SE3) -> NDArray[np.float32]:
    """(H, W) z-depth of the plane in a camera, metres."""
    normal = T_camera_left.R @ NORMAL
    distance = DISTANCE_M + normal @ T_camera_left.t
    rays = camera.rays()
    return (distance / (rays @ normal) * rays[..., 2]).astype(np.float32)


def _seen(texture: NDArray[np.uint8], camera: Camera, T_camera_left: SE3) -> NDArray[np.uint8]:
    """The plane's texture in a camera."""
    rays = camera.rays()
    points = rays / rays[..., 2:] * plane_depth(camera, T_camera_left)[..., None]
    points = (points - T_camera_left.t) @ T_camera_left.R  # in the left camera
    across = np.cross([0.0, 1.0, 0.0], NORMAL)
    across /= np.linalg.norm(across)
    down = np.cross(NORMAL, across)
    scale, centre = 400.0, np.array(texture.shape[::-1]) / 2  # texture pixels a metre
    u, v = ((points @ axis * scale + c).astype(np.float32) for axis, c in
            zip((across, down), centre, strict=True))  # fmt: skip
    return cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)  # type: ignore[return-value]


def plane_pair(seed: int = 0) -> InfraredPair:
    """The pair of the plane."""
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 256, (1024, 1024), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 0.8)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    T_right_left = SE3(np.eye(3), np.array([-BASELINE_M, 0.0, 0.0]))
    left = _seen(texture, LEFT, SE3.identity())
    right = _seen(texture, LEFT, T_right_left)
    return InfraredPair(left, right, LEFT, BASELINE_M, T_COLOR_LEFT)


def calibration() -> dict[str, object]:
    """The content of infrared.json."""
    camera = LEFT
    left = {
        "width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy,
        "cx": camera.cx, "cy": camera.cy,
    }  # fmt: skip
    return {"left": left, "baseline_m": BASELINE_M, "T_color_left": T_COLOR_LEFT.flat()}


def write_stereo_scene(folder: Path, frames: int = 2) -> Path:
    """A scene of DREDS whose true depth is the plane, with its infrared pairs."""
    write_dreds_scene(folder, frames=frames, color_size=SIZE, label_size=SIZE)
    for i in range(frames):
        pair = plane_pair(i)
        write_png(folder / f"{i:04d}_ir_l.png", pair.left)
        write_png(folder / f"{i:04d}_ir_r.png", pair.right)
        write_equal(folder / f"{i:04d}_depth_120.exr", plane_depth(COLOR, T_COLOR_LEFT))
    (folder / "infrared.json").write_text(json.dumps(calibration()))
    return folder
