"""Every lens model against its reference projection, and its inverse."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.geometry.camera_models import MODELS, lens_of

SIZE = (1280, 720)


def by_opencv(camera: Camera, points: np.ndarray) -> np.ndarray:
    k = np.array(camera.opencv_distortion)
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, k)[0][:, 0]


def by_fisheye(camera: Camera, points: np.ndarray) -> np.ndarray:
    k = np.array(camera.distortion)
    return cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.K, k)[0][
        :, 0
    ]


coefficient = st.floats(-0.4, 0.4)
tangential = st.floats(-2e-3, 2e-3)
# Coefficients to draw, and the reference projection, by model.
LENSES: dict[str, tuple[st.SearchStrategy, Callable[[Camera, np.ndarray], np.ndarray]]] = {
    "opencv": (
        st.one_of(
            st.just(()),
            st.tuples(coefficient, coefficient, tangential, tangential),
            st.tuples(coefficient, coefficient, tangential, tangential, coefficient),
            st.tuples(*2 * [coefficient], *2 * [tangential], *4 * [coefficient]),
        ),
        by_opencv,
    ),
    "fisheye": (st.tuples(*4 * [st.floats(-0.1, 0.1)]), by_fisheye),
}
models = pytest.mark.parametrize("model", LENSES)


def test_every_model_is_compared() -> None:
    assert LENSES.keys() == MODELS.keys()


def camera_of(data: st.DataObject, model: str) -> Camera:
    # From a fisheye's field of view to that of a telephoto lens.
    f = data.draw(st.floats(260, 2500))
    distortion = data.draw(LENSES[model][0])
    return Camera(*SIZE, f, f * data.draw(st.floats(0.9, 1.1)), 651.3, 352.8, distortion, model)


def rays_before_the_fold(camera: Camera, share: float) -> np.ndarray:
    """(N, 2) normalised rays up to a share of the angle at which a lens folds."""
    radius = np.linspace(0, 4, 4001)
    seen = camera.project(np.stack([radius, 0 * radius, 0 * radius + 1], axis=-1))[:, 0]
    end = radius[np.isfinite(seen)][-1]
    r, turn = np.meshgrid(np.linspace(0, share * end, 25), np.arange(0, 6.28, 0.4))
    return np.stack([r * np.cos(turn), r * np.sin(turn)], axis=-1).reshape(-1, 2)


@models
@given(data=st.data())
def test_projection_is_that_of_opencv_to_a_millionth_of_a_pixel(
    model: str, data: st.DataObject
) -> None:
    camera = camera_of(data, model)
    rays = rays_before_the_fold(camera, 0.95)
    points = np.column_stack([rays, np.ones(len(rays))]) * data.draw(st.floats(0.1, 5))
    found = camera.project(points)
    expected = LENSES[model][1](camera, points)
    near = np.abs(expected).max(axis=1) < 1e5  # pixels
    np.testing.assert_allclose(found[near], expected[near], atol=1e-6)


@models
@given(data=st.data())
def test_every_pixel_is_inverted_or_has_no_ray(model: str, data: st.DataObject) -> None:
    camera = camera_of(data, model)
    u, v = np.meshgrid(np.linspace(-0.5, SIZE[0] - 0.5, 21), np.linspace(-0.5, SIZE[1] - 0.5, 13))
    pixels = np.stack([u, v], axis=-1)
    points = camera.unproject(pixels, 0.7)
    there = np.isfinite(points).all(axis=-1)
    assert there[6, 10]  # the centre
    np.testing.assert_allclose(camera.project(points[there]), pixels[there], atol=1e-6)


@models
@given(data=st.data())
def test_rays_before_the_fold_come_back(model: str, data: st.DataObject) -> None:
    """Nothing that projects into the image is lost, also where iterations diverge."""
    camera = camera_of(data, model)
    rays = rays_before_the_fold(camera, 0.9)
    pixels = camera.project(np.column_stack([rays, np.ones(len(rays))]))
    seen = (np.abs(pixels - [640, 360]) < [640.5, 360.5]).all(axis=1)
    assume(seen.any())
    back = camera.unproject(pixels[seen])
    np.testing.assert_allclose(camera.project(back), pixels[seen], atol=1e-6)
    np.testing.assert_allclose(back[:, :2], rays[seen], atol=1e-4)


@pytest.mark.parametrize(
    ("model", "distortion", "fold"),
    [
        ("opencv", (-0.3, 0.0, 0.0, 0.0), np.sqrt(1 / 0.9)),
        ("opencv", (0.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0), np.sqrt(0.5)),
        ("fisheye", (-0.5, 0.0, 0.0, 0.0), np.tan(np.sqrt(2 / 3))),
    ],
)
def test_beyond_the_fold_there_is_no_pixel_and_no_ray(
    model: str, distortion: tuple, fold: float
) -> None:
    camera = Camera(640, 480, 400, 400, 320, 240, distortion, model)
    before = camera.project(np.array([0.999 * fold, 0, 1]))
    assert np.isfinite(before).all()
    assert np.isnan(camera.project(np.array([1.001 * fold, 0, 1]))).all()
    if before[0] < 1e5:
        assert np.isfinite(camera.unproject(before)).all()
        assert np.isnan(camera.unproject(before + np.array([2.0, 0]))[:2]).all()


@pytest.mark.parametrize("model", LENSES)
def test_no_pixels_have_no_rays(model: str) -> None:
    distortion = {"opencv": (-0.28, 0.07, 0.0, 0.0), "fisheye": (0.03, 0.0, 0.0, 0.0)}[model]
    camera = Camera(64, 48, 60, 60, 31.5, 23.5, distortion, model)
    assert camera.unproject(np.empty((0, 2))).shape == (0, 3)


def test_a_fisheye_ends_at_a_right_angle() -> None:
    """A ray of 90 degrees has no point at z = 1; its pixel and those beyond have no ray."""
    camera = Camera(640, 480, 200, 200, 320, 240, (0.0,) * 4, "fisheye")
    edge = 320 + 200 * np.pi / 2
    x = camera.unproject(np.array([[edge - 0.01, 240], [edge + 0.01, 240]]))[:, 0]
    assert x[0] == pytest.approx(1 / np.tan(0.01 / 200), rel=1e-6)
    assert np.isnan(x[1])
    assert np.isnan(camera.project(np.array([1.0, 0, -0.1]))).all()


def test_without_coefficients_a_fisheye_is_no_pinhole() -> None:
    camera = Camera(640, 480, 300, 300, 320, 240, (0.0,) * 4, "fisheye")
    assert camera.is_distorted
    assert camera.project(np.array([1.0, 0, 1]))[0] == pytest.approx(320 + 300 * np.pi / 4)
    assert camera.without_distortion() == Camera(640, 480, 300, 300, 320, 240)
    assert camera.resized(320, 240).model == camera.cropped(8, 8, 64, 64).model == "fisheye"


def test_a_fisheye_is_never_read_as_radial_tangential() -> None:
    camera = Camera(640, 480, 300, 300, 320, 240, (0.1, 0.0, 0.0, 0.0), "fisheye")
    with pytest.raises(ToolkitError, match="model: needs a pinhole"):
        _ = camera.opencv_distortion
    assert camera != Camera(640, 480, 300, 300, 320, 240, (0.1, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("model", "distortion", "problem"),
    [
        ("fisheye", (0.1, 0.2), r"has 4 coefficients \(k1 k2 k3 k4\)"),
        ("fisheye", (), "has 4 coefficients"),
        ("fisheye", (0.1, np.inf, 0, 0), "not finite"),
        ("opencv", (0.1,) * 6, "0, 4, 5 or 8"),
        ("omni", (0.1,) * 4, "no such lens model"),
    ],
)
def test_wrong_lenses_are_refused(model: str, distortion: tuple, problem: str) -> None:
    with pytest.raises(ToolkitError, match=problem):
        Camera(640, 480, 300, 300, 320, 240, distortion, model)


def test_names_of_other_programs_are_unique() -> None:
    names = [name for kind in MODELS.values() for name in kind.named]
    colmap = [name for kind in MODELS.values() for name in kind.colmap]
    assert len(set(names)) == len(names)
    assert len(set(colmap)) == len(colmap)
    assert lens_of("opencv", ()) == lens_of("opencv", (0.0,) * 5)  # the pinhole


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("fisheye", (0.0, 0.0867528842289631, 0.0867528842289631, -0.0625)),
        ("opencv", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.125)),
    ],
    ids=["Newton's steps cycle", "a pole at the fold"],
)
def test_lenses_on_which_iterations_fail(model: str, distortion: tuple) -> None:
    camera = Camera(*SIZE, 260.0, 260.0, 651.3, 352.8, distortion, model)
    rays = rays_before_the_fold(camera, 0.98)
    pixels = camera.project(np.column_stack([rays, np.ones(len(rays))]))
    np.testing.assert_allclose(camera.unproject(pixels)[:, :2], rays, atol=1e-6)
