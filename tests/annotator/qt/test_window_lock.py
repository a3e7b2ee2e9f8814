"""The lock of an object in the window: a key, a padlock in the list, refused hands."""

from __future__ import annotations

import numpy as np
from bench import Bench
from PySide6.QtCore import QPoint, Qt


def test_a_locked_object_shows_it_and_stays_where_it_is(bench: Bench) -> None:
    panel = bench.space.objects
    before, row = bench.pose().flat(), bench.picture(panel.list)
    assert bench.view().gizmo_frame() is not None
    bench.press("l")
    bench.settle()
    assert bench.session.object("box_1").locked
    assert not np.array_equal(bench.picture(panel.list), row)
    assert "L allows" in panel.model.rows[0].explanation
    assert bench.view().gizmo_frame() is None
    bench.drag(bench.on_object(), QPoint(30, 10))
    assert bench.message().startswith("box_1 is locked")
    bench.press(Qt.Key.Key_Right)
    assert bench.pose().flat() == before
    bench.press("l")
    bench.drag(bench.on_object(), QPoint(30, 10))
    assert bench.pose().flat() != before
