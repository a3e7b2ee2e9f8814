"""Cameras: pixel centres at integers through resizing and cropping, distortion and back."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera, undistort_image
from std_toolkit.geometry.camera_models import largest_radius2
from std_toolkit.geometry.depth_maps import (
    check_depth_unit,
    on_depth_step,
    unproject_depth,
    z_to_distance,
)

PINHOLE = Camera(1280, 720, 912.3, 910.1, 645.2, 355.9)
DISTORTIONS = {
    "none": (),
    "webcam": (0.11, -0.23, 0.0007, -0.0011, 0.09),
    "barrel": (-0.31, 0.12, 0.001, -0.0008),
    "strong_barrel": (-0.4, 0.2, 0.0, 0.0, -0.05),
    "rational": (5.2, 3.1, 0.0002, 0.0001, 0.2, 5.5, 4.6, 0.9),
}
distortions = pytest.mark.parametrize("distortion", DISTORTIONS.values(), ids=DISTORTIONS.keys())


def camera_with(distortion: tuple[float, ...]) -> Camera:
    return Camera(1280, 720, 912.3, 910.1, 645.2, 355.9, distortion)


@distortions
def test_unproject_inverts_project_to_a_millionth_of_a_pixel(distortion: tuple) -> None:
    camera = camera_with(distortion)
    u, v = np.meshgrid(np.linspace(-0.5, 1279.5, 41), np.linspace(-0.5, 719.5, 31))
    pixels = np.stack([u, v], axis=-1)  # corners of the image included
    points = camera.unproject(pixels, np.linspace(0.2, 3, 41))
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-6)


@distortions
def test_projection_is_that_of_opencv(distortion: tuple) -> None:
    camera = camera_with(distortion)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 2], (200, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.K, np.array(distortion or (0.0,) * 4)
    )
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel() -> None:
    assert np.isnan(PINHOLE.project(np.array([[0, 0, 0.0], [0, 0, -1.0]]))).all()


def test_points_outside_the_view_are_not_folded_back_into_the_image() -> None:
    """The polynomial of a barrel lens turns back; OpenCV's projection then lies in the image."""
    camera = Camera(1280, 720, 900, 900, 640, 360, (-0.3, 0.0, 0.0, 0.0))
    aside = np.array([1.8, 0.0, 1.0])
    by_opencv, _ = cv2.projectPoints(
        aside[None], np.zeros(3), np.zeros(3), camera.K, np.array(camera.distortion)
    )
    assert 0 < by_opencv[0, 0, 0] < 1280
    assert np.isnan(camera.project(aside)).all()


def test_pixels_that_no_ray_reaches_have_no_point() -> None:
    camera = Camera(1280, 720, 900, 900, 640, 360, (-0.3, 0.0, 0.0, 0.0))
    assert np.isnan(camera.unproject(np.array([5000.0, 360.0]))[:2]).all()


def half_pixel_resize(uv: np.ndarray, sx: float, sy: float) -> np.ndarray:
    """Where a point of the image is after resizing: image edges stay image edges."""
    return (uv + 0.5) * [sx, sy] - 0.5


sizes = st.tuples(st.integers(16, 4000), st.integers(16, 4000))


@given(sizes, st.sampled_from(list(DISTORTIONS.values())))
def test_resizing_the_camera_is_resizing_the_image(
    size: tuple[int, int], distortion: tuple
) -> None:
    camera = Camera(640, 480, 600, 590, 322, 238, distortion)
    width, height = size
    try:
        resized = camera.resized(width, height)
    except ToolkitError:
        assert not 0.3 < (width / 640) / (height / 480) < 3  # no longer a plausible image
        return
    points = np.array([[-0.2, 0.1, 1.0], [0, 0, 2.0], [0.3, -0.2, 0.9]])
    np.testing.assert_allclose(
        resized.project(points),
        half_pixel_resize(camera.project(points), width / 640, height / 480),
        atol=1e-9,
    )


def test_resizing_agrees_with_the_pixels_of_opencv() -> None:
    """A linear ramp, halved by area averaging, holds the coordinates of the resized pixels."""
    u = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    halved = cv2.resize(u, (32, 24), interpolation=cv2.INTER_AREA)
    expected = half_pixel_resize(np.stack([halved, np.zeros_like(halved)], -1), 0.5, 0.5)[..., 0]
    np.testing.assert_allclose(expected, np.tile(np.arange(32), (24, 1)), atol=1e-6)


