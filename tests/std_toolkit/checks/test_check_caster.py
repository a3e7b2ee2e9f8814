"""Where in the image a label may show."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.checks.measure.contours import LabelCaster
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
