"""No evidence is never good: what a texture comparison allows a verdict to say."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app import pose_checks
from annotator.app.action_table import BY_ID
from annotator.app.verdicts import Verdict, measured_verdict
from annotator.session.residuals import FrameResidual
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.comparison import TextureComparison, TextureVerdict

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


def judged(texture: TextureComparison | None, *, edge_px: float = 0.6) -> Verdict:
    row = FrameResidual(0, visible_px=5000, edge_px=edge_px, edge_chance_px=9.0)
    return measured_verdict([row, ROW], RANK, texture)


def test_an_undecided_texture_is_unknown_and_the_rival_that_leads_is_named() -> None:
    """The numbers are those of starts at a half-turned bottle."""
    found = judged(compared("undecided", 0.15, 0.27, telling=(30, 34, 38)))
    assert found.grade == "unknown"
    assert found.text.startswith(
        "Turned by 180 deg about z scores 0.27 against 0.15: look at the label in frames 30 to 38."
        " Press Y"
    )


def test_where_no_frame_tells_another_photo_is_asked_for() -> None:
    assert "photograph the other side" in judged(compared("undecided", 0.15, 0.27)).text


def test_a_rival_that_does_not_lead_is_not_offered() -> None:
    found = judged(compared("undecided", 0.27, 0.25))
    assert found.grade == "unknown"
    assert "0.25 turned by 180 deg about z" in found.text
    assert "Press Y" not in found.text


def test_a_texture_that_was_never_compared_is_unknown() -> None:
    assert judged(None).grade == "unknown"


def test_a_texture_that_is_not_there_is_wrong() -> None:
    found = judged(compared("other", 0.05, 0.1))
    assert found.grade == "wrong"
    assert "another product, or the label is elsewhere" in found.text


def test_a_wrong_turn_is_wrong_whatever_else_is_known() -> None:
    found = measured_verdict([], None, compared("turned", 0.1, 0.5))
    assert (found.grade, found.turned) == ("wrong", True)


def test_a_texture_that_agrees_fits() -> None:
    found = judged(compared("fits", 0.6, 0.1))
    assert found.grade == "fits"
    assert found.text.endswith("The texture fits.")


def test_a_turn_that_geometry_cannot_tell_is_said() -> None:
    found = judged(compared("ambiguous", textured=False))
    assert found.grade == "fits"
    assert "The turn about z is not determined" in found.text
    twice = compared("ambiguous", textured=False, text=f"{TURN}, then 90 deg about x")
    assert "The turn is not determined" in judged(twice).text


def test_a_shape_that_tells_its_turn_needs_no_texture() -> None:
    found = judged(compared("undecided", textured=False, text=""))
    assert found.grade == "fits"
    assert "turn" not in found.text


def test_what_is_doubtful_stays_so_and_names_the_rival() -> None:
    found = judged(compared("undecided", 0.15, 0.27), edge_px=2.0)
    assert found.grade == "doubtful"
    assert "scores 0.27 against 0.15" in found.text


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


WRONG_RANK = PoseRank(9, 200, (0, 1), (0, 1), 0.1, 0.6)


@pytest.mark.parametrize(
    ("rows", "rank", "texture", "grade"),
    [
        ([ROW], RANK, compared("undecided", 0.15, 0.27), "unknown"),
        ([ROW, FrameResidual(1, 5000, 2.0, 9.0)], RANK, compared("fits", 0.6, 0.1), "doubtful"),
        ([ROW], WRONG_RANK, None, "wrong"),
        ([], None, compared("turned", 0.1, 0.5), "wrong"),
        ([ROW], RANK, compared("other", 0.05, 0.1), "wrong"),
    ],
    ids=["unknown", "doubtful", "wrong", "turned", "other"],
)
def test_done_asks(
    desk: Desk,
    rows: list[FrameResidual],
    rank: PoseRank | None,
    texture: TextureComparison | None,
    grade: str,
) -> None:
    c = desk.controller
    c.dialogs = frozenset([pose_checks.DOUBT])
    c.residuals["box_1"] = rows
    if rank is not None:
        c.ranks["box_1"] = rank
    if texture is not None:
        c.textures["box_1"] = texture
    assert pose_checks.object_verdict(c, "box_1").grade == grade
    BY_ID["done"].run(c)
    assert [e.text for e in desk.told("ask")] == [pose_checks.DOUBT]
    assert c.session.object("box_1").status == "open"


@pytest.mark.parametrize("stale", [False, True], ids=["never measured", "stale"])
def test_done_measures_first(desk: Desk, stale: bool) -> None:
    """The images show no box, so that it is not confirmed."""
    c = desk.controller
    c.dialogs = frozenset([pose_checks.DOUBT])
    if stale:
        c.residuals["box_1"], c.ranks["box_1"] = [ROW], RANK
        c.textures["box_1"] = compared("fits", 0.6, 0.1)
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
