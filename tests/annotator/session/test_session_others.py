"""Others write into the scene while it is annotated: nothing of theirs or ours is lost."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from curated import POSE, curate, pose_file
from scene_on_disk import camera_pose, camera_poses, contents

from annotator.session import (
    AddObject,
    Move,
    SaveConflict,
    Session,
    SetPoses,
)
from annotator.session.merge import differ
from std_toolkit.errors import ToolkitError
from std_toolkit.io.locks import scene_lock
from std_toolkit.scene import Labels, Scene


class TestOthers:
    def test_curation_runs_beside_an_annotation(self, several: Path) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            curate("label", several, "--object", "bare", "--material", "transparent", "--frame", 1,
                   "--pose", pose_file(several.parent))  # fmt: skip
            report = session.save()
            assert report.taken_over == ("bare",)
            assert report.labelled == ("box_1",)
            assert session.object("bare").material == "transparent"
            assert session.object("bare").placements[1].T_cam_obj == POSE.flat()
            session.undo()  # takes back our edit, not theirs
            assert session.object("bare").placements
            session.save()
        scene = Scene.open(several)
        assert [x.object for x in scene.labels.labels] == [1, 2, 3]

    def test_a_propagation_beside_an_annotation_is_no_conflict(self, several: Path) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="two_views", frame=0, shift_mm=[1, 0, 0]))
            curate("propagate", several)
            session.save()
            label = Scene.open(several).labels.of(2)
            assert label is not None
            assert label.T_world_obj is None  # ours is newer
            other = Scene.open(several).labels.of(1)
            assert other is not None
            assert other.T_world_obj is not None

    @pytest.mark.parametrize("decision", ["mine", "theirs"])
    def test_what_both_changed_is_listed_and_decided(self, several: Path, decision: str) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            session.apply(Move(object="two_views", frame=0, shift_mm=[1, 0, 0]))
            ours = session.state
            path = pose_file(several.parent)
            curate("label", several, "--object", "box_1", "--frame", 2, "--pose", path)
            before = contents(several)
            with pytest.raises(ToolkitError, match=r"others changed.*'box_1'.*mine or theirs"):
                session.save()
            unchanged = {k: v for k, v in contents(several).items() if "annotate" not in k}
            assert unchanged == {k: v for k, v in before.items() if "annotate" not in k}
            assert session.state is ours
            session.save(on_conflict=decision)  # type: ignore[arg-type]
            placed = session.object("box_1").placements
            if decision == "mine":
                assert placed == ours.object("box_1").placements
            else:
                assert placed[2].T_cam_obj == POSE.flat()
            assert session.object("two_views") == ours.object("two_views")
            state = session.state
        with Session.open(several) as session:
            assert not differ(session.state, state)

    def test_giving_up_ours_for_theirs_can_be_undone(self, several: Path) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            ours = session.object("box_1").placements
            path = pose_file(several.parent)
            curate("label", several, "--object", "box_1", "--frame", 2, "--pose", path)
            session.save(on_conflict="theirs")
            theirs = session.state
            session.undo()
            assert session.object("box_1").placements == ours
            assert session.unsaved
        with Session.open(several, recover="yes") as session:
            assert session.object("box_1").placements == ours
            session.redo()
            assert session.state == theirs
            assert not session.unsaved

    def test_reading_again_does_not_decide_what_both_changed(self, several: Path) -> None:
        """The next save would overwrite theirs without a question."""
        with Session.open(several) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            ours = session.state
            path = pose_file(several.parent)
            curate("label", several, "--object", "box_1", "--frame", 2, "--pose", path)
            with pytest.raises(SaveConflict, match=r"others changed.*box_1.*save first"):
                session.reload()
            assert session.state is ours
            with pytest.raises(SaveConflict):
                session.save()

    def test_new_camera_poses_are_told_also_when_a_conflict_stops_the_saving(
        self, several: Path
    ) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            path = pose_file(several.parent)
            curate("label", several, "--object", "box_1", "--frame", 2, "--pose", path)
            poses = camera_poses([camera_pose(i + 1) for i in range(3)])
            Scene.open(several).save_poses(poses)
            heard: list[str] = []
            session.subscribe(lambda change: heard.append(change.title))
            with pytest.raises(SaveConflict):
                session.save()
            assert heard == ["New camera poses"]

    def test_both_entered_an_object_and_ids_do_not_collide(self, root: Path) -> None:
        with Session.open(root) as session:
            session.apply(AddObject(object="ours", model="box"))
            session.apply(SetPoses.one("ours", 0, POSE, method="typed"))
            path = pose_file(root.parent)
            curate("label", root, "--object", "theirs", "--model", "box", "--frame", 1,
                   "--pose", path)  # fmt: skip
            session.save()
            assert {o.name: o.id for o in session.state.objects} == {
                "box_1": 1, "theirs": 2, "ours": 3,
            }  # fmt: skip
            session.undo()
            session.undo()
            assert [o.name for o in session.state.objects] == ["box_1", "theirs"]
            session.redo()
            assert session.object("ours").id == 3

    def test_an_object_that_others_removed_while_we_edited_it_is_a_conflict(
        self, several: Path
    ) -> None:
        with Session.open(several) as session:
            session.apply(Move(object="two_views", frame=0, shift_mm=[1, 0, 0]))
            scene = Scene.open(several)
            gone = scene.objects.object_named("two_views").id
            kept = [label for label in scene.labels.labels if label.object != gone]
            scene.save_labels(Labels(labels=kept))
            with pytest.raises(ToolkitError, match="others changed"):
                session.save()

    @pytest.mark.parametrize("way", ["save", "reload"])
    def test_camera_poses_that_were_recovered_meanwhile_are_used(
        self, loose_root: Path, way: str
    ) -> None:
        with Session.open(loose_root) as session:
            session.apply(SetPoses.one("box_1", 1, POSE, method="typed"))
            assert session.pose("box_1", 0) is None
            poses = camera_poses([camera_pose(i) for i in range(3)])
            Scene.open(loose_root).save_poses(poses)
            heard: list[str] = []
            session.subscribe(lambda change: heard.append(change.kind))
            getattr(session, way)()
            assert "reread" in heard
            assert session.posed
            there = session.pose("box_1", 0)
            assert there is not None
            expected = camera_pose(0).inverse() @ camera_pose(1) @ POSE
            assert np.allclose(there.matrix(), expected.matrix(), atol=1e-12)
            session.apply(Move(object="box_1", frame=2, shift_mm=[1, 0, 0]))
            assert list(session.object("box_1").placements) == [2]
            state = session.state
        with Session.open(loose_root, recover="yes") as session:
            assert session.state == state

    def test_saving_waits_for_nobody_and_names_who_is_writing(self, root: Path) -> None:
        with Session.open(root) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            with (
                scene_lock(root),
                pytest.raises(ToolkitError, match=rf"another process is writing.*{os.getpid()}"),
            ):
                session.save()
            assert session.unsaved
            session.save()

    def test_a_document_that_others_damaged_stops_the_saving_and_loses_nothing(
        self, root: Path
    ) -> None:
        with Session.open(root) as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            whole = (root / "objects.json").read_bytes()
            (root / "objects.json").write_text("{")
            with pytest.raises(ToolkitError, match=r"objects\.json"):
                session.save()
            assert session.unsaved
            (root / "objects.json").write_bytes(whole)
            session.save()
