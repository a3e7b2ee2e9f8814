"""Saving: what is written, what is left alone, and what happens when others write too."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from curated import POSE, curate, pose_file
from scene_on_disk import contents

from annotator.session import (
    AddClick,
    ChangeObject,
    ClearPose,
    Click,
    Move,
    RemoveObject,
    Session,
    SetPoses,
)
from annotator.session.merge import differ
from std_toolkit import __version__
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import utc_text
from std_toolkit.scene import LabelProvenance, Scene


def rows(root: Path) -> dict[int, str]:
    """The bytes of each label."""
    text = (root / "labels.json").read_text()
    parts = text.split('    {\n      "object": ')[1:]
    return {int(p.split(",")[0]): p.partition("\n    }")[0] for p in parts}


class TestWhatIsWritten:
    def test_the_last_edit_is_the_origin_though_the_clock_was_set_back(
        self, loose_root: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Poses by frame, without camera poses: the label names the method of the latest."""
        with Session.open(loose_root, annotator="ann") as session:
            session.apply(SetPoses.one("box_1", 1, POSE, method="typed"))
            yesterday = "2020-01-01T00:00:00.000Z"
            monkeypatch.setattr(
                "annotator.session.editing.utc_text",
                lambda moment=None, **form: utc_text(moment, **form) if moment else yesterday,
            )
            session.apply(SetPoses.one("box_1", 2, POSE, method="refine"))
            session.save()
        label = Scene.open(loose_root).labels.of(1)
        assert label is not None and label.method == "refine"
        assert isinstance(label.provenance, LabelProvenance)
        assert label.provenance.time > yesterday

    def test_labels_that_were_not_edited_stay_to_the_byte(self, several: Path) -> None:
        before = rows(several)
        assert '"views": {\n        "2"' in before[2]
        with Session.open(several, annotator="mk") as session:
            session.apply(SetPoses.one("bare", 1, POSE, method="typed"))
            report = session.save()
        assert report.labelled == ("bare",)
        assert report.files == ("labels.json",)
        after = rows(several)
        assert {i: after[i] for i in before} == before

    def test_nothing_edited_is_nothing_written(self, several: Path) -> None:
        before = contents(several)
        with Session.open(several) as session:
            assert str(session.save()) == "There is nothing to save."
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            session.undo()
            assert not session.unsaved
            assert session.save().files == ()
        after = {k: v for k, v in contents(several).items() if "annotate" not in k}
        assert after == before

    def test_a_label_tells_who_when_with_what_and_how(self, root: Path) -> None:
        with Session.open(root, annotator="mk") as session:
            session.apply(
                SetPoses.one("box_1", 1, POSE, method="refine", refinement="edges in 3 frames")
            )
            session.save()
        label = Scene.open(root).labels.of(1)
        assert label is not None
        assert (label.frame, label.method, label.annotator) == (1, "refine", "mk")
        assert label.T_cam_obj == POSE.flat()
        assert label.T_world_obj is None  # to be propagated again
        known = label.provenance
        assert isinstance(known, LabelProvenance)
        assert (known.tool, known.version) == ("std-annotate", __version__)
        assert known.refinement == "edges in 3 frames"
        assert known.time.endswith("Z")

    def test_the_time_worked_adds_up_over_sessions_and_scripts_add_none(self, root: Path) -> None:
        def worked(**options: bool) -> float | None:
            with Session.open(root, **options) as session:  # type: ignore[arg-type]
                for _ in range(3):
                    session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
                session.save()
            label = Scene.open(root).labels.of(1)
            assert label is not None
            assert isinstance(label.provenance, LabelProvenance)
            return label.provenance.hands_on_s

        assert worked(by_hand=False) is None
        first = worked()
        second = worked()
        assert first is not None
        assert second is not None
        assert 0 <= first <= second < 30
        assert worked(by_hand=False) == second

    def test_status_notes_and_clicks_are_kept_with_the_scene(self, root: Path) -> None:
        click = Click(u=12.3456789012345, v=40.5, point=[0.01, -0.02, 0.03])
        with Session.open(root) as session:
            session.apply(AddClick(object="box_1", frame=1, click=click))
            session.apply(ChangeObject(object="box_1", status="done", note="handle hidden"))
            labels = (root / "labels.json").read_bytes()
            assert session.save().files == ("annotation.json",)
        assert (root / "labels.json").read_bytes() == labels
        with Session.open(root) as session:
            thing = session.object("box_1")
            assert (thing.status, thing.note, thing.clicks) == (
                "done",
                "handle hidden",
                {1: [click]},
            )

    def test_removed_objects_take_their_labels_with_them(self, several: Path) -> None:
        with Session.open(several) as session:
            session.apply(ChangeObject(object="two_views", note="x"))
            session.save()
            session.apply(RemoveObject(object="two_views"))
            session.save()
        scene = Scene.open(several)
        assert [o.name for o in scene.objects.objects] == ["box_1", "bare"]
        assert [x.object for x in scene.labels.labels] == [1]
        assert scene.annotation.objects == []

    def test_an_object_without_camera_poses_keeps_one_pose_per_frame(
        self, loose_root: Path
    ) -> None:
        other = SE3.exp([0, 0, 0.7, 0, 0.1, 0])
        with Session.open(loose_root) as session:
            session.apply(SetPoses.one("box_1", 2, POSE, method="typed"))
            session.apply(SetPoses.one("box_1", 0, other, method="typed"))
            session.save()
            state = session.state
        label = Scene.open(loose_root).labels.of(1)
        assert label is not None
        assert {label.frame, *map(int, label.views)} == {0, 2}
        with Session.open(loose_root) as session:
            assert not differ(session.state, state)
            session.apply(ClearPose(object="box_1", frame=label.frame))
            session.save()
        label = Scene.open(loose_root).labels.of(1)
        assert label is not None
        assert label.views == {}

    def test_a_saved_session_opens_as_it_was(self, several: Path) -> None:
        """A peer cannot open the work space that it wrote."""
        with Session.open(several) as session:
            session.apply(Move(object="two_views", frame=1, turn_deg=[0, 0, 3]))
            session.apply(SetPoses.one("bare", 2, POSE, method="typed"))
            session.apply(ChangeObject(object="bare", status="done"))
            session.apply(ChangeObject(object="box_1", name="carton", material="specular"))
            session.save()
            state = session.state
        with Session.open(several) as session:
            assert not differ(session.state, state)
            assert session.object("bare").placements == state.object("bare").placements


