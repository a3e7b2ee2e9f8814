"""Contours and edge measures against balls whose image is a formula."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_balls import CAMERA, CENTRES, DISTANCE_M, RADIUS_M, arc_pose, ball_mesh, draw_balls

from std_toolkit.checks.measure.contours import NOTHING, Contour, LabelCaster, trace_contour
from std_toolkit.checks.measure.edge_sums import strength_at_shifts
from std_toolkit.checks.measure.edges import (
    best_shift,
    edge_distance,
    noise_level,
    read_profiles,
    smooth_image,
)
from std_toolkit.checks.page.overlay import svg_path
from std_toolkit.geometry.se3 import SE3

VIEW = arc_pose(0.0)
IMAGE = draw_balls(CAMERA, VIEW)[0]
REACH_PX = 16.0


def contour_of(object_id: int, balls: dict[int, tuple[NDArray[np.float64], float]]) -> Contour:
    """Contour of one of some balls, given as centre in the world and factor on the radius."""
    mesh = ball_mesh()
    caster = LabelCaster(
        {i: (c + k * np.asarray(mesh.vertices), mesh.faces) for i, (c, k) in balls.items()}
    )
    hits = caster.cast(CAMERA, VIEW, CAMERA.pixel_grid())
    contour = trace_contour(caster, CAMERA, VIEW, object_id, hits.object_id == object_id)
    assert contour is not None
    return contour


def measure(contour: Contour, image: NDArray[np.uint8]):
    profiles = read_profiles(
        smooth_image(image), contour, reach_px=REACH_PX, noise=noise_level(image)
    )
    assert profiles is not None
    return edge_distance(profiles), best_shift(profiles, largest_px=12)


def ray_misses(points: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of the rays through pixels from a point in the camera frame, metres."""
    d = CAMERA.unproject(points)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.linalg.norm(np.cross(d, centre), axis=1)


def test_contour_of_a_ball_lies_on_its_outline_to_a_twentieth_of_a_pixel() -> None:
    contour = contour_of(1, {1: (CENTRES[1], 1.0)})
    centre = VIEW.inverse() @ CENTRES[1]
    error_px = (ray_misses(contour.points, centre) - RADIUS_M) * CAMERA.fx / DISTANCE_M
    assert np.abs(error_px).max() < 0.1
    assert abs(np.median(error_px)) < 0.03
    assert contour.own.all()


def test_normals_point_out_of_the_object() -> None:
    contour = contour_of(1, {1: (CENTRES[1], 1.0)})
    middle = CAMERA.project(VIEW.inverse() @ CENTRES[1])
    outward = contour.points - middle
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert (contour.normals * outward).sum(axis=1).min() > 0.95


def test_outline_of_what_is_in_front_is_not_the_objects_own() -> None:
    front = CENTRES[1] + [0, 0.05, 0.1]
    contour = contour_of(1, {1: (CENTRES[1], 1.0), 2: (front, 1.0)})
    camera_front = VIEW.inverse() @ front
    on_front = ray_misses(contour.points, camera_front) < 1.02 * RADIUS_M
    assert on_front.sum() > 10
    assert not contour.own[on_front].any()
    assert contour.own[~on_front].mean() > 0.9
    # The front ball's outline is its own all around.
    assert contour_of(2, {1: (CENTRES[1], 1.0), 2: (front, 1.0)}).own.all()


def test_image_border_is_not_an_outline() -> None:
    aside = np.array([0.0, 0.22, 0.0])
    contour = contour_of(1, {1: (aside, 1.0)})
    at_border = contour.points[:, 1] < 1.5
    assert at_border.any()
    assert not contour.own[at_border].any()


def test_true_label_lies_on_the_image_edge() -> None:
    # The image comes from a formula, so this also proves the half-pixel convention.
    edges, shift = measure(contour_of(1, {1: (CENTRES[1], 1.0)}), IMAGE)
    assert edges.median_px is not None and edges.median_px < 0.12
    assert edges.support == 1.0
    assert shift is not None
    assert np.hypot(shift.x_px, shift.y_px) < 0.1


@pytest.mark.parametrize("grow_px", [-4.0, -1.5, 2.0, 5.0])
def test_label_grown_by_known_pixels_gives_that_edge_distance(grow_px: float) -> None:
    radius_px = CAMERA.fx * RADIUS_M / DISTANCE_M
    factor = 1 + grow_px / radius_px
    edges, _ = measure(contour_of(1, {1: (CENTRES[1], factor)}), IMAGE)
    assert edges.median_px == pytest.approx(abs(grow_px), abs=0.2)


