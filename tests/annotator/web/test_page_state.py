"""The page's state as plain values, without a browser."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

pytest.importorskip("trame")

from annotator.app.pose_text import PoseFields, RotationForm
from annotator.web.page import page_state


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    write_scene(tmp_path / "scene")
    desk = Desk(tmp_path / "scene")
    desk.controller.select("box_1")
    yield desk
    desk.close()


def test_a_weak_direction_of_the_last_refinement_is_told(desk: Desk) -> None:
    c = desk.controller
    fields = PoseFields(c)
    assert page_state(c, fields)["weak"] == ""
    c.weak_directions["box_1"] = "sliding along z is told least"
    assert page_state(c, fields)["weak"] == "Sliding along z is told least."
    c.nudge(shift=(1, 0, 0))
    assert page_state(c, fields)["weak"] == ""


@pytest.mark.parametrize("form", RotationForm)
def test_the_state_is_plain_json_in_every_form(desk: Desk, form: RotationForm) -> None:
    fields = PoseFields(desk.controller)
    fields.form = form
    for selected in ("box_1", None):
        desk.controller.select(selected)
        state = json.loads(json.dumps(page_state(desk.controller, fields)))
        assert (state["pose"] is None) == (selected is None)
