"""Scenes that lack something, are damaged, or are in use: one clear line, and nothing lost."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_annotation import Annotate, Refuse, documents, pose_in_frame, set_pose
from scene_on_disk import write_scene

from annotator.cli import main
from annotator.session import Move, Session
from annotator.session.journal import history_folder, journal_path
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.io.locks import scene_lock
from std_toolkit.labels.entry.label import set_pose as set_label
from std_toolkit.scene import Scene

# From linux/prctl.h and linux/capability.h.
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2
SAVE = {"edit": "save"}
GOOD = pose_in_frame(0)
MOVED = SE3(GOOD.R @ so3_exp([0.0, 0.0, 0.1]), GOOD.t)
NOTE = {"edit": "change_object", "object": "box_1", "note": "look at the lid"}


def label_pose(root: Path) -> np.ndarray:
    label = Scene.open(root).labels.of(1)
    assert label is not None
    return np.array(label.T_cam_obj)


# --- what a scene may lack ------------------------------------------------------------------------


def test_a_missing_image_does_not_keep_a_script_from_its_work(
    root: Path, annotate: Annotate
) -> None:
    for path in (root / "color").iterdir():
        path.unlink()
    outcome = annotate([set_pose(MOVED), SAVE])
    assert outcome.status == 0, outcome.err
    np.testing.assert_allclose(label_pose(root), MOVED.flat(), atol=1e-12)


def test_a_scene_without_depth_or_camera_poses_is_labelled_frame_by_frame(
    root: Path, annotate: Annotate
) -> None:
    scene = write_scene(root.parent / "bare", labelled=False)
    frames = json.loads((scene.root / "frames.json").read_text())
    for frame in frames["frames"]:
        frame["depth"] = None
    (scene.root / "frames.json").write_text(json.dumps(frames))
    shutil.rmtree(scene.root / "depth")
    steps = [set_pose(GOOD), set_pose(pose_in_frame(2), frame=2), SAVE]
    outcome = annotate(steps, scene=scene.root)
    assert outcome.status == 0, outcome.err
    label = Scene.open(scene.root).labels.of(1)
    assert label is not None
    assert (label.frame, list(label.views)) == (0, ["2"])


def test_a_table_is_not_made_up(root: Path, refuse: Refuse) -> None:
    snap = {"edit": "snap_to_table", "object": "box_1"}
    shutil.rmtree(root / "depth")
    refuse([snap, SAVE], names="depth/000000.png: image file not found")
    frames = json.loads((root / "frames.json").read_text())
    for frame in frames["frames"]:
        frame["depth"] = None
    (root / "frames.json").write_text(json.dumps(frames))
    line = refuse([snap, SAVE], names="no table found")
    assert "by hand" in line


def test_propagating_without_camera_poses_says_what_is_missing(
    root: Path, annotate: Annotate
) -> None:
    scene = write_scene(root.parent / "bare", labelled=False)
    outcome = annotate([set_pose(GOOD), {"edit": "propagate"}], scene=scene.root)
    assert outcome.status == 1
    assert "no camera poses" in outcome.error_lines[0]
    assert "std-curate poses" in outcome.error_lines[0]


def test_a_scene_without_objects_can_be_opened(root: Path, annotate: Annotate) -> None:
    for name in ("objects.json", "labels.json"):
        (root / name).unlink()
    assert annotate([SAVE]).status == 0


def test_what_is_no_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "script.json").write_text("[]")
    for place in (tmp_path, tmp_path / "nowhere", tmp_path / "script.json"):
        assert main([str(place), "--script", str(tmp_path / "script.json")]) == 1
        err = capsys.readouterr().err
        assert err.startswith(f"error: {place}: ") and err.count("\n") == 1
        assert "std-curate import" in err


# --- damaged documents ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "damage", "names"),
    [
        ("annotation.json", lambda _: b"", "annotation.json: not valid JSON"),
        ("annotation.json", lambda _: b'{"objects": [{"object": 9}]}', "annotation.json"),
        ("annotation.json", lambda _: b'{"objects": [{"object": 1, "mood": 1}]}', "mood"),
        (
            "annotation.json",
            lambda _: b'{"objects": [{"object": 1}, {"object": 1}]}',
            "appears twice",
        ),
        (
            "annotation.json",
            lambda _: b'{"objects": [{"object": 1, "clicks": [{"frame": 77, "u": 1, "v": 1,'
            b' "point": [0, 0, 0]}]}]}',
            "annotation.json",
        ),
        ("labels.json", lambda data: data[: len(data) // 2], "labels.json: not valid JSON"),
        ("labels.json", lambda data: data.replace(b'"frame": 0', b'"frame": 50'), "no such frame"),
        ("labels.json", lambda data: data.replace(b'"object": 1', b'"object": 7'), "such object"),
        ("objects.json", lambda data: data.replace(b'"box"', b'"cup"', 1), "objects.json"),
        ("poses.json", lambda data: data.replace(b"1.0", b"2.0", 1), "poses.json"),
        ("frames.json", lambda data: data.replace(b'"id": 1', b'"id": 0'), "frames.json"),
        ("scene.json", lambda data: data.replace(b"90.0", b"-90.0", 1), "scene.json"),
    ],
)  # fmt: skip
def test_damaged_documents_are_named(
    root: Path, refuse: Refuse, name: str, damage: Callable[[bytes], bytes], names: str
) -> None:
    path = root / name
    data = path.read_bytes() if path.exists() else b""
    path.write_bytes(damage(data))
    assert path.read_bytes() != data or not data
    refuse([set_pose(MOVED), SAVE], names=names)


@pytest.mark.parametrize("name", ["annotation.json", "labels.json", "objects.json"])
def test_folders_and_devices_in_place_of_documents(root: Path, refuse: Refuse, name: str) -> None:
    (root / name).unlink(missing_ok=True)
    (root / name).mkdir()
    refuse([SAVE], names=name)
    (root / name).rmdir()
    (root / name).symlink_to("/dev/zero")
    refuse([SAVE], names=name)


# --- another session, another writer --------------------------------------------------------------


def test_a_second_session_is_told_whose_the_first_is(root: Path, refuse: Refuse) -> None:
    with Session.open(root, annotator="anna"):
        line = refuse([set_pose(MOVED), SAVE], names="another process is annotating this scene")
    assert "annotator anna" in line
    assert f"pid {os.getpid()}" in line
    assert "close that session first" in line


def test_a_killed_session_leaves_no_lock(root: Path, annotate: Annotate) -> None:
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, time; from annotator.session import Session; "
            "s = Session.open(sys.argv[1]); print('open', flush=True); time.sleep(60)",
            str(root),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert holder.stdout is not None and holder.stdout.readline() == "open\n"
    assert annotate([SAVE]).status == 1
    holder.kill()
    holder.wait()
    assert annotate([set_pose(MOVED), SAVE]).status == 0


def test_somebody_else_writing_is_waited_for_by_the_person(root: Path, refuse: Refuse) -> None:
    with scene_lock(root):
        refuse([set_pose(MOVED), SAVE], names="another process is writing to this scene")


def test_labels_that_others_set_meanwhile_are_not_overwritten(
    root: Path, annotate: Annotate
) -> None:
    with Session.open(root, annotator="anna") as session:
        session.apply(_move(3.0))
        scene = Scene.open(root)
        theirs = _shifted(5.0)
        set_label(scene, "box_1", 0, theirs, annotator="ben")
        with pytest.raises(ToolkitError, match="others changed these"):
            session.save()
        assert session.unsaved
    np.testing.assert_allclose(label_pose(root), theirs.flat(), atol=1e-12)
    # Nothing of either is lost: anna's edits wait for her.
    outcome = annotate([SAVE], "--recover", "yes")
    assert outcome.status == 1 and "others changed these" in outcome.error_lines[0]
    outcome = annotate([{"edit": "save", "on_conflict": "mine"}], "--recover", "yes")
    assert outcome.status == 0, outcome.err
    np.testing.assert_allclose(label_pose(root), _shifted(3.0).flat(), atol=1e-9)


# --- places that cannot be written ----------------------------------------------------------------


def test_a_read_only_folder(
    root: Path, annotate: Annotate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tests may run as root, whom no permission stops: the kernel's answer is put in."""
    before = documents(root)
    real = os.open

    def read_only(path: Any, flags: int, *args: Any, **more: Any) -> int:
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if writes and str(path).startswith(str(root)):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
        return real(path, flags, *args, **more)

    monkeypatch.setattr(os, "open", read_only)
    outcome = annotate([set_pose(MOVED), SAVE])
    assert outcome.status == 1
    assert len(outcome.error_lines) == 1
    assert "Read-only file system" in outcome.error_lines[0]
    assert "--read-only" in outcome.error_lines[0]
    monkeypatch.undo()
    assert documents(root) == before


