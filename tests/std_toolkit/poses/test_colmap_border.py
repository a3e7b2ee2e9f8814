"""The border to COLMAP: half a pixel, camera models, pose direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.colmap import (
    from_colmap_camera,
    from_colmap_pixels,
    from_rigid3d,
    to_colmap_camera,
    to_colmap_pixels,
    to_rigid3d,
)


@pytest.mark.parametrize(
    "distortion",
    [
        (),
        (-0.1, 0.05, 0.001, -0.002),
        (-0.1, 0.05, 0.001, -0.002, 0.01),
        (-0.1, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005),
    ],
)
def test_projection_agrees_to_a_hundredth_of_a_pixel(distortion: tuple[float, ...]) -> None:
    camera = Camera(640, 480, 600.0, 605.0, 322.0, 236.0, distortion)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.2], size=(50, 3))
    theirs = to_colmap_camera(camera, 1).img_from_cam(points)
    assert np.abs(from_colmap_pixels(theirs) - camera.project(points)).max() < 1e-6
    back = from_colmap_camera(to_colmap_camera(camera, 1))
    assert np.allclose(back.project(points), camera.project(points), atol=1e-9)


MODELS = {
    "SIMPLE_PINHOLE": (600, 322.5, 236.5),
    "PINHOLE": (600, 605, 322.5, 236.5),
    "SIMPLE_RADIAL": (600, 322.5, 236.5, -0.1),
    "RADIAL": (600, 322.5, 236.5, -0.1, 0.05),
    "OPENCV": (600, 605, 322.5, 236.5, -0.1, 0.05, 0.001, -0.002),
    "FULL_OPENCV": (600, 605, 322.5, 236.5, -0.1, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005),
    "SIMPLE_FISHEYE": (600, 322.5, 236.5),
    "FISHEYE": (600, 605, 322.5, 236.5),
    "SIMPLE_RADIAL_FISHEYE": (600, 322.5, 236.5, 0.03),
    "RADIAL_FISHEYE": (600, 322.5, 236.5, 0.03, 0.005),
    "OPENCV_FISHEYE": (600, 605, 322.5, 236.5, 0.03, 0.005, 0.0007, 0.0001),
}


@pytest.mark.parametrize("model", MODELS)
def test_each_model_of_colmap_projects_as_colmap_does(model: str) -> None:
    params = np.array(MODELS[model], float)
    theirs = pycolmap.Camera(model=model, width=640, height=480, params=params, camera_id=1)
    ours = from_colmap_camera(theirs)
    points = np.random.default_rng(0).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.2], size=(200, 3))
    expected = from_colmap_pixels(theirs.img_from_cam(points))
    assert np.abs(ours.project(points) - expected).max() < 1e-6
    again = to_colmap_camera(ours, 1)
    assert np.abs(from_colmap_pixels(again.img_from_cam(points)) - expected).max() < 1e-6
    rays = ours.unproject(expected)
    assert np.allclose(rays, points / points[:, 2:], atol=1e-8)


@pytest.mark.parametrize("model", ["THIN_PRISM_FISHEYE", "FOV", "EUCM", "DIVISION"])
def test_other_models_of_colmap_are_refused_by_name(model: str, tmp_path: Path) -> None:
    number = pycolmap.CameraModelId.__members__[model]
    theirs = pycolmap.Camera.create_from_model_id(1, number, 500, 640, 480)
    with pytest.raises(ToolkitError, match=model):
        from_colmap_camera(theirs)
    scene = pycolmap.Reconstruction()
    scene.add_camera_with_trivial_rig(theirs)
    image = pycolmap.Image(name="0.png", camera_id=1, image_id=1)
    scene.add_image_with_trivial_frame(image, to_rigid3d(SE3.identity()))
    scene.write(tmp_path)
    # Only where no other intrinsics are given is that an error.
    problem = str(read_cameras(tmp_path).lens_problem)
    assert tmp_path.name in problem and model in problem


def test_detected_blob_is_at_its_centre() -> None:
    y, x = np.mgrid[:120, :160]
    image = np.zeros((120, 160))
    for u, v in ((60, 40), (100, 80)):
        image += 250 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 3.0**2))
    from std_toolkit.poses.features import _extractor

    keypoints, _ = _extractor(False, False, 100).extract_from_uint8_array(image.astype(np.uint8))
    uv = pycolmap.keypoints_to_matrix(keypoints)[:, :2]
    # What COLMAP reports is half a pixel more than the toolkit's pixel.
    assert np.linalg.norm(from_colmap_pixels(uv) - [60, 40], axis=1).min() < 0.01
    assert np.allclose(to_colmap_pixels(from_colmap_pixels(uv)), uv, atol=1e-5)


def test_pose_direction() -> None:
    T_cam_world = SE3.exp([0.1, 0.2, 0.3, 0.4, -0.5, 0.6])
    rigid = to_rigid3d(T_cam_world)
    p = np.array([0.3, -0.2, 1.0])
    assert np.allclose(rigid * p, T_cam_world @ p)
    assert np.allclose(from_rigid3d(rigid).matrix(), T_cam_world.matrix(), atol=1e-12)
