"""A mesh that is off by less than a millimetre moves to where photos agree."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

pytest.importorskip("numba")

from std_toolkit.geometry import Camera
from std_toolkit.scanning.photo_polish import fit_photos
from tests.std_toolkit.scanning.ball import CENTRE, RADIUS, ball_views

SHARP = Camera(640, 480, 1040, 1040, 319.5, 239.5)


def off_the_ball(vertices: np.ndarray, seen: np.ndarray) -> float:
    off = np.abs(np.linalg.norm(vertices - CENTRE, axis=1) - RADIUS)
    return float(np.median(off[seen]))


@pytest.mark.parametrize("error", [0.0007, -0.0007])
def test_vertices_move_to_the_painted_ball(error: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    direction = np.asarray(ball.vertices) / RADIUS
    start = CENTRE + (RADIUS + error) * direction
    seen = (direction[:, 2] > -0.2) & (direction[:, 2] < 0.9)
    found, share = fit_photos(start, np.asarray(ball.faces), ball_views(camera=SHARP), reach=0.0012)
    assert share > 0.3
    assert off_the_ball(found, seen) < 0.0001
    # What no photo sees from the front stays where it was.
    below = direction[:, 2] < -0.95
    assert np.abs(found - start)[below].max() < 1e-9


def test_a_plain_ball_stays_as_it_is() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    start = CENTRE + np.asarray(ball.vertices)
    views = ball_views(camera=SHARP)
    for view in views:
        assert view.mask is not None
        view.image[view.mask] = 150
    found, share = fit_photos(start, np.asarray(ball.faces), views, reach=0.0012)
    assert share == 0
    assert np.array_equal(found, start)