def test_a_folder_without_the_right_to_write(root: Path, tmp_path: Path) -> None:
    """The same by the kernel: the process is no longer one that permissions do not stop."""
    script = tmp_path / "script.json"
    script.write_text(json.dumps([set_pose(MOVED), SAVE]))
    before = documents(root)
    folders = [root, *(p for p in root.rglob("*") if p.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    try:
        done = _run(root, script, like_others=True)
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert done.returncode == 1, done.stdout
    assert done.stderr.count("\n") == 1
    assert "Permission denied" in done.stderr and "--read-only" in done.stderr
    assert documents(root) == before


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0, 100, 2_000, 6_000, 12_000])
def test_a_full_disk(root: Path, tmp_path: Path, limit: int) -> None:
    """A limit on the size of files, as the kernel enforces it, in place of a full disk."""
    notes = [{**NOTE, "note": f"{i} " + "x" * 200} for i in range(40)]
    script = tmp_path / "script.json"
    script.write_text(json.dumps([set_pose(MOVED), *notes, SAVE]))
    before = documents(root)
    done = _run(root, script, file_bytes=limit)
    assert done.returncode == 1, done.stdout
    assert done.stderr.count("error:") == 1 and "Traceback" not in done.stderr
    assert "File too large" in done.stderr
    assert documents(root) == before
    # With room again the same script works.
    shutil.rmtree(journal_path(root).parent, ignore_errors=True)
    assert _run(root, script).returncode == 0
    np.testing.assert_allclose(label_pose(root), MOVED.flat(), atol=1e-12)


