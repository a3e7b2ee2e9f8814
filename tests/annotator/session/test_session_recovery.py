"""Whatever kills a session, its edits come back bit for bit."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_on_disk import contents, write_scene

from annotator.session import (
    AddClick,
    AddObject,
    AnyEdit,
    ChangeClick,
    ChangeObject,
    ClearPose,
    Click,
    CompoundEdit,
    Move,
    RemoveObject,
    Session,
    SetPoses,
)
from annotator.session.journal import history_folder, journal_path, read_journal
from annotator.session.merge import differ
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.labels.entry.label import add_object, set_pose
from std_toolkit.scene import Scene

NUMBER = st.floats(-50, 50, allow_nan=False)
NAME = st.sampled_from(["box_1", "a", "b"])
FRAME = st.integers(0, 3)  # frame 3 does not exist
VECTOR = st.lists(NUMBER, min_size=3, max_size=3)
CLICK = st.builds(Click, u=NUMBER, v=NUMBER, point=VECTOR)
SINGLE = st.one_of(
    st.builds(AddObject, object=NAME, model=st.just("box")),
    st.builds(RemoveObject, object=NAME),
    st.builds(
        ChangeObject,
        object=NAME,
        name=st.none() | NAME,
        note=st.text(max_size=5),
        status=st.sampled_from([None, "open", "done"]),
    ),
    st.builds(
        lambda name, frame, xi: SetPoses.one(
            name, frame, SE3.exp([0.01 * x for x in xi]) @ SE3.exp([0, 0, 0.8, 0, 0, 0]), method="m"
        ),
        NAME,
        FRAME,
        st.lists(NUMBER, min_size=6, max_size=6),
    ),
    st.builds(
        Move,
        object=NAME,
        frame=FRAME,
        axes=st.sampled_from(["camera", "object"]),
        shift_mm=VECTOR,
        turn_deg=VECTOR,
    ),
    st.builds(ClearPose, object=NAME, frame=FRAME),
    st.builds(AddClick, object=NAME, frame=FRAME, click=CLICK),
    st.builds(
        ChangeClick, object=NAME, frame=FRAME, index=st.integers(0, 2), click=st.none() | CLICK
    ),
)
ACTION = st.one_of(
    SINGLE,
    SINGLE,
    SINGLE,
    st.builds(CompoundEdit, edits=st.lists(SINGLE, min_size=1, max_size=3)),
    st.sampled_from(["undo", "undo", "redo", "save", "save mine", "propagate", "others"]),
)


def act(session: Session, action: AnyEdit | str, number: int) -> None:
    """Carry one action out; an edit that does not fit the state is refused and changes nothing."""
    before = session.state
    try:
        match action:
            case "undo" | "redo" | "save":
                getattr(session, action)()
            case "save mine":
                session.save(on_conflict="mine")
            case "propagate":
                session.propagate()
            case "others":
                write_as_others(session.scene.root, number)
            case _:
                session.apply(action)  # type: ignore[arg-type]
    except ToolkitError:
        # A propagation that fails has saved before.
        assert session.state is before or action == "propagate"


def write_as_others(root: Path, number: int) -> None:
    """What `std-curate label` does: an object of theirs, or a pose of one that is there."""
    scene = Scene.open(root)
    pose = SE3.exp([0.001 * number, 0, 0.7, 0, 0, 0.1])
    with scene.lock():
        if number % 2:
            name = ("a", "theirs")[number % 4 // 2]
            add_object(scene, name, model="box", material="specular")
        for thing in scene.objects.objects[-1:]:
            set_pose(scene, thing.name, number % 3, pose)


def wind(session: Session) -> list[object]:
    """Every state that undo leads to, then every one that redo leads back to."""
    seen: list[object] = [session.state]
    while session.undoable is not None:
        session.undo()
        seen.append(session.state)
    while session.redoable is not None:
        session.redo()
        seen.append(session.state)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("labelled", [True, False], ids=["posed", "loose"])
@settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(actions=st.lists(ACTION, max_size=25))
def test_a_session_that_died_comes_back_with_undo_and_redo(
    labelled: bool, actions: list[AnyEdit | str]
) -> None:
    """A copy of the folder is what a crash at this moment would leave."""
    with tempfile.TemporaryDirectory() as folder:
        root = write_scene(Path(folder) / "scene", labelled=labelled, frames=3).root
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fdatasync", lambda _: None)  # here no power fails
            patch.setattr(os, "fsync", lambda _: None)
            with Session.open(root, annotator="mk") as session:
                for number, action in enumerate(actions):
                    act(session, action, number)
                try:
                    session.reload()  # what others wrote last, it did not know yet
                except ToolkitError:
                    assert "others" in actions  # they entered an object of the name of ours
                    return
                crashed = Path(shutil.copytree(root, Path(folder) / "crashed"))
                state, unsaved, history = session.state, session.unsaved, wind(session)
            found = Session.open(crashed, annotator="other")
            assert (found.recovery is not None) == unsaved
            if not unsaved:
                assert not differ(found.state, state)
                return
            found.recover()
            assert found.state == state
            assert wind(found) == history
            found.save(on_conflict="mine")
            saved = found.state
            found.close()
            with Session.open(crashed) as reopened:
                assert not differ(reopened.state, saved)


TYPIST = """
import sys
from annotator.session import Move, Session, ChangeObject
session = Session.open(sys.argv[1], annotator="typist")
print("ready", flush=True)
i = 0
while True:
    i += 1
    if i % 7 == 0:
        session.undo()
    elif i % 5 == 0:
        session.apply(ChangeObject(object="box_1", note=f"note {i}"))
    else:
        session.apply(Move(object="box_1", frame=i % 3, shift_mm=[0.1, 0, 0], turn_deg=[0, i, 0]))
    print(session.state.objects[0].placements, i, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_kill_9_in_the_middle_of_hundreds_of_edits_loses_at_most_the_last(
    root: Path, seed: int
) -> None:
    typist = subprocess.Popen(
        [sys.executable, "-c", TYPIST, str(root)], stdout=subprocess.PIPE, text=True
    )
    assert typist.stdout is not None
    assert typist.stdout.readline() == "ready\n"
    told = [typist.stdout.readline() for _ in range(150)]
    rng = random.Random(seed)
    # Meanwhile it goes on typing: the kill hits any moment of an edit.
    time.sleep(rng.uniform(0, 0.05))
    typist.send_signal(signal.SIGKILL)
    told += typist.stdout.readlines()
    typist.wait()
    typist.stdout.close()
    whole = [line for line in told if line.endswith("\n")]
    seen = len(whole)
    entries = len(read_journal(journal_path(root)).entries)
    # What the typist was told is done is in the journal; one more may be.
    assert entries in (seen, seen + 1)
    with Session.open(root) as session:
        assert session.recovery is not None
        assert session.recovery.annotator == "typist"
        session.recover()
        if entries == seen:
            assert f"{session.state.objects[0].placements} {seen}\n" == whole[-1]


class TestDeciding:
    @pytest.fixture
    def died(self, root: Path) -> Path:
        with Session.open(root, annotator="mk") as session:
            session.apply(Move(object="box_1", frame=0, shift_mm=[1, 0, 0]))
            session.apply(ChangeObject(object="box_1", note="look again"))
        return root

    def test_closing_without_saving_is_no_loss(self, died: Path) -> None:
        """A peer warns that all labels will be lost, and loses them."""
        session = Session.open(died)
        assert session.recovery is not None
        assert session.recovery.count == 2
        assert "2 edits by mk" in str(session.recovery)
        session.recover()
        assert session.object("box_1").note == "look again"
        session.close()

    def test_nothing_is_edited_before_it_is_decided(self, died: Path) -> None:
        with Session.open(died) as session:
            for attempt in (
                lambda: session.apply(ChangeObject(object="box_1", note="x")),
                session.undo,
                session.save,
            ):
                with pytest.raises(ToolkitError, match=r"decide first.*2 edits by mk"):
                    attempt()
        with Session.open(died) as session:  # and it is still there
            assert session.recovery is not None

    def test_discarded_edits_are_kept_aside(self, died: Path) -> None:
        journal = journal_path(died).read_bytes()
        with Session.open(died, recover="no") as session:
            assert session.recovery is None
            assert session.object("box_1").note == ""
            session.apply(ChangeObject(object="box_1", note="new"))
        (kept,) = history_folder(died).glob("*-discarded.jsonl")
        assert kept.read_bytes() == journal

    def test_close_with_discard_keeps_the_journal_aside_too(self, root: Path) -> None:
        session = Session.open(root)
        session.apply(ChangeObject(object="box_1", note="x"))
        session.close(discard=True)
        assert len(list(history_folder(root).glob("*-discarded.jsonl"))) == 1
        with Session.open(root) as again:
            assert again.recovery is None

    def test_recovered_edits_go_on_in_the_same_journal(self, died: Path) -> None:
        with Session.open(died, annotator="b", recover="yes") as session:
            session.apply(ChangeObject(object="box_1", note="more"))
            session.undo()
            session.undo()
            state = session.state
        with Session.open(died, recover="yes") as session:
            assert session.state == state
            assert len(session.steps) == 1

    def test_edits_of_another_recording_are_not_brought_back(self, died: Path) -> None:
        frames = json.loads((died / "frames.json").read_text())
        frames["frames"].pop()
        (died / "frames.json").write_text(json.dumps(frames))
        poses = json.loads((died / "poses.json").read_text())
        poses["frames"].pop()
        (died / "poses.json").write_text(json.dumps(poses))
        with Session.open(died) as session:
            assert "another recording" in str(session.recovery)
            with pytest.raises(ToolkitError, match=r"cannot be recovered.*kept aside"):
                session.recover()
            session.discard_recovery()

    def test_what_others_wrote_meanwhile_is_taken_over(self, died: Path) -> None:
        from std_toolkit.cli.main import main

        pose = died / "pose.txt"
        pose.write_text(" ".join(map(str, SE3.exp([0, 0, 0.5, 0, 0, 0]).flat())))
        arguments = ["label", str(died), "--object", "second", "--model", "box"]
        assert main(["--quiet", *arguments, "--frame", "1", "--pose", str(pose)]) == 0
        with Session.open(died, recover="yes") as session:
            assert session.object("box_1").note == "look again"
            assert list(session.object("second").placements) == [1]
            session.undo()
            assert session.object("box_1").note == ""
            assert list(session.object("second").placements) == [1]
            session.save()
            assert [o.name for o in session.scene.objects.objects] == ["box_1", "second"]

    def test_recovery_does_not_depend_on_meshes_or_camera_poses(self, died: Path) -> None:
        with Session.open(died, recover="yes") as session:
            state = session.state
        (died / "models/box/box.ply").unlink()
        poses = json.loads((died / "poses.json").read_text())
        poses["frames"] = poses["frames"][:1]
        (died / "poses.json").write_text(json.dumps(poses))
        with Session.open(died, recover="yes") as session:
            assert session.state == state


def test_looking_at_a_scene_changes_no_file_of_it(root: Path) -> None:
    before = contents(root)
    with Session.open(root, read_only=True) as session:
        assert session.pose("box_1", 1) is not None
    with Session.open(root):
        pass
    after = contents(root)
    assert {k: v for k, v in after.items() if not k.startswith(".std/")} == before
