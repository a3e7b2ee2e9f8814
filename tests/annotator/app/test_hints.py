"""The line that tells a newcomer what to do next, from an empty scene to the last label."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app import operations, pose_checks
from annotator.app.object_summary import next_hint
from annotator.session import AddClick, AddObject, Click, SetPoses
from annotator.session.edits import ChangeObject
from annotator.session.residuals import FrameResidual
from annotator.session.state import Judged
from std_toolkit.geometry import SE3
from std_toolkit.labels.texture.comparison import TextureComparison
from std_toolkit.scene.judgement import Judgement

POSE = SE3.exp([0.01, 0.02, 0.6, 0.3, 0.2, 0.1])


@pytest.fixture(params=[True, False], ids=["posed", "without camera poses"])
def desk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Desk]:
    made = Desk(write_scene(tmp_path / "scene", labelled=request.param).root)
    yield made
    made.close()


def test_from_a_box_to_its_label(desk: Desk) -> None:
    c = desk.controller

    def hint() -> str:
        return next_hint(c)

    assert "select it" in hint()
    c.apply(AddObject(object="mug", model="box"))
    c.select("mug")
    assert "Drag mug onto the image" in hint()
    c.set_tool(clicking=True)
    assert hint().startswith("Four points to go")
    c.pending_point = (0.0, 0.0, 0.0)
    assert "in the image" in hint()
    c.pending_point = None
    for i in range(4):
        click = Click(u=10.0 * i, v=5.0, point=[0.0, 0.0, 0.0])
        c.apply(AddClick(object="mug", frame=0, click=click))
    assert "press Return" in hint()
    c.set_tool(clicking=False)
    c.drag_to("mug", 0, POSE)
    assert hint().startswith("Moving mug")
    c.end_drag()
    assert "press R to refine" in hint()
    c.apply(SetPoses.one("mug", 0, POSE, method="refine", refinement="edges, 3 views"))
    assert "press D if it fits" in hint()
    c.apply(SetPoses.one("mug", 0, POSE, method="snap", refinement="put onto the table"))
    assert "press R to refine" in hint()
    c.apply(SetPoses.one("mug", 0, POSE, method="refine", refinement="edges, 3 views"))
    c.residuals["mug"] = [FrameResidual(0, 900, edge_px=6.4, edge_chance_px=12.0)]
    assert hint() == "mug is 6.4 px off: bring it closer, then press R again."
    c.residuals["mug"] = [FrameResidual(0, 900, edge_px=0.8, edge_chance_px=12.0)]
    assert "press D if it fits" in hint()
    pose_checks.toggle_done(c)
    assert "Next: box_1" in hint()
    c.apply(SetPoses.one("box_1", 0, POSE, method="typed"))
    c.apply(ChangeObject(object="box_1", status="done"))
    if desk.session.posed:
        assert "propagate with Ctrl+P" in hint()
    else:
        # Nothing can be propagated without camera poses.
        assert "save with Ctrl+S" in hint()
        assert operations.save(c)
        assert hint() == "All is done."


def test_a_turn_that_scores_higher_is_named_with_what_decides(desk: Desk) -> None:
    c = desk.controller
    c.select("box_1")
    c.apply(SetPoses.one("box_1", 0, POSE, method="refine", refinement="edges"))
    c.residuals["box_1"] = [FrameResidual(0, 900, edge_px=0.8, edge_chance_px=12.0)]
    c.textures["box_1"] = TextureComparison(
        "undecided", SE3.identity(), "turned by 180 deg about z", 0.15, 0.27, 8, 0.2, (3, 5)
    )
    assert next_hint(c) == (
        "Another turn of box_1 scores higher: look at the label in frames 3 to 5; Y turns it, "
        "D keeps it."
    )


def test_a_verdict_that_was_stored_comes_before_residuals(desk: Desk) -> None:
    c = desk.controller
    c.select("box_1")
    c.apply(SetPoses.one("box_1", 0, POSE, method="refine", refinement="edges"))
    judgement = Judgement(
        grade="wrong", probability=0.0, reason="off", T_obj=POSE.flat(), inputs="", time=""
    )
    c.findings.keep_judgements({"box_1": Judged(judgement)})
    assert next_hint(c) == "box_1 is not confirmed: check it in every view, or place it again."


def test_each_frame_is_on_its_own_without_camera_poses(tmp_path: Path) -> None:
    desk = Desk(write_scene(tmp_path / "loose", labelled=False).root)
    c = desk.controller
    c.select("box_1")
    c.apply(SetPoses.one("box_1", 0, POSE, method="typed"))
    c.apply(SetPoses.one("box_1", 1, POSE, method="refine", refinement="edges"))
    assert "press R" in next_hint(c)
    c.show_frame(1)
    assert "press D" in next_hint(c)
    c.show_frame(2)
    assert "Drag box_1" in next_hint(c)
    desk.close()


def test_while_something_is_computed_the_line_tells_that(desk: Desk) -> None:
    """And does not ask for what is under way already."""
    c, go_on = desk.controller, threading.Event()
    c.select("box_1")
    c.apply(SetPoses.one("box_1", 0, POSE, method="typed"))
    c.apply(ChangeObject(object="box_1", status="done"))
    before = next_hint(c)
    c.start("Propagate", lambda _: go_on.wait(30), lambda _: None, alone=True)
    assert next_hint(c).startswith("Propagate is running")
    assert "Ctrl+P" not in next_hint(c)
    go_on.set()
    desk.wait_until_idle()
    assert next_hint(c) == before
    c.start("Refine box_1", lambda _: None, lambda _: None)
    assert next_hint(c).startswith("Refine box_1 is running")
    assert "Esc" in next_hint(c)
    desk.wait_until_idle()
