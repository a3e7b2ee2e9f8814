"""A simulated annotator: the true pose, as well as a person with a mouse finds it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sensors.synthetic.recording import Truth
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.io.atomic import atomic_path


def annotate_first_frame(
    truth: Truth,
    *,
    frame: int = 0,
    extents_m: dict[str, float],
    pixels: float = 1.0,
    degrees: float = 1.0,
    seed: int = 0,
) -> dict[str, SE3]:
    """T_cam_obj of every object in one frame, with an annotator's error.

    Sideways the pose is off by `pixels` (standard deviation per axis). Along the viewing ray it
    is off by what changes the size of the silhouette by `pixels`: at 0.7 m and f = 600 px one
    pixel on an object of 100 mm is 1.2 mm sideways but 8 mm in depth.

    Args:
        extents_m: size of each object across the view, metres, by name.
    """
    rng = np.random.default_rng(seed)
    T_cam_world = truth.camera_pose(frame).inverse()
    f = truth.camera.fx
    labels = {}
    for item in truth.objects:
        exact = T_cam_world @ SE3.from_matrix(item.T_world_obj)
        z = exact.t[2]
        sideways = rng.normal(0, pixels, 2) * z / f
        along = rng.normal(0, pixels) * z / f * z / extents_m[item.name]
        ray = exact.t / z
        axis = rng.normal(size=3)
        turn = so3_exp(axis / np.linalg.norm(axis) * np.radians(rng.normal(0, degrees)))
        labels[item.name] = SE3(turn @ exact.R, exact.t + along * ray + np.array([*sideways, 0.0]))
    return labels


def write_annotations(truth: Truth, recording: Path) -> dict[str, Path]:
    """The simulated first-frame poses as files for `std-curate label --pose`.

    Returns:
        By object name, `recording/annotation/NAME.txt`: T_cam_obj in frame 0, 4x4, metres.
    """
    extents = {
        item.name: float(np.max(load_mesh(recording / item.mesh).extents)) for item in truth.objects
    }
    paths = {}
    for name, pose in annotate_first_frame(truth, extents_m=extents).items():
        paths[name] = recording / "annotation" / f"{name}.txt"
        with atomic_path(paths[name]) as temporary:
            np.savetxt(temporary, pose.matrix(), fmt="%.9f")
    return paths
