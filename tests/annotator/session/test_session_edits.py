"""Edits of a session: what each does, and that undo takes all of it back."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scene_on_disk import camera_pose

from annotator.session import (
    AddClick,
    AddObject,
    Change,
    ChangeClick,
    ChangeObject,
    ClearPose,
    Click,
    CompoundEdit,
    EnterModel,
    Move,
    PoseChange,
    RemoveObject,
    Session,
    SetPoses,
    SetSymmetry,
)
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene.model import SymmetryModel


@pytest.fixture
def session(root: Path):  # type: ignore[no-untyped-def]
    with Session.open(root, annotator="mk") as opened:
        yield opened


@pytest.fixture
def loose(loose_root: Path):  # type: ignore[no-untyped-def]
    with Session.open(loose_root, annotator="mk") as opened:
        yield opened


POSE = SE3.exp([0.02, -0.01, 0.5, 0.1, 0.2, 0.3])


class TestPoses:
    def test_in_a_posed_scene_one_pose_holds_in_all_frames(self, session: Session) -> None:
        session.apply(SetPoses.one("box_1", 2, POSE, method="typed"))
        expected = camera_pose(2) @ POSE
        for frame in (0, 1, 2):
            there = session.pose("box_1", frame)
            assert there is not None
            assert np.allclose((camera_pose(frame) @ there).matrix(), expected.matrix(), atol=1e-12)
        assert list(session.object("box_1").placements) == [2]

    def test_without_camera_poses_each_frame_is_on_its_own(self, loose: Session) -> None:
        loose.apply(SetPoses.one("box_1", 0, POSE, method="typed"))
        loose.apply(SetPoses.one("box_1", 2, POSE, method="typed"))
        assert loose.pose("box_1", 1) is None
        loose.apply(ClearPose(object="box_1", frame=0))
        assert list(loose.object("box_1").placements) == [2]
        assert loose.pose_problem is not None
        assert "camera poses" in loose.pose_problem

    def test_a_typed_pose_with_few_digits_becomes_an_exact_rotation(self, session: Session) -> None:
        rounded = [round(x, 5) for x in POSE.flat()]
        change = PoseChange(object="box_1", frame=0, T_cam_obj=rounded)
        session.apply(SetPoses(changes=[change]))
        placed = session.pose("box_1", 0)
        assert placed is not None
        assert np.abs(placed.R @ placed.R.T - np.eye(3)).max() < 1e-14
        assert np.abs(placed.matrix() - POSE.matrix()).max() < 2e-5

    @pytest.mark.parametrize("axes", ["camera", "object"])
    def test_a_step_shifts_along_the_axes_asked_for(self, session: Session, axes: str) -> None:
        before = session.pose("box_1", 1)
        assert before is not None
        session.apply(Move(object="box_1", frame=1, axes=axes, shift_mm=[1.0, -2.0, 3.0]))  # type: ignore[arg-type]
        after = session.pose("box_1", 1)
        assert after is not None
        shift = after.t - before.t
        expected = np.array([0.001, -0.002, 0.003])
        assert np.allclose(shift, expected if axes == "camera" else before.R @ expected, atol=1e-12)
        assert np.allclose(after.R, before.R, atol=1e-12)

    def test_a_turn_keeps_the_centre_of_the_mesh_where_it_is(self, session: Session) -> None:
        before = session.pose("box_1", 0)
        session.apply(Move(object="box_1", frame=0, turn_deg=[0.0, 0.0, 90.0]))
        after = session.pose("box_1", 0)
        assert before is not None
        assert after is not None
        centre = session.centre("box")
        assert np.allclose(before @ centre, after @ centre, atol=1e-12)
        quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        assert np.allclose(after.R, quarter @ before.R, atol=1e-12)

    def test_a_moved_object_is_no_longer_done(self, session: Session) -> None:
        session.apply(ChangeObject(object="box_1", status="done"))
        session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
        assert session.object("box_1").status == "open"

    @pytest.mark.parametrize(
        ("pose", "problem"),
        [
            (SE3(np.eye(3), np.array([0, 0, -0.5])), "behind the camera"),
            (SE3(np.eye(3), np.array([0, 0, 500.0])), "distance is implausible"),
        ],
    )
    def test_poses_that_no_camera_can_see_are_refused(
        self, session: Session, pose: SE3, problem: str
    ) -> None:
        before = session.state
        with pytest.raises(ToolkitError, match=problem) as caught:
            session.apply(SetPoses.one("box_1", 0, pose, method="typed"))
        assert "--pose" not in str(caught.value)
        assert session.state is before

    def test_numbers_that_are_not_finite_never_reach_the_journal(self, session: Session) -> None:
        nan = float("nan")
        for edit in (
            lambda: SetPoses.one("box_1", 0, SE3(np.eye(3), np.array([nan, 0, 1])), method="x"),
            lambda: Move(object="box_1", frame=0, shift_mm=[nan, 0, 0]),
            lambda: AddClick(object="box_1", frame=0, click=Click(u=nan, v=1, point=[0, 0, 0])),
        ):
            with pytest.raises(ToolkitError):
                session.apply(edit())
        assert not session.unsaved

    def test_a_mirrored_matrix_is_refused(self) -> None:
        mirrored = np.diag([1.0, 1, -1, 1])
        mirrored[2, 3] = 1
        with pytest.raises(ToolkitError, match="not a rotation"):
            PoseChange(object="box_1", frame=0, T_cam_obj=mirrored.ravel().tolist())

    def test_frames_in_which_no_pose_can_be_set_are_named(self, session: Session) -> None:
        with pytest.raises(ToolkitError, match=r"no pose can be set in this frame.*77"):
            session.apply(SetPoses.one("box_1", 77, POSE, method="typed"))


class TestObjects:
    def test_a_new_object_gets_a_free_id(self, session: Session) -> None:
        session.apply(AddObject(object="box_2", model="box", material="transparent"))
        assert session.object("box_2").id == 2

    def test_the_id_of_a_removed_object_is_not_given_away(self, session: Session) -> None:
        """Masks that were rendered with it would mean another object."""
        session.apply(RemoveObject(object="box_1"))
        session.apply(AddObject(object="other", model="box"))
        assert session.object("other").id == 2
        with pytest.raises(ToolkitError, match="id is taken"):
            session.apply(AddObject(object="third", model="box", id=1))

    def test_all_ids_taken_is_told(self, session: Session) -> None:
        edits = [AddObject(object=f"b{i}", model="box") for i in range(2, 255)]
        session.apply(CompoundEdit(edits=edits))  # type: ignore[arg-type]
        with pytest.raises(ToolkitError, match="no object id is free"):
            session.apply(AddObject(object="one_more", model="box"))

    def test_names_are_unique_and_safe(self, session: Session) -> None:
        session.apply(AddObject(object="box_2", model="box"))
        for edit in (
            AddObject(object="box_1", model="box"),
            ChangeObject(object="box_2", name="box_1"),
        ):
            with pytest.raises(ToolkitError, match="there is an object of this name"):
                session.apply(edit)
        with pytest.raises(ToolkitError, match="not a safe name"):
            session.apply(ChangeObject(object="box_2", name="../x"))

    def test_renaming_keeps_id_pose_and_clicks(self, session: Session) -> None:
        session.apply(AddClick(object="box_1", frame=0, click=Click(u=1, v=2, point=[0, 0, 0])))
        before = session.object("box_1")
        session.apply(ChangeObject(object="box_1", name="carton"))
        assert session.object("carton") == msgspec.structs.replace(before, name="carton")
        session.undo()
        assert session.object("box_1") == before

    def test_unknown_names_list_the_known_ones(self, session: Session) -> None:
        with pytest.raises(ToolkitError, match=r"no such object.*known: box_1"):
            session.apply(RemoveObject(object="mug"))
        with pytest.raises(ToolkitError, match=r"no such model.*known: box"):
            session.apply(AddObject(object="mug", model="mug"))

    def test_an_object_without_a_pose_cannot_be_done(self, session: Session) -> None:
        session.apply(AddObject(object="box_2", model="box"))
        with pytest.raises(ToolkitError, match="without a pose cannot be done"):
            session.apply(ChangeObject(object="box_2", status="done"))

    def test_a_change_of_nothing_is_refused(self) -> None:
        with pytest.raises(ToolkitError, match="nothing to change"):
            ChangeObject(object="box_1")


class TestClicks:
    def test_clicks_stay_where_they_were_clicked_to_the_last_bit(self, session: Session) -> None:
        click = Click(u=12.345678901234567, v=7.1, point=[0.0123456789, -0.02, 0.05])
        session.apply(AddClick(object="box_1", frame=1, click=click))
        assert session.object("box_1").clicks == {1: [click]}

    def test_clicks_are_corrected_and_removed_by_number(self, session: Session) -> None:
        a, b, c = (Click(u=float(i), v=0.5, point=[0, 0, 0]) for i in range(3))
        for click in (a, b):
            session.apply(AddClick(object="box_1", frame=1, click=click))
        session.apply(ChangeClick(object="box_1", frame=1, index=0, click=c))
        assert session.object("box_1").clicks[1] == [c, b]
        session.apply(ChangeClick(object="box_1", frame=1, index=1))
        session.apply(ChangeClick(object="box_1", frame=1, index=0))
        assert session.object("box_1").clicks == {}
        with pytest.raises(ToolkitError, match="no such point"):
            session.apply(ChangeClick(object="box_1", frame=1, index=0))


class TestUndo:
    def test_every_kind_of_edit_is_taken_back_bit_for_bit(self, session: Session) -> None:
        model = msgspec.structs.replace(session.state.models[0], id="copy")
        half_turn = SymmetryModel(discrete=[SE3.exp([0, 0, 0, 0, 0, np.pi]).flat()])
        edits = [
            EnterModel(model=model),
            SetSymmetry(model="box", symmetry=half_turn),
            AddObject(object="second", model="copy"),
            ChangeObject(object="second", name="renamed", material="specular", note="look"),
            SetPoses.one("renamed", 1, POSE, method="gizmo"),
            Move(object="renamed", frame=2, axes="object", turn_deg=[0, 5, 0]),
            ChangeObject(object="renamed", status="done"),
            AddClick(object="renamed", frame=0, click=Click(u=0.1, v=0.2, point=[0, 0, 0.1])),
            ChangeClick(object="renamed", frame=0, index=0),
            ClearPose(object="renamed", frame=0),
            RemoveObject(object="box_1"),
            CompoundEdit(edits=[AddObject(object="x", model="box"), RemoveObject(object="x")]),
        ]  # fmt: skip
        states = [session.state]
        for edit in edits:
            session.apply(edit)  # type: ignore[arg-type]
            states.append(session.state)
        for state in reversed(states[:-1]):
            session.undo()
            assert session.state == state
        assert not session.unsaved
        for state in states[1:]:
            session.redo()
            assert session.state == state
        with pytest.raises(ToolkitError, match="nothing to redo"):
            session.redo()

    def test_undo_has_no_limit(self, session: Session) -> None:
        """A peer forgets the 21st step, and redoes none."""
        start = session.state
        for _ in range(120):
            session.apply(Move(object="box_1", frame=0, shift_mm=[0.1, 0, 0]))
        end = session.state
        for _ in range(120):
            session.undo()
        assert session.state == start
        for _ in range(120):
            session.redo()
        assert session.state == end

    def test_a_new_edit_ends_what_could_be_redone(self, session: Session) -> None:
        session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
        session.undo()
        session.apply(Move(object="box_1", frame=0, shift_mm=[0, 1, 0]))
        assert session.redoable is None

    def test_edits_made_together_are_one_step_or_none(self, session: Session) -> None:
        before = session.state
        good = AddObject(object="x", model="box")
        with pytest.raises(ToolkitError, match="no such object"):
            session.apply(CompoundEdit(edits=[good, RemoveObject(object="missing")]))
        assert session.state is before
        session.apply(
            CompoundEdit(edits=[good, SetPoses.one("x", 0, POSE, method="drop")], label="Drop x")
        )
        assert [s.title for s in session.steps] == ["Drop x"]
        session.undo()
        assert session.state == before


class TestListeners:
    def test_listeners_hear_what_happened_to_which_objects(self, session: Session) -> None:
        heard: list[Change] = []
        stop = session.subscribe(heard.append)
        session.apply(ChangeObject(object="box_1", name="b"))
        session.undo()
        session.redo()
        session.save()
        stop()
        session.undo()
        assert [(c.kind, c.title, c.objects) for c in heard] == [
            ("edit", "Rename box_1 to b", ("box_1", "b")),
            ("undo", "Rename box_1 to b", ("box_1", "b")),
            ("redo", "Rename box_1 to b", ("box_1", "b")),
            ("saved", "Save", ()),
        ]

    def test_a_snapshot_does_not_follow_the_session(self, session: Session) -> None:
        snapshot = session.snapshot()
        before = session.pose("box_1", 2)
        session.apply(AddObject(object="box_2", model="box"))
        session.apply(Move(object="box_1", frame=0, shift_mm=[5, 0, 0]))
        assert before is not None
        there = snapshot.pose("box_1", 2)
        assert there is not None
        assert np.array_equal(there.matrix(), before.matrix())
        assert [o.name for o in snapshot.scene.objects.objects] == ["box_1"]
        assert [o.name for o in session.snapshot().scene.objects.objects] == ["box_1", "box_2"]


def test_provenance_of_a_placement_says_who_when_and_how(session: Session) -> None:
    session.apply(SetPoses.one("box_1", 0, POSE, method="refine", refinement="3 views"))
    placement = session.object("box_1").placements[0]
    assert (placement.annotator, placement.method, placement.refinement) == (
        "mk", "refine", "3 views",
    )  # fmt: skip
    assert placement.time.endswith("Z")
    session.apply(Move(object="box_1", frame=0, shift_mm=[0.1, 0, 0]))
    moved = session.object("box_1").placements[0]
    assert (moved.method, moved.refinement) == ("step", "")