# --- journals -------------------------------------------------------------------------------------


def unsaved(root: Path, moves: int = 3) -> Path:
    """A session that ended without saving; returns its journal."""
    with Session.open(root, annotator="anna") as session:
        for _ in range(moves):
            session.apply(_move(1.0))
    return journal_path(root)


def test_edits_that_were_not_saved_are_not_passed_over(
    root: Path, annotate: Annotate, refuse: Refuse
) -> None:
    journal = unsaved(root)
    kept = journal.read_bytes()
    line = refuse([set_pose(MOVED), SAVE], names="3 edits by anna")
    assert "--recover yes" in line and "--recover no" in line
    assert journal.read_bytes() == kept
    assert annotate([SAVE], "--recover", "yes").status == 0
    np.testing.assert_allclose(label_pose(root), _shifted(3.0).flat(), atol=1e-9)


def test_edits_that_are_not_wanted_are_kept_aside(root: Path, annotate: Annotate) -> None:
    kept = unsaved(root).read_bytes()
    assert annotate([set_pose(MOVED), SAVE], "--recover", "no").status == 0
    np.testing.assert_allclose(label_pose(root), MOVED.flat(), atol=1e-12)
    discarded = [p for p in history_folder(root).iterdir() if "discarded" in p.name]
    assert [p.read_bytes() for p in discarded] == [kept]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-20],
        lambda data: data[: len(data) // 2] + b"\xff\x00" + data[len(data) // 2 + 2 :],
        lambda data: data + b"not a line\n",
        lambda data: b"\n" + data,
        lambda _: b"",
        lambda data: b"\0" * len(data),
        lambda data: data.replace(b'"check":"', b'"check":"0', 2),
    ],
    ids=["torn", "flipped bytes", "a foreign line", "a line before", "empty", "zeros", "checks"],
)
def test_damaged_journals_lose_what_is_damaged_and_no_more(
    root: Path, annotate: Annotate, damage: Callable[[bytes], bytes]
) -> None:
    journal = unsaved(root)
    damaged = damage(journal.read_bytes())
    journal.write_bytes(damaged)
    before = documents(root)
    outcome = annotate([SAVE])
    assert "Traceback" not in outcome.err
    if outcome.status == 1:  # something can be brought back, and a person has to decide
        assert documents(root) == before
        assert journal.read_bytes() == damaged
        outcome = annotate([SAVE], "--recover", "yes")
    assert outcome.status == 0, outcome.err
    x = label_pose(root)[3]
    steps = round((x - GOOD.t[0]) * 1000)
    assert x == pytest.approx(GOOD.t[0] + steps / 1000, abs=1e-9) and 0 <= steps <= 3
    if steps < 3 and damaged:
        kept = [p.read_bytes() for p in history_folder(root).iterdir()]
        torn_only = damaged == damaged.rstrip(b"\n")
        assert damaged in kept or torn_only, "the damaged journal is not kept"
    # And the scene goes on to be usable.
    assert annotate([set_pose(MOVED), SAVE]).status == 0


