"""Lines on the screen: as wide as asked for, solid inside, fading out at their edges."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from annotator.views.projection import ImageWindow, ScreenCamera
from annotator.views.strokes import FADE_PX, Strokes, circle, rgba
from std_toolkit.geometry import Camera

RED = (1.0, 0.0, 0.0, 1.0)


def opacity(strokes: Strokes, at: NDArray[np.float64]) -> float:
    """Of the topmost triangle over a point."""
    points, colors, faces = strokes.arrays()
    for face in faces[::-1]:
        a, b, c = points[face]
        basis = np.stack([b - a, c - a], axis=1)
        if abs(np.linalg.det(basis)) < 1e-12:
            continue
        s, t = np.linalg.solve(basis, at - a)
        if s >= -1e-9 and t >= -1e-9 and s + t <= 1 + 1e-9:
            weights = np.array([1 - s - t, s, t])
            return float(weights @ colors[face, 3]) / 255
    return 0.0


@pytest.mark.parametrize("width", [2.0, 5.0])
def test_a_line_has_its_width(width: float) -> None:
    strokes = Strokes()
    strokes.segments(np.array([[[10.0, 20.0], [60.0, 20.0]]]), width, RED)
    profile = [opacity(strokes, np.array([30.0, 20.0 + d])) for d in np.arange(-6, 6, 0.1)]
    assert max(profile) == pytest.approx(1)
    # Half strength is reached half a fade beyond the core, so that the sum is the width.
    assert sum(profile) * 0.1 == pytest.approx(width, abs=0.15)


def test_a_hairline_is_paler_instead_of_thinner() -> None:
    strokes = Strokes()
    strokes.segments(np.array([[[10.0, 20.0], [60.0, 20.0]]]), 0.5, RED)
    assert opacity(strokes, np.array([30.0, 20.0])) == pytest.approx(0.5, abs=0.01)


def test_a_chain_has_no_gaps_at_its_joints() -> None:
    strokes = Strokes()
    chain = np.array([[10, 10], [40, 10], [40, 40], [10, 40]], float)
    strokes.line(chain, 4.0, RED, closed=True)
    for corner in chain:
        assert opacity(strokes, corner) == pytest.approx(1)


def test_a_polygon_is_filled_to_its_edge() -> None:
    strokes = Strokes()
    square = np.array([[10, 10], [30, 10], [30, 30], [10, 30]], float)
    strokes.polygon(square, RED)
    rng = np.random.default_rng(0)
    inside = rng.uniform(11, 29, (50, 2))
    assert Outline(square).contains_points(inside).all()
    assert all(opacity(strokes, p) == pytest.approx(1) for p in inside)
    assert opacity(strokes, np.array([10 - 2 * FADE_PX, 20.0])) == 0


def test_what_lies_behind_the_eye_is_left_out() -> None:
    strokes = Strokes()
    strokes.segments(np.array([[[np.nan, 0.0], [5.0, 5.0]], [[0.0, 0.0], [5.0, 5.0]]]), 2.0, RED)
    assert len(strokes.arrays()[2]) == 6  # of one line
    strokes.line([[np.nan, 1.0], [1.0, 1.0]], 2.0, RED)
    assert len(strokes.arrays()[2]) == 6


def test_nothing_is_nothing() -> None:
    points, colors, faces = Strokes().arrays()
    assert len(points) == len(colors) == len(faces) == 0


def test_a_circle_is_round() -> None:
    ring = circle((5.0, 6.0), 30.0)
    assert np.linalg.norm(ring - [5, 6], axis=1) == pytest.approx(30.0)
    assert len(ring) >= 48


def test_colours_are_read_from_the_palette() -> None:
    assert rgba("#0072B2", 0.5) == pytest.approx((0.0, 114 / 255, 178 / 255, 0.5))


class TestScreen:
    camera = Camera(640, 480, 500.0, 510.0, 322.0, 236.0)

    def test_the_corner_of_the_image_is_the_corner_of_its_first_pixel(self) -> None:
        window = ImageWindow.fit(self.camera.size, (1280, 960))
        assert window.to_screen((-0.5, -0.5)) == pytest.approx([0, 0])
        assert window.to_screen((639.5, 479.5)) == pytest.approx([1280, 960])
        assert window.to_screen((0, 0)) == pytest.approx([1, 1])  # a pixel's centre

    def test_both_cameras_agree(self) -> None:
        window = ImageWindow(2.7, -30.0, 12.0)
        screen = window.screen_camera(self.camera, (800, 600))
        points = np.random.default_rng(0).uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 2.0], (30, 3))
        expected = window.to_screen(self.camera.project(points))
        assert screen.project(points) == pytest.approx(expected)
        ray = screen.ray(expected)
        assert ray * points[:, 2:] == pytest.approx(points)

    def test_opengl_clips_where_the_screen_ends(self) -> None:
        screen = ScreenCamera(800, 600, 700.0, 710.0, 390.0, 310.0)
        P = screen.clip_matrix(0.01, 60.0)
        for xy, ndc in (((0, 0), (-1, 1)), ((800, 600), (1, -1)), ((400, 300), (0, 0))):
            x, y, z = screen.ray(xy) * 0.7
            clip = P @ [x, -y, -z, 1.0]
            assert clip[:2] / clip[3] == pytest.approx(ndc)
        near, far = (P @ [0, 0, -z, 1.0] for z in (0.01, 60.0))
        assert near[2] / near[3] == pytest.approx(-1) and far[2] / far[3] == pytest.approx(1)