@pytest.mark.parametrize("shift_px", [(3.0, 0.0), (-2.5, 4.0), (0.7, -0.4)])
def test_label_shifted_by_known_pixels_is_told_to_shift_back(
    shift_px: tuple[float, float],
) -> None:
    # World x is the camera's x, world y its -y; all at the same depth.
    moved = CENTRES[1] + [
        shift_px[0] * DISTANCE_M / CAMERA.fx,
        -shift_px[1] * DISTANCE_M / CAMERA.fy,
        0,
    ]
    edges, shift = measure(contour_of(1, {1: (moved, 1.0)}), IMAGE)
    assert shift is not None
    assert (shift.x_px, shift.y_px) == pytest.approx((-shift_px[0], -shift_px[1]), abs=0.2)
    # Along the normals of a circle a shift of s is |cos| s, whose median is 0.707 s.
    assert edges.median_px == pytest.approx(0.707 * np.hypot(*shift_px), abs=0.25)


def test_plain_image_tells_nothing() -> None:
    plain = np.full_like(IMAGE, 128)
    edges, shift = measure(contour_of(1, {1: (CENTRES[1], 1.0)}), plain)
    assert edges.support == 0 and edges.median_px is None and edges.chance_px is None
    assert shift is None


def test_in_pure_texture_a_label_does_no_better_than_chance() -> None:
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (60, 80, 3)).astype(np.uint8)
    texture = np.kron(coarse, np.ones((4, 4, 1), np.uint8))
    edges, _ = measure(contour_of(1, {1: (CENTRES[1], 1.0)}), texture)
    assert edges.median_px is not None and edges.chance_px is not None
    assert edges.median_px > 0.6 * edges.chance_px


def test_outline_is_found_under_noise() -> None:
    rng = np.random.default_rng(0)
    noisy = np.clip(IMAGE + rng.normal(0, 4, IMAGE.shape), 0, 255).astype(np.uint8)
    edges, shift = measure(contour_of(1, {1: (CENTRES[1], 1.0)}), noisy)
    assert edges.median_px is not None and edges.median_px < 0.3
    assert shift is not None and np.hypot(shift.x_px, shift.y_px) < 0.2


def test_svg_puts_pixel_centres_half_a_pixel_inside() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    assert svg_path([square], offset=(0, 0)) == "M0.5 0.5L10.5 0.5L10.5 10.5L0.5 10.5Z"
    # Twice as large, an image pixel is two: its centre lies at 1.
    assert svg_path([square], scale=2, offset=(4, 0)).startswith("M-7.0 1.0")


def test_no_contour_for_a_speck() -> None:
    caster = LabelCaster({1: (CENTRES[1] + np.asarray(ball_mesh().vertices), ball_mesh().faces)})
    speck = np.zeros((CAMERA.height, CAMERA.width), bool)
    speck[5:8, 5:8] = True
    assert trace_contour(caster, CAMERA, VIEW, 1, speck) is None


def test_object_behind_the_camera_has_no_window() -> None:
    mesh = ball_mesh()
    caster = LabelCaster({1: (VIEW.t * 2 + np.asarray(mesh.vertices), mesh.faces)})
    assert caster.window(1, CAMERA, VIEW) is None
    around = LabelCaster({1: (VIEW.t + np.asarray(mesh.vertices), mesh.faces)})
    assert around.window(1, CAMERA, VIEW) == (0, 0, CAMERA.width, CAMERA.height)
    assert isinstance(VIEW, SE3)


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.25, 0.1, 0.0), (0.0, 0.0, 0.9)])
def test_every_pixel_of_an_object_is_cast(shift: tuple[float, float, float]) -> None:
    """In view, across the border of the image, and around the camera."""
    mesh, centre = ball_mesh(), CENTRES[1] + VIEW.R @ np.array(shift) * [1, 1, -1]
    caster = LabelCaster(
        {
            1: (centre + np.asarray(mesh.vertices), mesh.faces),
            2: (CENTRES[2] + np.asarray(mesh.vertices), mesh.faces),
        }
    )
    whole = caster.cast(CAMERA, VIEW, CAMERA.pixel_grid())
    possible = caster.possible(CAMERA, VIEW)
    assert not (whole.object_id[~possible] != NOTHING).any()
    few = caster.cast_pixels(CAMERA, VIEW, possible)
    np.testing.assert_array_equal(few.object_id, whole.object_id[possible])
    np.testing.assert_array_equal(few.depth, whole.depth[possible])


def test_strength_at_shifts_interpolates_the_profiles() -> None:
    rng = np.random.default_rng(0)
    offsets = np.arange(-8, 8.5, 0.5)
    strength, turn = rng.random((50, len(offsets))), rng.uniform(0, 2 * np.pi, 50)
    normals = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    dx, dy = rng.uniform(-9, 9, (2, 40))
    along = normals @ np.stack([dx, dy])
    expected = np.mean(
        [np.interp(a, offsets, s, left=0, right=0) for a, s in zip(along, strength, strict=True)],
        axis=0,
    )
    found = strength_at_shifts(normals, offsets, strength, dx, dy)
    np.testing.assert_allclose(found, expected, atol=1e-12)