@given(st.integers(0, 600), st.integers(0, 400), st.integers(1, 40), st.integers(1, 40))
def test_cropping_shifts_pixels_by_whole_numbers(x: int, y: int, width: int, height: int) -> None:
    crop = PINHOLE.cropped(x, y, width, height)
    assert crop.size == (width, height)
    point = np.array([0.1, -0.2, 1.3])
    np.testing.assert_allclose(crop.project(point), PINHOLE.project(point) - [x, y], atol=1e-9)
    doubled = crop.resized(2 * width, 2 * height)
    np.testing.assert_allclose(
        doubled.project(point), half_pixel_resize(crop.project(point), 2, 2), atol=1e-9
    )


def test_the_centre_of_the_first_pixel_is_the_origin() -> None:
    grid = PINHOLE.pixel_grid()
    assert grid.shape == (720, 1280, 2)
    np.testing.assert_array_equal(grid[0, 0], [0, 0])
    np.testing.assert_array_equal(grid[719, 1279], [1279, 719])
    np.testing.assert_allclose(
        PINHOLE.rays()[10, 20], [(20 - 645.2) / 912.3, (10 - 355.9) / 910.1, 1]
    )


def test_rays_belong_to_the_caller() -> None:
    PINHOLE.rays()[:] = 0
    assert (PINHOLE.rays()[..., 2] == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.float32, np.uint8])
def test_undistorted_images_are_right_to_a_hundredth_of_a_pixel(kind: type) -> None:
    """Blobs of known place in the distorted image are found where the pinhole camera sees them."""
    camera = camera_with(DISTORTIONS["barrel"])
    u, v = np.meshgrid(np.linspace(90, 1190, 9), np.linspace(80, 640, 6))
    points = camera.without_distortion().unproject(np.stack([u, v], -1).reshape(-1, 2))
    image = np.zeros((720, 1280))
    # The pattern is drawn in the scene (wide smooth blobs on the plane z = 1), seen by the lens.
    rays = camera.rays()[..., :2]
    for point in points:
        image += np.exp(-((rays - point[:2]) ** 2).sum(-1) / (2 * (6 / 912) ** 2))
    image = (image * 255).round().astype(np.uint8) if kind is np.uint8 else image.astype(kind)
    seen = undistort_image(image, camera)
    pinhole = camera.without_distortion()
    expected = pinhole.project(points)
    # 8-bit rounding alone moves a centroid by a few thousandths of a pixel.
    errors = [np.linalg.norm(centroid(seen, e) - e) for e in expected]
    assert np.median(errors) < 0.01
    assert max(errors) < (0.01 if kind is np.float32 else 0.03)


def centroid(image: np.ndarray, near: np.ndarray) -> np.ndarray:
    x, y = np.rint(near).astype(int)
    reach = 26
    v, u = np.mgrid[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]
    inside = (u - near[0]) ** 2 + (v - near[1]) ** 2 < 25**2
    weights = np.where(inside, image[v, u], 0).astype(np.float64)
    return np.array([(u * weights).sum(), (v * weights).sum()]) / weights.sum()


def test_undistorting_a_mask_mixes_no_ids() -> None:
    camera = camera_with(DISTORTIONS["barrel"])
    mask = np.zeros((720, 1280), dtype=np.uint16)
    mask[200:400, 300:600] = 254
    seen = undistort_image(mask, camera, interpolation=cv2.INTER_NEAREST)
    assert set(np.unique(seen)) == {0, 254}
    flags = undistort_image(mask > 0, camera, interpolation=cv2.INTER_NEAREST)
    np.testing.assert_array_equal(flags, seen > 0)


def test_undistorting_refuses_another_size() -> None:
    with pytest.raises(ToolkitError, match="1280x720"):
        undistort_image(np.zeros((480, 640), np.uint8), PINHOLE)


def test_depth_is_along_the_axis_and_distance_along_the_ray() -> None:
    """A wall facing the camera has one depth; its corners are farther away than its middle."""
    camera = Camera(5, 3, 2.0, 2.0, 2.0, 1.0)
    depth = np.full((3, 5), 2.0)
    points = unproject_depth(depth, camera)
    np.testing.assert_array_equal(points[..., 2], depth)
    distance = z_to_distance(depth, camera)
    np.testing.assert_allclose(distance, np.linalg.norm(points, axis=-1))
    assert distance[1, 2] == 2.0
    assert distance[0, 0] == pytest.approx(2 * np.sqrt(1 + 1 + 0.25))


def test_missing_depth_has_no_point() -> None:
    camera = Camera(5, 3, 2.0, 2.0, 2.0, 1.0)
    assert (unproject_depth(np.zeros((3, 5)), camera) == 0).all()
    assert (z_to_distance(np.zeros((3, 5)), camera) == 0).all()
    with pytest.raises(ToolkitError, match="5x3"):
        unproject_depth(np.zeros((5, 3)), camera)


def scaled(factor_x: float, factor_y: float) -> tuple:
    """D435-like intrinsics of a 640x480 image, resized without telling the width and height."""
    return (615 * factor_x, 615 * factor_y, 320 * factor_x, 240 * factor_y)


