"""What a person starts and is computed aside: applied as one edit, or dropped and told."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import trimesh
from desk_without_window import Desk
from scene_on_disk import write_scene

from annotator.app import mesh_import, operations
from annotator.app.action_table import BY_ID
from annotator.app.placing import add_object
from annotator.session import AddObject, Move, RemoveObject, SetPoses, Snapshot
from annotator.session.requests import Outcome, Request
from annotator.session.requests.mesh_requests import Watch
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene

STANDING = SE3.exp([0.0, 0.05, 0.5, 0.0, 0.0, 0.0])
ELSEWHERE = SE3.exp([0.02, 0.01, 0.55, 0.2, 0.1, 0.3])


class Placed(Request, frozen=True, kw_only=True, tag="placed"):
    """Takes until it is let go on, and puts the box somewhere."""

    @property
    def title(self) -> str:
        return "Place"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del snapshot
        watch.progress(0.5)
        assert GO_ON.wait(timeout=30)
        edit = SetPoses.one("box_1", 0, ELSEWHERE, method="refine", label=self.title)
        return Outcome(edit, ["box_1: found"], ["box_1: look at it"], {"box_1": "along x"})


class Standing(Request, frozen=True, kw_only=True, tag="standing"):
    """Puts the second box somewhere at once."""

    @property
    def title(self) -> str:
        return "Stand"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del snapshot, watch
        return Outcome(SetPoses.one("box", 0, STANDING, method="drop", label=self.title), [], [])


GO_ON = threading.Event()


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    GO_ON.clear()
    made = Desk(write_scene(tmp_path / "scene").root)
    made.controller.select("box_1")
    yield made
    GO_ON.set()
    made.close()


def start(desk: Desk) -> None:
    operations.perform(desk.controller, "Place box_1", Placed(), ["box_1"])
    task = desk.controller.task
    assert task is not None
    desk.wait(lambda: task.fraction == 0.5)


def finish(desk: Desk) -> None:
    GO_ON.set()
    desk.wait_until_idle()


def test_a_result_is_one_edit_with_what_is_to_be_told_about_it(desk: Desk) -> None:
    before = desk.session.state
    start(desk)
    assert desk.session.state is before  # the session is touched by its own thread alone
    finish(desk)
    assert desk.session.pose("box_1", 0) is not None
    assert desk.session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()
    assert desk.messages == ["box_1: look at it", "box_1: found"]
    assert desk.controller.weak_directions == {"box_1": "along x"}
    desk.session.undo()
    assert desk.session.state is before


def test_what_was_edited_meanwhile_keeps_the_pose_of_the_hand(desk: Desk) -> None:
    start(desk)
    desk.controller.nudge(shift=(1, 0, 0))
    by_hand = desk.session.state
    finish(desk)
    assert desk.session.state is by_hand
    assert "box_1 was edited meanwhile, so the result was dropped" in desk.messages[-1]


def test_an_edit_that_was_undone_meanwhile_is_none(desk: Desk) -> None:
    start(desk)
    desk.controller.nudge(shift=(1, 0, 0))
    desk.controller.undo()
    finish(desk)
    assert desk.session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()


def test_an_object_that_was_removed_meanwhile_stays_removed(desk: Desk) -> None:
    start(desk)
    desk.controller.apply(RemoveObject(object="box_1"))
    finish(desk)
    assert desk.session.state.objects == []
    assert "dropped" in desk.messages[-1]


def test_what_is_cancelled_changes_nothing(desk: Desk) -> None:
    before = desk.session.state
    start(desk)
    desk.controller.cancel()
    finish(desk)
    assert desk.session.state is before
    assert desk.messages == ["Place box_1: cancelled, nothing was changed."]


def test_the_next_object_is_placed_moved_and_dropped_while_one_is_refined(desk: Desk) -> None:
    c, session = desk.controller, desk.session
    before = session.state
    start(desk)
    assert add_object(c, "box")
    assert c.selected == "box"
    c.nudge(shift=(5, 0, 0))
    assert not BY_ID["rest"].problem(c)
    operations.perform(c, "Put box onto the table", Standing(), ["box"], beside=True)
    desk.wait(lambda: session.object("box").placements[0].T_cam_obj == STANDING.flat())
    assert c.task is not None and c.task.title == "Place box_1"
    assert not any("still running" in text for text in desk.messages)
    # What is to be measured first waits for its turn.
    c.start_in_turn("Check box", lambda: c.tell("Now."))
    by_hand = session.state
    finish(desk)
    assert session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()
    assert session.object("box") == by_hand.objects[-1]
    assert desk.messages[-1] == "Now."
    # Each is an edit of its own, in the order in which they came.
    session.undo()
    assert session.state is by_hand
    session.undo()
    session.undo()
    session.undo()
    assert session.state is before


def test_an_object_is_deleted_while_another_is_refined(desk: Desk) -> None:
    c = desk.controller
    assert add_object(c, "box")
    start(desk)
    assert c.apply(RemoveObject(object="box"))
    finish(desk)
    assert [o.name for o in desk.session.state.objects] == ["box_1"]
    assert desk.session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()


def test_of_two_refinements_each_can_be_cancelled(desk: Desk) -> None:
    c = desk.controller
    assert add_object(c, "box")
    before = desk.session.state
    start(desk)
    c.start_in_turn("Next", lambda: operations.perform(c, "Next", Placed(), ["box_1"]))
    c.cancel()
    GO_ON.set()
    desk.wait(lambda: c.task is None or c.task.title == "Next")
    c.cancel()
    desk.wait_until_idle()
    assert desk.session.state is before
    told = [text for text in desk.messages if "cancelled" in text]
    assert [text.split(":")[0] for text in told] == ["Place box_1", "Next"]


def test_one_computation_at_a_time(desk: Desk) -> None:
    start(desk)
    operations.perform(desk.controller, "Once more", Placed(), ["box_1"])
    assert desk.messages == ["Place box_1 is still running."]
    finish(desk)


def test_a_defect_in_a_computation_is_told_and_the_next_one_runs(desk: Desk) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError("oops")

    desk.controller.start("Break", broken, lambda _: None)
    desk.wait_until_idle()
    assert desk.messages == ["Break failed: ZeroDivisionError: oops"]
    GO_ON.set()
    start(desk)
    finish(desk)
    assert desk.session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()


def test_two_mesh_files_of_one_name_become_two_models(desk: Desk, tmp_path: Path) -> None:
    files = []
    for size in (0.05, 0.07):
        path = tmp_path / str(size) / "mug.ply"
        path.parent.mkdir()
        trimesh.creation.box((size, size, size)).export(path)
        files.append(mesh_import.NewMesh(path))
    mesh_import.import_meshes(desk.controller, files)
    desk.wait_until_idle()
    sizes = {m.id: m.size_m[0] for m in desk.session.state.models}
    assert sizes == pytest.approx({"box": 0.06, "mug": 0.05, "mug_2": 0.07})
    assert desk.session.mesh("mug").extents == pytest.approx([0.05] * 3)
    desk.session.undo()
    assert [m.id for m in desk.session.state.models] == ["box"]


def test_nothing_can_be_edited_while_labels_are_propagated(desk: Desk) -> None:
    desk.controller.nudge(shift=(1, 0, 0))
    before = desk.session.state
    operations.propagate(desk.controller)
    assert desk.controller.task is not None
    desk.controller.nudge(shift=(1, 0, 0))
    desk.controller.undo()
    desk.controller.cancel()
    assert desk.session.state == before
    assert desk.messages[-1] == "Propagate: wait until it is done."
    desk.wait_until_idle()
    label = Scene.open(desk.session.scene.root).labels.of(1)
    assert label is not None
    assert label.T_world_obj is not None
    assert not desk.session.unsaved


def test_a_conflict_is_asked_about_where_there_is_a_dialog(desk: Desk) -> None:
    desk.controller.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
    scene = Scene.open(desk.session.scene.root)
    label = scene.labels.of(1)
    assert label is not None
    theirs = msgspec.structs.replace(label, T_cam_obj=ELSEWHERE.flat(), T_world_obj=None)
    scene.save_labels(scene.labels.with_label(theirs))
    assert not operations.save(desk.controller)
    assert "others changed" in desk.messages[-1]
    desk.controller.dialogs = frozenset({"conflict"})
    assert not operations.save(desk.controller)
    assert [e.text for e in desk.told("ask")] == ["conflict"]
    assert desk.controller.conflict == "box_1"
    assert operations.save(desk.controller, on_conflict="theirs")
    assert desk.session.object("box_1").placements[0].T_cam_obj == ELSEWHERE.flat()


def test_refinements_wait_for_each_other(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    c = desk.controller
    c.apply(AddObject(object="box_2", model="box"))
    c.apply(SetPoses.one("box_2", 0, ELSEWHERE, method="typed"))
    begun = []

    def perform(_: object, title: str, request: object, names: list[str]) -> None:
        del request
        begun.append((title, names))
        c.start(title, lambda _: GO_ON.wait(30), lambda _: None)

    monkeypatch.setattr(operations, "perform", perform)
    for name in ("box_1", "box_2", "box_2"):
        c.select(name)
        assert BY_ID["refine"].enabled(c)
        BY_ID["refine"].run(c)
    assert begun == [("Refine box_1", ["box_1"])]
    assert desk.messages == ["Refine box_2 starts after Refine box_1."]
    finish(desk)
    assert begun == [("Refine box_1", ["box_1"]), ("Refine box_2", ["box_2"])]


def test_what_waits_for_an_object_that_is_removed_is_not_begun(desk: Desk) -> None:
    c = desk.controller
    start(desk)
    operations.refine(c)
    c.apply(RemoveObject(object="box_1"))
    finish(desk)
    assert c.task is None
    assert not any("Refine" in m and "drop" in m for m in desk.messages)
