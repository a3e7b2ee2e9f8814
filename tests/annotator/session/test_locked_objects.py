"""A locked object keeps its pose: in the session, in scripts, and in what front ends show."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from desk_without_window import Desk

from annotator.app.action_table import BY_ID
from annotator.app.command_palette import commands, run
from annotator.app.object_summary import matching, next_hint, summarize
from annotator.cli import main
from annotator.session import (
    AddClick,
    ChangeObject,
    ClearPose,
    Click,
    CompoundEdit,
    EnterModel,
    Move,
    RemoveObject,
    Session,
    SetPoses,
)
from annotator.session.edits import AnyEdit
from annotator.session.requests import Refine, SnapToTable, SolvePnP
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.carry.matching import is_kept
from std_toolkit.labels.carry.options import CarryOptions
from std_toolkit.scene import Object, Scene

LOCK = ChangeObject(object="box_1", locked=True)
UNLOCK = ChangeObject(object="box_1", locked=False)
POSE = SE3.exp([0.01, 0.02, 0.6, 0.3, 0.2, 0.1])


@pytest.mark.parametrize(
    "edit",
    [
        Move(object="box_1", frame=0, shift_mm=[1.0, 0.0, 0.0]),
        SetPoses.one("box_1", 0, POSE, method="drag"),
        ClearPose(object="box_1", frame=0),
        RemoveObject(object="box_1"),
        CompoundEdit(edits=[ChangeObject(object="box_1", note="x"), RemoveObject(object="box_1")]),
    ],
)
def test_edits_of_a_locked_pose_are_refused_until_it_is_unlocked(root: Path, edit: AnyEdit) -> None:
    with Session.open(root) as session:
        session.apply(LOCK)
        before = session.state
        with pytest.raises(ToolkitError, match=r"box_1 is locked; press L to unlock it"):
            session.apply(edit)
        assert session.state is before
        session.apply(UNLOCK)
        session.apply(edit)
        assert session.state != before


def test_another_mesh_cannot_take_the_place_of_that_of_a_locked_object(root: Path) -> None:
    with Session.open(root) as session:
        model = session.state.model_of("box_1")
        session.apply(LOCK)
        session.apply(EnterModel(model=model))
        other = type(model)(**{f: getattr(model, f) for f in model.__struct_fields__} | {
            "mesh": "models/other/other.obj"
        })  # fmt: skip
        with pytest.raises(ToolkitError, match="box_1 is locked"):
            session.apply(EnterModel(model=other))


def test_notes_status_and_points_of_a_locked_object_stay_possible(root: Path) -> None:
    with Session.open(root) as session:
        session.apply(LOCK)
        session.apply(ChangeObject(object="box_1", status="done", note="look"))
        click = Click(u=1.0, v=2.0, point=[0.0, 0.0, 0.0])
        session.apply(AddClick(object="box_1", frame=0, click=click))
        thing = session.object("box_1")
        assert (thing.status, thing.note, thing.locked) == ("done", "look", True)


def test_a_lock_is_saved_undone_and_recovered(root: Path) -> None:
    with Session.open(root) as session:
        session.apply(LOCK)
        assert session.undoable is not None and session.undoable.title == "Lock box_1"
        session.undo()
        assert not session.object("box_1").locked
        session.redo()
    with Session.open(root, recover="yes") as session:
        assert session.object("box_1").locked
        session.save()
    scene = Scene.open(root)
    number = scene.objects.object_named("box_1").id
    assert scene.annotation.of(number).locked
    with Session.open(root) as session:
        assert session.object("box_1").locked
        session.apply(UNLOCK)
        session.save()
    assert not Scene.open(root).annotation.of(number).locked


def test_a_file_without_the_field_is_not_locked(root: Path) -> None:
    row = {"object": Scene.open(root).objects.object_named("box_1").id, "note": "old"}
    (root / "annotation.json").write_text(json.dumps({"objects": [row]}))
    with Session.open(root) as session:
        assert (session.object("box_1").note, session.object("box_1").locked) == ("old", False)


@pytest.mark.parametrize(
    "request_",
    [
        Refine(objects=["box_1"]),
        SnapToTable(object="box_1", table=[0.0, 0.0, 1.0, 0.0]),
        SolvePnP(object="box_1", frame=0),
    ],
)
def test_nothing_is_computed_for_a_locked_object(
    root: Path, request_: Refine | SnapToTable | SolvePnP
) -> None:
    with Session.open(root) as session:
        session.apply(LOCK)
        with pytest.raises(ToolkitError, match="box_1 is locked"):
            session.perform(request_)


def test_refining_several_leaves_a_locked_one_out_and_says_so(
    several: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from std_toolkit.labels import auto_refine

    asked: list[list[int]] = []

    def refine_objects(scene: object, poses: object, ids: list[int], **_: object) -> object:
        asked.append(ids)
        raise ToolkitError("far enough")

    monkeypatch.setattr(auto_refine, "refine_objects", refine_objects)
    with Session.open(several) as session:
        placed = [o for o in session.state.objects if o.placements]
        assert len(placed) > 1
        session.apply(ChangeObject(object=placed[0].name, locked=True))
        with pytest.raises(ToolkitError, match="far enough"):
            session.perform(Refine(objects=[o.name for o in placed]))
    assert asked == [[o.id for o in placed[1:]]]


def test_carrying_over_leaves_a_locked_object_out_even_where_it_overwrites() -> None:
    thing = Object(id=1, name="box_1", model="box", material="diffuse")
    left_out: list[tuple[str, str]] = []
    options = CarryOptions(overwrite=True)
    assert not is_kept(thing, {"box_1"}, options, left_out)
    assert is_kept(thing, {"box_1"}, options, left_out, locked={"box_1"})
    assert left_out == [("box_1", "it is locked")]


def test_a_script_locks_and_is_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "edits.json"
    lock = {"edit": "change_object", "object": "box_1", "locked": True}
    path.write_text(json.dumps([lock, {"edit": "save"}]))
    assert main([str(root), "--script", str(path)]) == 0
    assert "[0] Lock box_1" in capsys.readouterr().out
    move = {"edit": "move", "object": "box_1", "frame": 0, "shift_mm": [1, 0, 0]}
    path.write_text(json.dumps([move, {"edit": "save"}]))
    assert main([str(root), "--script", str(path)]) != 0
    error = capsys.readouterr().err
    assert "box_1 is locked" in error and '"locked" to false' in error
    path.write_text(json.dumps([{**lock, "locked": False}, move, {"edit": "save"}]))
    assert main([str(root), "--script", str(path)]) == 0


def test_front_ends_show_the_lock_and_refuse_keys_and_drags(root: Path) -> None:
    desk = Desk(root)
    c = desk.controller
    c.select("box_1")
    (action,) = [a for a in commands(c, "lock") if a.title == "Lock"]
    assert action.keys == "L"
    run(c, "action", "lock")
    before = c.session.pose("box_1", 0)
    assert before is not None
    assert BY_ID["lock"].checked is not None and BY_ID["lock"].checked(c)
    (row,) = matching(summarize(c), "locked")
    assert row.locked and "L allows" in row.explanation
    assert "L unlocks it" in next_hint(c)
    c.nudge(shift=(1, 0, 0))
    assert "box_1 is locked" in desk.messages[-1]
    c.drag_to("box_1", 0, POSE)
    assert c.dragging is None
    BY_ID["refine"].run(c)
    assert "box_1 is locked" in desk.messages[-1] and c.task is None
    now = c.session.pose("box_1", 0)
    assert now is not None and np.array_equal(now.matrix(), before.matrix())
    run(c, "action", "lock")
    c.nudge(shift=(1, 0, 0))
    moved = c.session.pose("box_1", 0)
    assert moved is not None and moved.t[0] != before.t[0]
    desk.close()
