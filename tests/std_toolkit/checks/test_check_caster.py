"""Where in the image a label may show."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.checks.measure.contours import LabelCaster, trace_contour
from std_toolkit.geometry import SE3, Camera


@pytest.mark.parametrize("k1", [-0.15, 0.0, 0.15])
@pytest.mark.parametrize("pixel", [(12, 10), (300, 14), (305, 225), (160, 120)])
def test_the_window_holds_the_object_whatever_the_lens(k1, pixel):
    camera = Camera(320, 240, 190.0, 190.0, 160.0, 119.0, (k1, 0.0, 0.0, 0.0))
    centre = camera.unproject(np.array(pixel, dtype=np.float64), 0.8)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    caster = LabelCaster({1: (ball.vertices + centre, ball.faces)})
    seen = caster.cast(camera, SE3.identity(), camera.pixel_grid()).object_id == 1
    v, u = np.nonzero(seen)
    window = caster.window(1, camera, SE3.identity())
    assert window is not None and len(u) > 100
    x0, y0, x1, y1 = window
    assert x0 <= u.min() and u.max() < x1 and y0 <= v.min() and v.max() < y1


def test_the_depth_of_a_round_outline_is_that_of_its_rim() -> None:
    """Half a pixel inside, a round wall is nearer, and its outline would tell a turn about its axis
    that nothing shows."""
    camera = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)
    radius, centre = 0.037, np.array([0.01, 0.005, 0.5])
    can = trimesh.creation.cylinder(radius, 0.2, sections=720)
    upright = np.asarray(can.vertices) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) + centre
    caster = LabelCaster({1: (upright, can.faces)})
    whole = np.ones((camera.height, camera.width), bool)
    ids = caster.cast_pixels(camera, SE3.identity(), whole).object_id.reshape(whole.shape)
    contour = trace_contour(caster, camera, SE3.identity(), 1, ids == 1)
    assert contour is not None
    sides = contour.own & (np.abs(contour.normals[:, 0]) > 0.99)
    assert sides.sum() > 100
    rays = camera.unproject(contour.points[sides])
    radial = (rays * contour.depth[sides][:, None] - centre)[:, [0, 2]]
    length = np.linalg.norm(radial, axis=1)
    np.testing.assert_allclose(length, radius, atol=2e-4)
    # A ray at the rim meets the wall at a tangent.
    cosine = (
        (radial * rays[:, [0, 2]]).sum(axis=1) / length / np.linalg.norm(rays[:, [0, 2]], axis=1)
    )
    assert np.median(np.abs(cosine)) < 0.06