class TestUndoAndSaving:
    def test_undo_survives_saving(self, root: Path) -> None:
        with Session.open(root) as session:
            start = session.state
            for _ in range(3):
                session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            end = session.state
            session.save()
            assert not session.unsaved
            for _ in range(3):
                session.undo()
            assert session.state == start
            assert session.unsaved
            session.save()
            for _ in range(3):
                session.redo()
            assert session.state == end
            session.save()
        with Session.open(root) as session:
            assert not differ(session.state, end)


class TestPropagate:
    def test_propagating_saves_and_places_the_object_in_all_frames(self, several: Path) -> None:
        with Session.open(several) as session:
            session.apply(SetPoses.one("bare", 1, POSE, method="typed"))
            session.apply(ChangeObject(object="bare", status="done"))
            report = session.propagate()
            assert not session.unsaved
            assert session.object("bare").status == "done"
            assert "bare: propagated from 1 annotated frame to 3 of 3 frames" in str(report)
            T_world_obj = session.T_world_obj("bare")
        scene = Scene.open(several)
        there = scene.T_world_obj(3)
        assert there is not None
        assert T_world_obj is not None
        assert np.abs(there.matrix() - T_world_obj.matrix()).max() < 1e-12

    def test_a_pose_that_propagating_moved_can_be_taken_back(self, several: Path) -> None:
        """Two views are fused into one pose: that is a change, and a step of undo."""
        path = pose_file(several.parent, POSE)
        curate("label", several, "--object", "two_views", "--frame", 2, "--pose", path)
        nearby = SE3(POSE.R, POSE.t + np.array([0.001, 0, 0]))
        scene = Scene.open(several)
        a, b = scene.T_world_cam(1), scene.T_world_cam(2)
        assert a is not None
        assert b is not None
        with Session.open(several) as session:
            before = session.object("two_views").placements
            path = pose_file(several.parent, a.inverse() @ b @ nearby)
            curate("label", several, "--object", "two_views", "--frame", 1, "--pose", path,
                   "--add-view")  # fmt: skip
            session.propagate()
            moved = session.object("two_views").placements
            assert moved != before
            assert session.undoable is not None
            assert session.undoable.title == "Propagate"
            session.undo()
            assert session.object("two_views").placements == before
            assert session.unsaved

    def test_a_refined_label_is_shown_where_the_refinement_put_it(self, root: Path) -> None:
        document = json.loads((root / "labels.json").read_text())
        label = document["labels"][0]
        label["refined"] = True
        label["T_world_obj"][3] += 0.004
        (root / "labels.json").write_text(json.dumps(document))
        before = (root / "labels.json").read_bytes()
        with Session.open(root) as session:
            there = session.T_world_obj("box_1")
            assert there is not None
            assert abs(there.t[0] - label["T_world_obj"][3]) < 1e-12
            assert "several frames" in session.object("box_1").placements[0].refinement
            session.apply(ChangeObject(object="box_1", status="done"))
            session.save()
        assert (root / "labels.json").read_bytes() == before


KILLED = """
import os, signal, sys
from pathlib import Path
import std_toolkit.io.documents as documents
from annotator.session import *
from std_toolkit.geometry import SE3

root, writes = sys.argv[1], int(sys.argv[2])
session = Session.open(root, annotator="mk")
session.apply(RemoveObject(object="two_views"))
session.apply(AddObject(object="fresh", model="box"))
session.apply(SetPoses.one("fresh", 1, SE3.exp([0, 0, 0.5, 0, 0, 0]), method="typed"))
session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
session.apply(ChangeObject(object="fresh", status="done"))
print(session.state, flush=True)
count, write = 0, documents.write_bytes_atomic

def write_and_die(path, data):
    global count
    if count == writes:
        os.kill(os.getpid(), signal.SIGKILL)
    write(path, data)
    count += 1

documents.write_bytes_atomic = write_and_die
session.save()
print("saved", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("writes", range(5))
def test_a_kill_between_the_files_leaves_a_whole_scene_and_no_conflict(
    several: Path, writes: int
) -> None:
    child = subprocess.run(
        [sys.executable, "-c", KILLED, str(several), str(writes)], capture_output=True, text=True
    )
    killed = child.returncode == -signal.SIGKILL
    assert killed == (writes < 4), child.stderr
    scene = Scene.open(several)  # whole: documents agree with each other
    names = {o.id: o.name for o in scene.objects.objects}
    labelled = {names[x.object] for x in scene.labels.labels}
    # No label ever stands beside another object than its own.
    assert labelled <= {"box_1", "two_views", "fresh"}
    assert scene.annotation.of(3).status == "open"  # id 3 is "bare"
    with Session.open(several) as session:
        assert (session.recovery is not None) == killed
        if killed:
            session.recover()
            assert str(session.state) == child.stdout.splitlines()[0]
            session.save()
    with Session.open(several) as session:
        assert [o.name for o in session.state.objects] == ["box_1", "bare", "fresh"]
        assert session.object("fresh").status == "done"
        assert session.object("fresh").placements
