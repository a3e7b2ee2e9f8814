"""Sensor depth on the visible surface of an object: point-to-plane, robust to holes and edges."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine.caster import Patch

Array = NDArray[np.float64]

# Stereo depth smears over borders, and grazing surfaces are measured badly.
_BORDER_PX = 3
_SMALLEST_COSINE = 0.3


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """Model points and what the sensor measured on the same rays.

    Attributes:
        points: (N, 3) on the model's surface, world frame.
        normals: (N, 3) of the surface there, world frame, towards the camera.
        directions: (N, 3) of the rays in the world frame, scaled to z = 1 in the camera.
        measured: (N,) sensor z-depth, metres, as read.
        expected: (N,) z-depth of the model, metres.
    """

    points: Array
    normals: Array
    directions: Array
    measured: Array
    expected: Array


def sample_depth(
    patch: Patch,
    index: int,
    depth: NDArray[np.float32],
    camera: Camera,
    T_world_cam: SE3,
    *,
    gate_m: float,
    limit: int = 400,
) -> DepthSamples | None:
    """Depth samples on object `index`, at most `limit`, spread evenly; None if too few.

    Args:
        gate_m: samples further than this from the model along the ray are of something else.
    """
    mask = (patch.hits.object == index).astype(np.uint8)
    mask = cv2.erode(mask, np.ones((3, 3), np.uint8), iterations=_BORDER_PX)
    h, w = mask.shape
    sensor = depth[patch.y : patch.y + h, patch.x : patch.x + w]
    good = (mask > 0) & (sensor > 0) & (np.abs(sensor - patch.hits.depth) < gate_m)
    v, u = np.nonzero(good)
    if len(v) < 20:
        return None
    if len(v) > limit:
        keep = np.linspace(0, len(v) - 1, limit).round().astype(int)
        v, u = v[keep], u[keep]
    expected = patch.hits.depth[v, u].astype(np.float64)
    rays = camera.unproject(np.stack([u + patch.x, v + patch.y], axis=-1).astype(np.float64))
    directions = rays @ T_world_cam.R.T
    normals = patch.hits.normal[v, u].astype(np.float64)
    cosine = -(normals * directions).sum(axis=1) / np.linalg.norm(directions, axis=1)
    seen = cosine > _SMALLEST_COSINE
    if seen.sum() < 20:
        return None
    directions, expected = directions[seen], expected[seen]
    return DepthSamples(
        T_world_cam.t + directions * expected[:, None],
        normals[seen],
        directions,
        sensor[v, u].astype(np.float64)[seen],
        expected,
    )
