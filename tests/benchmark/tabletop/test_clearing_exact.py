"""What the camera truly sees of the table, and what lies behind."""

import numpy as np
import pytest

from benchmark.data.frame import BACKGROUND
from benchmark.tabletop.sense import ExactCamera, camera_pose
from std_toolkit.geometry.se3 import SE3
from tests.benchmark.tabletop.clearing_cases import CAMERA, box, standing

POSE = camera_pose()


def _pixel(point: tuple[float, float, float]) -> tuple[int, int]:
    u, v = CAMERA.project(POSE.inverse() @ np.array(point))
    return round(float(v)), round(float(u))


def test_an_empty_table_is_a_plane():
    view = ExactCamera(CAMERA, POSE).observe([], [])
    world = POSE @ (CAMERA.rays() * view.depth[..., None]).reshape(-1, 3)
    assert np.abs(world[:, 2]).max() < 1e-6
    assert (view.mask == BACKGROUND).all()
    assert np.array_equal(view.behind, view.depth)


def test_behind_an_object_is_the_next_one_and_behind_that_the_table():
    near, far = box((0.06, 0.02, 0.2), "near"), box((0.2, 0.02, 0.16), "far")
    poses = [standing(near, y=-0.05), standing(far, y=0.05)]
    view = ExactCamera(CAMERA, POSE).observe([near, far], poses)
    front = _pixel((0, -0.06, 0.19))
    assert view.mask[front] == 0
    ray = CAMERA.rays()[front]
    eye, direction = POSE.t, POSE.R @ ray
    # Along the pixel's ray to the planes of the two front sides.
    assert view.depth[front] == pytest.approx((-0.06 - eye[1]) / direction[1], abs=1e-4)
    assert view.behind[front] == pytest.approx((0.04 - eye[1]) / direction[1], abs=1e-4)
    back = _pixel((0.08, 0.04, 0.12))
    assert view.mask[back] == 1
    assert view.behind[back] == pytest.approx(-eye[2] / (POSE.R @ CAMERA.rays()[back])[2], abs=1e-4)
    assert view.normals[front] @ (POSE.inverse().R @ [0, -1, 0]) == pytest.approx(1, abs=1e-3)


def test_what_is_out_of_view_is_not_there():
    thing = box((0.05, 0.05, 0.05))
    view = ExactCamera(CAMERA, POSE).observe([thing], [SE3(np.eye(3), np.array([3.0, 0, 0.025]))])
    assert (view.mask == BACKGROUND).all()
