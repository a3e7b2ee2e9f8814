"""What the panels show, without any front end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app.action_table import BY_ID
from annotator.app.dialogs import Dialogs
from annotator.app.panels import frame_marks, residual_rows, weak_direction
from annotator.app.pose_text import PoseFields, RotationForm
from annotator.app.questions import Question
from annotator.app.verdicts import object_verdict
from annotator.session.residuals import FrameResidual
from annotator.session.state import Judged
from std_toolkit.checks.measure.ranking import PoseRank
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.support.plane import Plane, TablePlane
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.scene.judgement import Grade, Judgement


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    write_scene(tmp_path / "scene")
    desk = Desk(tmp_path / "scene")
    desk.controller.select("box_1")
    yield desk
    desk.close()


def residual(frame: int, edge: float | None, depth: float | None) -> FrameResidual:
    chance = None if edge is None else 20.0
    return FrameResidual(frame, edge_px=edge, edge_chance_px=chance, depth_mm=depth)


@pytest.mark.parametrize(
    "rows, sentence",
    [
        ([], "Not judged yet."),
        ([residual(0, 0.8, None), residual(1, 1.0, 3.0)], "Not judged yet."),
        ([residual(0, 0.8, None), residual(1, 9.0, 3.0)], "off in frame 1: look there."),
    ],
)
def test_the_verdict_is_one_sentence(desk: Desk, rows: list[FrameResidual], sentence: str) -> None:
    desk.controller.residuals["box_1"] = rows
    assert sentence in object_verdict(desk.controller, "box_1").text
    assert len(residual_rows(desk.controller)) == len(rows)


GOOD = [residual(0, 0.8, None), residual(1, 1.0, 3.0)]
FITS = TextureComparison("fits", None, "", 0.6, float("nan"), 4, 0.2)


def judged(grade: Grade) -> Judged:
    identity = SE3.identity().flat()
    judgement = Judgement(
        grade=grade, probability=0.5, reason="measured", T_obj=identity, inputs="", time=""
    )
    return Judged(judgement)


@pytest.mark.parametrize(
    "rank, words",
    [
        (PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6), "200 of 200 nearby poses"),
        (PoseRank(150, 200, (0, 1), (0, 1), -0.1, 0.6), "150 of 200"),
        (PoseRank(200, 200, (0, 1), (0, 1), 0.1, 0.6), "another turn fits as well"),
        (PoseRank(200, 200, (0, 1), (0,), -0.1, 0.6), "1 of 2 frames is inconclusive"),
        (PoseRank(200, 200, (0,), (0,), -0.1, 0.6), "one frame alone"),
    ],
)
def test_a_rank_is_a_detail_and_no_verdict(desk: Desk, rank: PoseRank, words: str) -> None:
    c = desk.controller
    c.residuals["box_1"], c.ranks["box_1"], c.textures["box_1"] = GOOD, rank, FITS
    found = object_verdict(c, "box_1")
    assert found.grade == "unknown"
    assert words in found.text
    c.findings.keep_judgements({"box_1": judged("fits")})
    assert object_verdict(c, "box_1").grade == "fits"


def test_a_texture_that_fits_better_turned_is_offered_and_taken_as_one_edit(desk: Desk) -> None:
    c = desk.controller
    half = SE3(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    before = c.session.pose("box_1", 0)
    assert before is not None
    c.residuals["box_1"], c.ranks["box_1"] = GOOD, PoseRank(200, 200, (0, 1), (0, 1), -0.1, 0.6)
    assert not BY_ID["take_turn"].enabled(c)
    c.textures["box_1"] = TextureComparison(
        "turned", half, "turned by 180 deg about z", 0.1, 0.6, 4
    )
    assert object_verdict(c, "box_1").turned
    assert "turned by 180 deg about z fits the texture better" in object_verdict(c, "box_1").text
    assert BY_ID["take_turn"].enabled(c)
    BY_ID["take_turn"].run(c)
    after = c.session.pose("box_1", 0)
    assert after is not None
    np.testing.assert_allclose((before.inverse() @ after).R, half.R, atol=1e-9)
    assert "box_1" not in c.textures
    c.undo()
    np.testing.assert_allclose(c.session.pose("box_1", 0).flat(), before.flat(), atol=1e-9)  # type: ignore[union-attr]


def test_done_asks_unless_the_pose_fits(desk: Desk) -> None:
    c = desk.controller
    asked: list[Question | None] = []
    dialogs = Dialogs(c, asked.append)
    c.subscribe(lambda e: dialogs.ask(e.text) if e.kind == "ask" else None)
    c.residuals["box_1"], c.ranks["box_1"] = GOOD, PoseRank(9, 200, (0, 1), (0, 1), 0.1, 0.6)
    c.findings.keep_judgements({"box_1": judged("doubtful")})
    BY_ID["done"].run(c)
    question = asked[-1]
    assert question is not None
    assert "box_1" in question.text
    assert "9 of 200" in question.text
    assert c.session.object("box_1").status == "open"
    dialogs.answer(question.number, "", {})
    assert c.session.object("box_1").status == "open"
    BY_ID["done"].run(c)
    assert asked[-1] is not None
    dialogs.answer(asked[-1].number, "done", {})
    assert c.session.object("box_1").status == "done"
    BY_ID["done"].run(c)
    c.findings.keep_judgements({"box_1": judged("fits")})
    count = len(asked)
    BY_ID["done"].run(c)
    assert c.session.object("box_1").status == "done"
    assert len(asked) == count


def test_a_weak_direction_is_a_sentence(desk: Desk) -> None:
    assert weak_direction(desk.controller) == ""
    desk.controller.weak_directions["box_1"] = "turning about z is weak"
    assert weak_direction(desk.controller) == "Turning about z is weak."


def test_a_weak_direction_is_said_relative_to_the_table(desk: Desk) -> None:
    c = desk.controller
    pose = c.session.T_world_obj("box_1")
    assert pose is not None
    plane = Plane(pose.R[:, 2], 0.0, "world")
    c.table = TablePlane(plane, "depth", 0.001, 100, 1, pose.t, 0.2, 0.001)
    c.weak_directions["box_1"] = (
        "least determined: turn about object axis (0.00, 0.10, 0.99), standard deviation 0.80 deg"
    )
    assert weak_direction(c).startswith(
        "Least determined: turn about its upright axis, object axis"
    )


def test_numbers_of_a_residual_have_their_units_and_grades(desk: Desk) -> None:
    desk.controller.residuals["box_1"] = [residual(2, 2.0, -120.4)]
    (row,) = residual_rows(desk.controller)
    assert (row.frame, row.edges, row.chance, row.depth) == (2, "2.0 px", "20.0 px", "-120 mm")
    assert (row.edge_grade, row.depth_grade) == ("doubtful", "wrong")


def test_frames_are_marked_by_their_place(desk: Desk) -> None:
    marks = frame_marks(desk.controller)
    assert marks.runs == ((0, 2),)
    assert marks.sides == (1, 2)
    assert marks.placed == (0,)


def test_a_pose_in_the_world_is_copied_and_pasted(desk: Desk) -> None:
    fields = PoseFields(desk.controller)
    desk.controller.show_frame(1)
    fields.in_world = True
    text, before = fields.copied(), fields.pose
    assert before is not None
    fields.set_number("position", 1, 1000 * before.t[1] + 5)
    moved = fields.pose
    assert moved is not None
    np.testing.assert_allclose(moved.t - before.t, [0, 0.005, 0], atol=1e-9)
    assert fields.paste(text)
    assert fields.pose is not None
    np.testing.assert_allclose(fields.pose.matrix(), before.matrix(), atol=1e-12)


def test_a_quaternion_is_typed_as_a_whole(desk: Desk) -> None:
    fields = PoseFields(desk.controller)
    fields.form = RotationForm.QUATERNION
    assert fields.type_quaternion("[0.5, 0.5, 0.5, 0.5]")
    assert fields.pose is not None
    np.testing.assert_allclose(fields.pose.R, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(fields.numbers()[1], [0.5, 0.5, 0.5, 0.5], atol=1e-12)
    for text, problem in (("1 0 0", "4 numbers"), ("1 1 0 0", "length 1"), ("1 0 0 x", "number")):
        with pytest.raises(ToolkitError, match=problem):
            fields.type_quaternion(text)
