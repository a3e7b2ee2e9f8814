"""Keyframes of a refinement: spread over the viewpoints, sharp, and showing the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import mesh_bounds
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene.model import Frame
from std_toolkit.scene.scene import Scene

# Number of frames around a viewpoint from which the sharpest is used.
_CANDIDATES = 3

# Number of keyframes that should show each object, if the recording has as many.
_VIEWS_PER_OBJECT = 4


def choose_keyframes(
    scene: Scene, objects: Mapping[int, SE3], *, count: int, always: Sequence[int] = ()
) -> list[Frame]:
    """Registered frames from viewpoints far apart, in recording order.

    Args:
        objects: T_world_obj by object id: frames that show none of them are skipped, and frames
            are added until each object is in view in four of them, if the recording allows it.
        count: number of frames.
        always: ids of frames to use in any case, if they are registered.
    """
    frames = scene.registered_frames()
    centres = [T @ _centre(scene, i) for i, T in objects.items()]
    seen = np.array([_in_view(scene, f, centres) for f in frames]).reshape(len(frames), -1)
    usable = [i for i in range(len(frames)) if seen[i].any()]
    if len(usable) <= count:
        return [frames[i] for i in usable]
    target = np.mean([T.t for T in objects.values()], axis=0)
    where = np.stack([_viewpoint(scene, frames[i], target) for i in usable])
    forced = [k for k, i in enumerate(usable) if frames[i].id in set(always)]
    picks = _spread(where, count, forced)
    chosen = {usable[k] for k in forced}
    for k in picks:
        if k not in forced:
            near = np.argsort(np.linalg.norm(where - where[k], axis=1), kind="stable")
            taken = {usable[j] for j in near[:_CANDIDATES]} - chosen
            chosen.add(
                max(sorted(taken), key=lambda i: _sharpness(scene, frames[i]), default=usable[k])
            )
    for column in range(seen.shape[1]):
        mine = [i for i in usable if seen[i, column] and i not in chosen]
        missing = _VIEWS_PER_OBJECT - sum(seen[i, column] for i in chosen)
        while missing > 0 and mine:
            taken_at = np.stack([_viewpoint(scene, frames[i], target) for i in sorted(chosen)])
            far = max(
                mine,
                key=lambda i: float(
                    np.linalg.norm(taken_at - _viewpoint(scene, frames[i], target), axis=1).min()
                ),
            )
            chosen.add(far)
            mine.remove(far)
            missing -= 1
    return [frames[i] for i in sorted(chosen)]


def _viewpoint(scene: Scene, frame: Frame, target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction from the objects to the camera, including distance."""
    T = scene.T_world_cam(frame.id)
    assert T is not None
    ray = T.t - target
    distance = float(np.linalg.norm(ray))
    return np.append(ray / max(distance, 1e-9), 0.5 * np.log(max(distance, 1e-3)))


def _in_view(scene: Scene, frame: Frame, centres: Sequence[NDArray[np.float64]]) -> list[bool]:
    """Whether the frame shows each of the world points."""
    camera, T_world_cam = scene.camera(frame).without_distortion(), scene.T_world_cam(frame.id)
    assert T_world_cam is not None
    T_cam_world = T_world_cam.inverse()
    flags = []
    for centre in centres:
        p = T_cam_world @ centre
        if p[2] <= 0.05:
            flags.append(False)
            continue
        uv = camera.project(p)
        flags.append(bool((uv >= 0).all() and (uv < camera.size).all()))
    return flags


def _centre(scene: Scene, object_id: int) -> NDArray[np.float64]:
    """Centre of an object's bounding box, mesh frame."""
    return mesh_bounds(scene.mesh(scene.objects.object(object_id).model)).mean(axis=0)


def _spread(where: NDArray[np.float64], count: int, start: list[int]) -> list[int]:
    """Farthest-point sampling; deterministic."""
    picks = list(start)
    if not picks:
        centre = where.mean(axis=0)
        picks = [int(np.argmax(np.linalg.norm(where - centre, axis=1)))]
    distance = np.min([np.linalg.norm(where - where[k], axis=1) for k in picks], axis=0)
    while len(picks) < count:
        k = int(np.argmax(distance))
        if distance[k] <= 0:
            break
        picks.append(k)
        distance = np.minimum(distance, np.linalg.norm(where - where[k], axis=1))
    return picks


def _sharpness(scene: Scene, frame: Frame) -> float:
    """Variance of the Laplacian; -1 for an image that cannot be read."""
    try:
        color = scene.read_color(frame)
    except ToolkitError:
        return -1.0
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
    height = max(1, round(grey.shape[0] * min(1.0, 480 / grey.shape[1])))
    small = cv2.resize(grey, (min(480, grey.shape[1]), height), interpolation=cv2.INTER_AREA)
    return float(cv2.Laplacian(small, cv2.CV_32F).var())