@pytest.mark.parametrize("factor", [0.25, 0.5, 1.5, 2, 4])
def test_intrinsics_of_another_image_size_are_refused(factor: float) -> None:
    Camera(640, 480, *scaled(1, 1))
    with pytest.raises(ToolkitError, match="another image size"):
        Camera(640, 480, *scaled(factor, factor))


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"width": 0}, "width"),
        ({"width": 640.5}, "width"),
        ({"height": -480}, "height"),
        ({"fx": np.nan}, "fx"),
        ({"fy": -600}, "fy"),
        ({"cx": np.inf}, "cx"),
        ({"fx": 60}, "fx"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
        ({"distortion": (0.1, np.nan, 0, 0)}, "distortion"),
    ],
)
def test_impossible_cameras_are_refused_by_name(changed: dict, field: str) -> None:
    good = {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240}
    with pytest.raises(ToolkitError, match=rf"^{field}: "):
        Camera(**{**good, **changed})


def test_numbers_of_numpy_become_plain() -> None:
    camera = Camera(np.int64(640), np.int32(480), *np.array([600.0, 600, 320, 240]))
    assert type(camera.width) is int
    assert type(camera.fx) is float
    assert camera == Camera(640, 480, 600, 600, 320, 240)


@pytest.mark.parametrize("turned", [False, True])
def test_a_depth_step_is_one_pixel_wide_on_either_side(turned: bool) -> None:
    camera_depth = np.full((9, 12), 1.0, np.float32)
    camera_depth[:, 6:] = 2.0
    found = on_depth_step(camera_depth.T if turned else camera_depth)
    assert np.flatnonzero((found.T if turned else found).any(axis=0)).tolist() == [5, 6]
    assert (found.T if turned else found)[:, 5:7].all()


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        ((-0.25, 0.0, 0.0, 0.0), 4 / 3),
        ((-0.5, 0.0, 0.0, 0.0), 2 / 3),
        ((0.1, 0.0, 0.0, 0.0), np.inf),
        ((0.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0), 0.5),  # the denominator
    ],
)
def test_the_radius_at_which_a_lens_folds(distortion: tuple[float, ...], expected: float) -> None:
    """r (1 + k1 r^2) increases while 1 + 3 k1 r^2 is positive."""
    assert largest_radius2(distortion) == pytest.approx(expected)


def test_a_point_that_is_barely_behind_the_camera_has_no_pixel() -> None:
    assert np.isnan(PINHOLE.project(np.array([[0.1, 0.1, -0.5], [0.1, 0.1, 0.0]]))).all()


@pytest.mark.parametrize("factor", [0.19, 20.5])
def test_a_focal_length_that_does_not_fit_the_image_is_refused(factor: float) -> None:
    Camera(100, 100, 100.0 * (0.2 if factor < 1 else 20), 100.0, 49.5, 49.5)
    with pytest.raises(ToolkitError, match="does not fit a 100x100 image"):
        Camera(100, 100, 100.0 * factor, 100.0, 49.5, 49.5)


@pytest.mark.parametrize("metres", [0.001, 100.0])
def test_an_implausible_median_depth_is_refused(tmp_path: Path, metres: float) -> None:
    with pytest.raises(ToolkitError, match="median depth is implausible"):
        check_depth_unit(tmp_path, np.full((80, 80), metres, np.float32), 0.001)
    check_depth_unit(tmp_path, np.full((80, 80), 0.7, np.float32), 0.001)


@pytest.mark.parametrize(
    "distortion",
    [
        (-0.3, 0.03),
        (0.1, -0.3, 0.0, 0.0, 0.05, 0.2, 0.4, -0.3),
        (0.2, -0.1, 0.0, 0.0, 0.0, 0.5, -0.9),
    ],
)
def test_the_radius_of_distortion_ends_where_it_stops_growing(distortion: tuple) -> None:
    k1, k2, _, _, k3, k4, k5, k6 = (*distortion, *[0.0] * (8 - len(distortion)))
    r = np.linspace(0, 4, 400_001)
    s = r * r
    top, bottom = 1 + k1 * s + k2 * s**2 + k3 * s**3, 1 + k4 * s + k5 * s**2 + k6 * s**3
    shrinks = (np.diff(r * top / bottom) <= 0) | (bottom[1:] <= 0)
    assert shrinks.any()
    assert np.sqrt(largest_radius2(distortion)) == pytest.approx(r[np.argmax(shrinks)], abs=1e-4)


def test_distortion_of_no_lens_is_refused() -> None:
    with pytest.raises(ToolkitError, match="distortion"):
        Camera(640, 480, 600, 600, 320, 240, (1e9, 0, 0, 0))
