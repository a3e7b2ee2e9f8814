"""The card of an object: each source says its own, and offers what resolves a doubt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app.evidence_card import EvidenceRow, evidence_card
from annotator.session.residuals import FrameResidual
from annotator.session.state import Judged
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.scene.judgement import Evidence, Grade, Judgement

NAN = float("nan")
COVARIANCE = [0.01 if i == j else 0.0 for i in range(6) for j in range(6)]
TURNED = TextureComparison("turned", SE3.identity(), "turned by 180 deg about z", 0.1, 0.5, 8)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    made.close()


def _row(desk: Desk, source: str) -> EvidenceRow:
    card = evidence_card(desk.controller)
    assert card is not None
    (row,) = [r for r in card.rows if r.source == source]
    return row


def _judge(desk: Desk, grade: Grade, *evidence: Evidence) -> None:
    found = Judgement(
        grade=grade,
        probability=0.5,
        reason="its contour puts it elsewhere",
        T_obj=SE3.identity().flat(),
        inputs="",
        time="2026-01-01T00:00:00Z",
        evidence=list(evidence),
    )
    desk.controller.findings.keep_judgements({"box_1": Judged(found)})


def _evidence(source: str, mm: float, deg: float = 0.0, text: str = "") -> Evidence:
    return Evidence(
        source=source,  # type: ignore[arg-type]
        motion_mm=[mm, 0.0, 0.0],
        turn_deg=[0.0, deg, 0.0],
        covariance=COVARIANCE,
        frames=9,
        text=text,
    )


def test_there_is_no_card_without_a_pose(desk: Desk) -> None:
    desk.controller.select(None)
    assert evidence_card(desk.controller) is None


def test_a_card_before_anything_is_measured(desk: Desk) -> None:
    card = evidence_card(desk.controller)
    assert card is not None
    assert (card.name, card.word, card.reason) == ("box_1", "unknown", "Not judged yet.")
    assert [(r.source, r.text, r.grade) for r in card.rows] == [
        ("contour", "not measured yet", "unknown")
    ]


@pytest.mark.parametrize(
    ("mm", "deg", "grade"),
    [(1.0, 0.5, "fits"), (4.1, 0.0, "doubtful"), (6.0, 0.0, "wrong"), (1.0, 6.0, "wrong")],
)
def test_a_source_is_graded_by_the_limits_of_the_judge(
    desk: Desk, mm: float, deg: float, grade: Grade
) -> None:
    _judge(desk, "doubtful", _evidence("contour", mm, deg), _evidence("depth", 0.2))
    card = evidence_card(desk.controller)
    assert card is not None
    assert (card.word, card.reason) == ("doubtful", "Its contour puts it elsewhere.")
    row = _row(desk, "contour")
    assert (row.text, row.grade) == (f"{mm:.1f} mm, {deg:.1f}°", grade)
    assert row.action == ("" if grade == "fits" else "refine")
    assert _row(desk, "depth").grade == "fits"
    assert _row(desk, "frames").text == "9 measured"


def test_a_label_that_does_not_stand_is_dropped(desk: Desk) -> None:
    _judge(desk, "doubtful", _evidence("support", 8.0, text="on the plane of 5 other objects"))
    row = _row(desk, "table")
    assert (row.grade, row.action, row.label) == ("wrong", "drop", "Drop it")
    assert row.tip == "It should stand on the plane of 5 other objects."


def test_a_better_turn_is_offered(desk: Desk) -> None:
    desk.controller.textures["box_1"] = TURNED
    row = _row(desk, "texture")
    assert (row.text, row.grade) == ("0.10, other turns 0.50", "wrong")
    assert (row.action, row.label) == ("take_turn", "Turn it")
    by_contour = replace(
        TURNED, score=NAN, rival_score=NAN, textured=False, contour_gain=9.0, telling=(3, 4)
    )
    desk.controller.textures["box_1"] = by_contour
    row = _row(desk, "turn")
    assert (row.text, row.action) == ("turned by 180 deg about z", "take_turn")
    assert row.tip == "Turned by 180 deg about z fits the contour better."


def test_an_undecided_texture_names_the_frame_to_look_at(desk: Desk) -> None:
    found = replace(TURNED, verdict="undecided", score=0.3, rival_score=0.25, telling=(2, 3))
    desk.controller.textures["box_1"] = found
    row = _row(desk, "texture")
    assert (row.grade, row.action, row.label, row.frame) == (
        "unknown",
        "show_frame",
        "Look at frame 2",
        2,
    )


def test_a_frame_that_is_off_can_be_shown(desk: Desk) -> None:
    desk.controller.residuals["box_1"] = [
        FrameResidual(0, 900, edge_px=0.6, edge_chance_px=4.0),
        FrameResidual(1, 900, edge_px=3.9, edge_chance_px=9.0),
    ]
    row = _row(desk, "frames")
    assert (row.text, row.action, row.frame) == ("2 shown, off in 1", "show_frame", 1)


def test_inconclusive_frames_of_the_rank_are_shown(desk: Desk) -> None:
    ranks = desk.controller.ranks
    ranks["box_1"] = PoseRank(200, 200, (0, 1, 2), (0,), -0.1, 0.6)
    row = _row(desk, "nearby poses")
    assert (row.text, row.grade, row.frame) == ("beats 200 of 200", "doubtful", 1)
    ranks["box_1"] = PoseRank(90, 200, (0, 1, 2), (0,), -0.1, 0.6)
    assert _row(desk, "nearby poses").action == "refine"
    ranks["box_1"] = PoseRank(0, 0, (), (), -1.0, 0.0)
    assert _row(desk, "nearby poses").text == "not ranked"