def test_a_journal_of_another_recording_is_not_applied(
    root: Path, annotate: Annotate, refuse: Refuse, tmp_path: Path
) -> None:
    journal = unsaved(root)
    other = write_scene(tmp_path / "other", frames=5)
    journal_path(other.root).parent.mkdir(parents=True)
    shutil.copy(journal, journal_path(other.root))
    refuse([SAVE], scene=other.root, names="another recording")
    refuse([SAVE], "--recover", "yes", scene=other.root, names="another recording")
    assert annotate([SAVE], "--recover", "no", scene=other.root).status == 0


@pytest.mark.parametrize("name", [".std", ".std/annotate", ".std/annotate/journal.jsonl"])
def test_links_out_of_the_scene_are_not_followed(
    root: Path, annotate: Annotate, tmp_path: Path, name: str
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "journal.jsonl").write_text("mine\n")
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(outside / "journal.jsonl" if path.suffix else outside)
    annotate([set_pose(MOVED), SAVE])
    assert (outside / "journal.jsonl").read_text() == "mine\n"
    assert [p.name for p in outside.iterdir()] == ["journal.jsonl"]


# --- ended from outside ---------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_script_keeps_its_edits(
    root: Path, tmp_path: Path, annotate: Annotate, number: signal.Signals
) -> None:
    script = tmp_path / "long.json"
    moves = [{"edit": "move", "object": "box_1", "frame": 0, "shift_mm": [0.01, 0, 0]}]
    script.write_text(json.dumps(moves * 4000))
    process = _start(root, script)
    assert process.stdout is not None
    for _ in range(20):
        process.stdout.readline()
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in err
    done = 20 + out.count("Move box_1")
    outcome = annotate([SAVE], "--recover", "yes")
    assert outcome.status == 0, outcome.err
    steps = round((label_pose(root)[3] - GOOD.t[0]) * 100_000)
    assert steps >= done - 1


def _move(x_mm: float) -> Any:
    return Move(object="box_1", frame=0, shift_mm=[x_mm, 0.0, 0.0])


def _shifted(x_mm: float) -> SE3:
    return SE3(GOOD.R, GOOD.t + np.array([x_mm / 1000, 0.0, 0.0]))


def _start(root: Path, script: Path, **more: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-u", "-m", "annotator.cli", str(root), "--script", str(script)]
    return subprocess.Popen(
        [*command, "--annotator", "mk"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # As in a terminal, whatever the shell that runs the tests ignores.
        **{"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **more},
    )


def _run(
    root: Path, script: Path, *, file_bytes: int | None = None, like_others: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a script in a process of its own.

    Args:
        file_bytes: no file can grow beyond it.
        like_others: permissions count for root, too.
    """
    libc = ctypes.CDLL(None, use_errno=True)

    def prepare() -> None:
        if file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))
        if like_others and os.getuid() == 0:
            for capability in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH):
                libc.prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)

    process = _start(root, script, preexec_fn=prepare)
    out, err = process.communicate(timeout=120)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)
