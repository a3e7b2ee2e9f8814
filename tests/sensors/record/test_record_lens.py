"""librealsense's calibration as the toolkit's, against librealsense's own projection."""

from __future__ import annotations

import numpy as np
import pytest

from sensors.record.calibration import camera_model, pose
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3

rs = pytest.importorskip("pyrealsense2")
from tests.sensors.record.software_camera import rs_extrinsics, rs_intrinsics  # noqa: E402

PLAIN = Camera(1280, 720, 645.0, 644.0, 641.5, 366.2)
# A wide lens whose corners are 8 px off. Tangential terms are large, for the models to differ.
COEFFICIENTS = (-0.0563, 0.0661, -0.0026, 0.0015, -0.0213)
PIXELS = [
    (5.0, 3.0),
    (640.0, 360.0),
    (1270.0, 10.0),
    (20.0, 700.0),
    (900.0, 500.0),
    (1275.0, 715.0),
]


def test_no_distortion() -> None:
    for model in (
        rs.distortion.none,
        rs.distortion.brown_conrady,
        rs.distortion.inverse_brown_conrady,
    ):
        camera, note = camera_model(rs_intrinsics(PLAIN, model), "color")
        np.testing.assert_allclose(camera.camera().K, PLAIN.K, rtol=1e-6)
        assert camera.distortion == [] and note == ""


def test_inverse_brown_conrady() -> None:
    """As librealsense deprojects with it, whatever its name says."""
    intrinsics = rs_intrinsics(PLAIN, rs.distortion.inverse_brown_conrady, COEFFICIENTS)
    model, note = camera_model(intrinsics, "color")
    assert "inverse_brown_conrady" in note
    for pixel in PIXELS:
        point = rs.rs2_deproject_pixel_to_point(intrinsics, list(pixel), 0.8)
        assert model.camera().project(np.array(point)) == pytest.approx(pixel, abs=0.05)
        assert rs.rs2_project_point_to_pixel(intrinsics, point) == pytest.approx(pixel, abs=0.05)


@pytest.mark.parametrize(
    "kind", ["brown_conrady", "modified_brown_conrady", "inverse_brown_conrady"]
)
def test_forward_models(kind: str) -> None:
    intrinsics = rs_intrinsics(PLAIN, getattr(rs.distortion, kind), COEFFICIENTS)
    model, _ = camera_model(intrinsics, "color")
    for u, v in PIXELS:
        point = [(u - PLAIN.cx) / PLAIN.fx * 0.7, (v - PLAIN.cy) / PLAIN.fy * 0.7, 0.7]
        theirs = rs.rs2_project_point_to_pixel(intrinsics, point)
        assert model.camera().project(np.array(point)) == pytest.approx(theirs, abs=0.05)


def test_a_lens_that_opencv_cannot_tell_is_refused() -> None:
    bad = rs_intrinsics(PLAIN, rs.distortion.modified_brown_conrady, (-0.9, 0.9, 0.05, 0.05, 0.5))
    with pytest.raises(ToolkitError, match="OpenCV's model"):
        camera_model(bad, "color")
    fisheye = rs_intrinsics(PLAIN, rs.distortion.kannala_brandt4, (0.1, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(ToolkitError, match="lens model"):
        camera_model(fisheye, "color")


def test_pose_is_read_by_columns() -> None:
    T = SE3.exp([0.015, -0.002, 0.001, 0.02, -0.3, 0.1])
    found = pose(rs_extrinsics(T))
    np.testing.assert_allclose(found.R, T.R, atol=1e-6)
    np.testing.assert_allclose(found.t, T.t, atol=1e-7)
    point = [0.1, -0.2, 0.9]
    theirs = rs.rs2_transform_point_to_point(rs_extrinsics(T), point)
    np.testing.assert_allclose(found @ np.array(point), theirs, atol=1e-6)
