"""A finding against a pose lasts while the object stays near it, and comes again by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene
from textured_scene import HALF_TURN, T_WORLD_BOX, TURN, write_textured_scene

from annotator.app.action_table import BY_ID
from annotator.app.background_updates import BackgroundUpdates
from annotator.app.dialogs import Dialogs
from annotator.app.questions import Question
from annotator.app.verdicts import object_verdict
from annotator.session import AddObject, ChangeObject, Move, SetSymmetry
from annotator.session.residuals import FrameResidual
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.labels.texture.comparison import TextureComparison

TURNED = TextureComparison("turned", HALF_TURN, TURN, 0.1, 0.5, 8)
FITS = TextureComparison("fits", HALF_TURN, TURN, 0.6, 0.1, 8)
LEADS = TextureComparison("undecided", HALF_TURN, TURN, 0.15, 0.27, 8)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


def nudge(mm: float = 0.0, deg: float = 0.0) -> Move:
    return Move(object="box_1", frame=0, axes="object", shift_mm=[mm, 0, 0], turn_deg=[0, 0, deg])


@pytest.mark.parametrize(
    "edit",
    [
        ChangeObject(object="box_1", note="look again"),
        ChangeObject(object="box_1", status="done"),
        nudge(0.01),
        nudge(4.5),
        nudge(deg=4.5),
    ],
    ids=["note", "status", "nudge", "4.5 mm", "4.5 deg"],
)
def test_a_wrong_turn_outlives_what_hardly_moves_the_object(desk: Desk, edit: Move) -> None:
    c = desk.controller
    c.textures["box_1"] = TURNED
    c.apply(edit)
    assert object_verdict(c, "box_1").turned
    assert BY_ID["take_turn"].enabled(c)


@pytest.mark.parametrize("edit", [nudge(6.0), nudge(deg=6.0)], ids=["6 mm", "6 deg"])
def test_it_goes_where_the_object_moves_away(desk: Desk, edit: Move) -> None:
    c = desk.controller
    c.textures["box_1"] = TURNED
    c.apply(edit)
    assert not object_verdict(c, "box_1").turned
    assert "box_1" not in c.textures


def test_nudges_add_up(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = TURNED
    kept = []
    for _ in range(4):
        c.apply(nudge(2.0))
        kept.append("box_1" in c.textures)
    assert kept == [True, True, False, False]


def test_a_turn_that_only_leads_is_kept_as_well(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = LEADS
    c.apply(nudge(0.01))
    assert c.textures["box_1"] is LEADS


def test_what_speaks_for_a_pose_is_gone_with_it(desk: Desk) -> None:
    """A stale verdict is none."""
    c = desk.controller
    c.textures["box_1"] = FITS
    c.residuals["box_1"] = [FrameResidual(0, edge_px=0.6, edge_chance_px=9.0)]
    c.ranks["box_1"] = PoseRank(200, 200, (0,), (0,), -0.1, 0.6)
    c.apply(nudge(0.01))
    assert "box_1" not in {**c.textures, **c.residuals, **c.ranks}
    assert object_verdict(c, "box_1").grade == "unknown"
    assert c.findings.uncompared() == ["box_1"]


def test_a_note_and_another_name_take_nothing_away(desk: Desk) -> None:
    c = desk.controller
    rows = [FrameResidual(0, edge_px=0.6, edge_chance_px=9.0)]
    c.textures["box_1"], c.residuals["box_1"] = FITS, rows
    c.apply(ChangeObject(object="box_1", note="look again"))
    c.apply(ChangeObject(object="box_1", name="carton"))
    assert c.textures == {"carton": FITS}
    assert c.residuals == {"carton": rows}
    c.undo()
    assert c.textures == {"box_1": FITS}


def test_another_object_takes_nothing_away(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = FITS
    c.apply(AddObject(object="box_2", model="box"))
    assert c.textures == {"box_1": FITS}


def test_another_symmetry_takes_the_comparison_away(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = TURNED
    symmetry = parse_symmetry(["fold:z:2"], centre=[0.0, 0.0, 0.0])
    c.apply(SetSymmetry(model="box", symmetry=symmetry))
    assert c.textures == {}


def test_the_turn_that_was_taken_is_offered_no_more(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = TURNED
    BY_ID["take_turn"].run(c)
    assert c.textures == {}


@pytest.fixture
def turned(tmp_path: Path) -> Iterator[Desk]:
    """A textured box whose label is half a turn wrong."""
    root = write_textured_scene(tmp_path / "scene", T_world_obj=T_WORLD_BOX @ HALF_TURN)
    made = Desk(root)
    made.controller.select("box_1")
    yield made
    made.close()


@pytest.mark.slow
def test_it_is_made_again_when_a_scene_is_opened_so_that_done_asks(turned: Desk) -> None:
    c = turned.controller
    asked: list[Question | None] = []
    dialogs = Dialogs(c, asked.append)
    c.subscribe(lambda e: dialogs.ask(e.text) if e.kind == "ask" else None)
    updates = BackgroundUpdates(c)
    turned.wait(lambda: "box_1" in c.textures, at_most_s=240)
    assert object_verdict(c, "box_1").turned
    BY_ID["done"].run(c)
    question = asked[-1]
    assert question is not None and TURN in question.text
    assert c.session.object("box_1").status == "open"
    # The turn is taken, and then the texture fits.
    dialogs.answer(question.number, "", {})
    BY_ID["take_turn"].run(c)
    pose = c.session.T_world_obj("box_1")
    assert pose is not None
    np.testing.assert_allclose(pose.matrix(), T_WORLD_BOX.matrix(), atol=1e-3)
    turned.wait(lambda: "box_1" in c.textures, at_most_s=240)
    assert c.textures["box_1"].verdict == "fits"
    assert c.findings.uncompared() == []
    updates.close()


@pytest.mark.slow
def test_done_compares_what_was_never_compared(turned: Desk) -> None:
    """Also without the updates in the background."""
    c = turned.controller
    asked: list[Question | None] = []
    dialogs = Dialogs(c, asked.append)
    c.subscribe(lambda e: dialogs.ask(e.text) if e.kind == "ask" else None)
    BY_ID["done"].run(c)
    turned.wait(lambda: bool(asked), at_most_s=240)
    assert asked[-1] is not None and TURN in asked[-1].text
    assert c.session.object("box_1").status == "open"
