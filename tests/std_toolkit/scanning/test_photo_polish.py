"""A mesh that is off by less than a millimetre moves to where photos agree."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.geometry import SE3, Camera
from std_toolkit.scanning.surface.photo_polish import fit_photos
from std_toolkit.scanning.surface.polish import averaging
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
    faces = np.asarray(ball.faces)
    average = averaging(faces, len(start))
    views = ball_views(camera=SHARP)
    found, share = fit_photos(start, faces, views, reach=0.0012, average=average)
    assert share > 0.3
    assert off_the_ball(found, seen) < 0.0001
    # What no photo sees from the front stays where it was.
    below = direction[:, 2] < -0.95
    assert np.abs(found - start)[below].max() < 1e-9


def test_no_vertex_is_moved_below_a_table() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    start = CENTRE + (RADIUS - 0.0007) / RADIUS * np.asarray(ball.vertices)
    faces = np.asarray(ball.faces)
    # A table whose upper side faces down, through the upper part of the ball.
    table = SE3(np.diag([1.0, -1.0, -1.0]), CENTRE + np.array([0, 0, 0.8 * RADIUS]))
    below = start[:, 2] < table.t[2]
    average = averaging(faces, len(start))
    views = ball_views(camera=SHARP)
    free, _ = fit_photos(start, faces, views, reach=0.0012, average=average)
    assert free[below, 2].max() > table.t[2] + 0.0001
    held, _ = fit_photos(start, faces, views, reach=0.0012, average=average, floors=[table])
    assert held[:, 2].max() <= table.t[2] + 1e-12


def test_a_plain_ball_stays_as_it_is() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    start = CENTRE + np.asarray(ball.vertices)
    views = ball_views(camera=SHARP)
    for view in views:
        assert view.mask is not None
        view.image[view.mask] = 150
    faces = np.asarray(ball.faces)
    average = averaging(faces, len(start))
    found, share = fit_photos(start, faces, views, reach=0.0012, average=average)
    assert share == 0
    assert np.array_equal(found, start)
