"""The verdict of the window is that of the judge; no evidence is never good."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app import pose_checks
from annotator.app.action_table import BY_ID
from annotator.app.object_summary import summarize
from annotator.app.verdicts import Verdict, measured_verdict, object_verdict
from annotator.session.residuals import FrameResidual
from annotator.session.state import Judged
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.comparison import TextureComparison, TextureVerdict
from std_toolkit.scene.judgement import GRADES, Grade, Judgement

NAN = float("nan")
TURN = "turned by 180 deg about z"
ROW = FrameResidual(frame=0, visible_px=5000, edge_px=0.6, edge_chance_px=2.5, edge_support=1.0)
RANK = PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6)


def compared(
    verdict: TextureVerdict,
    score: float = NAN,
    rival: float = NAN,
    *,
    telling: tuple[int, ...] = (),
    textured: bool = True,
    text: str = TURN,
) -> TextureComparison:
    turn = SE3.identity() if text else None
    return TextureComparison(verdict, turn, text, score, rival, 8, 0.2, telling, textured)


def judgement(grade: Grade = "fits", reason: str = "its contour confirms it") -> Judgement:
    return Judgement(
        grade=grade,
        probability=0.99 if grade == "fits" else 0.01,
        reason=reason,
        T_obj=SE3.identity().flat(),
        inputs="",
        time="2026-01-01T00:00:00Z",
    )


def judged(texture: TextureComparison | None, found: Judgement | None = None) -> Verdict:
    return measured_verdict([ROW], RANK, texture, found)


def test_residuals_and_rank_alone_are_no_verdict() -> None:
    """The best of 200 nearby poses may still be the wrong turn."""
    for texture in (None, compared("fits", 0.6, 0.1)):
        found = judged(texture)
        assert found.grade == "unknown"
        assert found.text.startswith("Not judged yet.")
        assert found.text.endswith("etter than 200 of 200 nearby poses.")


def test_the_verdict_is_that_of_the_judge() -> None:
    for grade in GRADES:
        found = judged(compared("fits", 0.6, 0.1), judgement(grade))
        assert found.grade == grade
        assert "its contour confirms it" in found.text
        # That a wrong pose beats its neighbours helps nobody.
        assert ("nearby poses" in found.text) == (grade in ("fits", "unknown"))


def test_the_list_shows_the_verdict_before_anything_else_is_measured(desk: Desk) -> None:
    c = desk.controller
    for grade in GRADES:
        c.findings.keep_judgements({"box_1": Judged(judgement(grade))})
        row = summarize(c)[0]
        assert (row.badge, row.grade) == (grade, grade)


def test_an_undecided_texture_names_the_rival_that_leads() -> None:
    """The numbers are those of starts at a half-turned bottle."""
    found = judged(compared("undecided", 0.15, 0.27, telling=(30, 34, 38)))
    assert found.grade == "unknown"
    assert (
        "Turned by 180 deg about z scores 0.27 against 0.15: look at the label in frames 30 to 38."
        " Press Y"
    ) in found.text


def test_what_the_judge_said_is_not_said_twice() -> None:
    texture = compared("undecided", 0.15, 0.27, telling=(30, 34, 38))
    found = judged(texture, judgement("unknown", texture.sentence()))
    assert found.text.count("scores 0.27 against 0.15") == 1
    assert "Press Y" in found.text


def test_where_no_frame_tells_another_photo_is_asked_for() -> None:
    assert "photograph the other side" in judged(compared("undecided", 0.15, 0.27)).text


def test_a_rival_that_does_not_lead_is_not_offered() -> None:
    found = judged(compared("undecided", 0.27, 0.25))
    assert found.grade == "unknown"
    assert "0.25 turned by 180 deg about z" in found.text
    assert "Press Y" not in found.text


def test_a_wrong_turn_is_wrong_whatever_else_is_known() -> None:
    found = measured_verdict([], None, compared("turned", 0.1, 0.5), judgement())
    assert (found.grade, found.turned) == ("wrong", True)


def test_a_turn_that_geometry_cannot_tell_is_said() -> None:
    found = judged(compared("ambiguous", textured=False), judgement())
    assert found.grade == "fits"
    assert "The turn about z is not determined" in found.text
    twice = compared("ambiguous", textured=False, text=f"{TURN}, then 90 deg about x")
    assert "The turn is not determined" in judged(twice, judgement()).text


def test_a_frame_with_a_contour_off_is_named_unless_the_label_fits() -> None:
    off = FrameResidual(7, visible_px=5000, edge_px=3.4, edge_chance_px=9.0)
    for grade in GRADES:
        found = measured_verdict([ROW, off], RANK, None, judgement(grade))
        assert ("off in frame 7" in found.text) == (grade != "fits")


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


@pytest.mark.parametrize("grade", ["unknown", "doubtful", "wrong", "turned"])
def test_done_asks(desk: Desk, grade: str) -> None:
    c = desk.controller
    c.dialogs = frozenset([pose_checks.DOUBT])
    c.residuals["box_1"], c.ranks["box_1"] = [ROW], RANK
    if grade == "turned":
        c.textures["box_1"] = compared("turned", 0.1, 0.5)
    else:
        c.findings.keep_judgements({"box_1": Judged(judgement(grade))})  # type: ignore[arg-type]
    assert object_verdict(c, "box_1").grade == ("wrong" if grade == "turned" else grade)
    BY_ID["done"].run(c)
    assert [e.text for e in desk.told("ask")] == [pose_checks.DOUBT]
    assert c.session.object("box_1").status == "open"


def test_done_does_not_ask_of_what_fits(desk: Desk) -> None:
    c = desk.controller
    c.dialogs = frozenset([pose_checks.DOUBT])
    c.findings.keep_judgements({"box_1": Judged(judgement())})
    BY_ID["done"].run(c)
    assert desk.told("ask") == []
    assert c.session.object("box_1").status == "done"


@pytest.mark.parametrize("stale", [False, True], ids=["never measured", "stale"])
def test_done_measures_first(desk: Desk, stale: bool) -> None:
    """The images show no box, so that it is not confirmed."""
    c = desk.controller
    c.dialogs = frozenset([pose_checks.DOUBT])
    if stale:
        c.residuals["box_1"], c.ranks["box_1"] = [ROW], RANK
        c.findings.keep_judgements({"box_1": Judged(judgement())})
        c.nudge(shift=(1, 0, 0))
    BY_ID["done"].run(c)
    assert c.task is not None
    desk.wait(lambda: c.task is None, at_most_s=240)
    assert [e.text for e in desk.told("ask")] == [pose_checks.DOUBT]
    assert c.session.object("box_1").status == "open"


def test_a_rival_that_leads_is_taken(desk: Desk) -> None:
    c = desk.controller
    c.textures["box_1"] = compared("undecided", 0.27, 0.25)
    assert not BY_ID["take_turn"].enabled(c)
    c.textures["box_1"] = compared("undecided", 0.15, 0.27)
    assert BY_ID["take_turn"].enabled(c)
