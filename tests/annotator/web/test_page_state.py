"""The page's state as plain values, without a browser."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

pytest.importorskip("trame")

from annotator.app.action_table import BY_ID
from annotator.app.dialogs import Dialogs
from annotator.app.pose_text import PoseFields, RotationForm
from annotator.app.questions import Question
from annotator.session.residuals import FrameResidual
from annotator.session.state import Judged
from annotator.web.page import page_state
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.scene.judgement import Judgement


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


def test_the_page_names_a_rival_and_asks_before_done(desk: Desk) -> None:
    """As the window does: both have the same dialogs and actions."""
    c = desk.controller
    asked: list[Question | None] = []
    dialogs = Dialogs(c, asked.append)
    c.subscribe(lambda e: dialogs.ask(e.text) if e.kind == "ask" else None)
    c.residuals["box_1"] = [FrameResidual(0, 900, edge_px=0.6, edge_chance_px=9.0)]
    c.ranks["box_1"] = PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6)
    c.textures["box_1"] = TextureComparison(
        "undecided", SE3.identity(), "turned by 180 deg about z", 0.15, 0.27, 8
    )
    unknown = Judgement(
        grade="unknown", reason="measured", T_obj=SE3.identity().flat(), inputs="", time=""
    )
    c.findings.keep_judgements({"box_1": Judged(unknown)})
    told = "urned by 180 deg about z scores 0.27 against 0.15"
    card = page_state(c, PoseFields(c))["card"]
    assert (card["word"], card["reason"]) == ("unknown", "Measured.")
    (row,) = [r for r in card["rows"] if r["source"] == "texture"]
    assert told in row["tip"]
    assert (row["text"], row["action"]) == ("0.15, other turns 0.27", "take_turn")
    BY_ID["done"].run(c)
    assert asked[-1] is not None and told in asked[-1].text
    assert c.session.object("box_1").status == "open"
