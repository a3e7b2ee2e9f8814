"""A recording that is killed is a scene with every frame finished so far."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sensors.record.cli import main
from sensors.record.frame_table import journal_path
from sensors.record.recording_document import read_recording
from std_toolkit.scene import Scene

pytest.importorskip("pyrealsense2")
REPOSITORY = Path(__file__).resolve().parents[3]


def start(*arguments: str) -> subprocess.Popen[bytes]:
    script = Path(__file__).parent / "recording_process.py"
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, str(script), *arguments], env=environment, stderr=subprocess.DEVNULL
    )


def wait_for_frames(out: Path, count: int) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        if (out / "scene.json").exists() and len(Scene.open(out).frames) >= count:
            return
        time.sleep(0.02)
    raise AssertionError("nothing is recorded")


def check_whole(out: Path) -> int:
    """Every frame of the table can be read."""
    scene = Scene.open(out)
    for frame in scene.frames:
        scene.read_color(frame)
        depth = scene.read_depth(frame)
        assert depth is not None and (depth > 0).mean() > 0.8
    return len(scene.frames)


@pytest.mark.slow
def test_killed_at_any_moment(tmp_path: Path) -> None:
    """Killed three times and gone on with; in the end all finished frames are there, in order."""
    out = tmp_path / "scene"
    rng = np.random.default_rng(5)
    expected = 0
    for attempt in range(3):
        process = start(str(out), *(["--resume"] if attempt else []))
        wait_for_frames(out, expected + 3)
        time.sleep(rng.uniform(0, 0.7))
        process.kill()
        process.wait()
        listed = check_whole(out)
        # Finished: both files and the line in the journal, which is written right after them.
        finished = {p.stem for p in (out / "depth").glob("[0-9]*.png")}
        assert main([str(out), "--recover"]) == 0
        expected = check_whole(out)
        assert expected >= listed
        # Two writers may have been between a frame's files and its line.
        assert len(finished) - expected <= 2 * (attempt + 1) and expected > 3 * attempt
        assert not list(out.rglob(".*.tmp*")) and not journal_path(out).exists()
    sessions = read_recording(out).sessions
    assert len(sessions) == 3 and not any(s.ended for s in sessions)
    ids = [f.id for f in Scene.open(out).frames]
    assert ids == sorted(set(ids))


@pytest.mark.slow
def test_ended_by_a_signal(tmp_path: Path) -> None:
    """SIGTERM, as a session manager sends it, ends like Ctrl-C."""
    out = tmp_path / "scene"
    process = start(str(out))
    wait_for_frames(out, 5)
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=60) == 0
    (session,) = read_recording(out).sessions
    assert session.ended and session.frames == check_whole(out)
    assert not journal_path(out).exists()


@pytest.mark.slow
def test_a_second_recording_into_the_same_scene_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "scene"
    process = start(str(out))
    try:
        wait_for_frames(out, 2)
        assert main([str(out), "--recover"]) == 1
        assert "another process is writing to this scene" in capsys.readouterr().err
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0


def test_a_torn_journal(tmp_path: Path) -> None:
    """Only whole lines of frames whose files are there come back."""
    from tests.scene_on_disk import write_scene

    scene = write_scene(tmp_path / "scene", frames=4, labelled=False)
    root, rows = scene.root, scene.frames
    import msgspec

    from std_toolkit.io.documents import write_document
    from std_toolkit.scene import Frames

    write_document(root / "frames.json", Frames(frames=rows[:1]))
    (root / rows[2].color).unlink()
    lines = [msgspec.json.encode(row) for row in (rows[1], rows[2], rows[3])]
    (root / ".std").mkdir(exist_ok=True)
    journal_path(root).write_bytes(lines[0] + b"\n" + lines[1] + b"\n" + lines[2][:-20])
    assert main([str(root), "--recover"]) == 0
    assert [f.id for f in Scene.open(root).frames] == [0, 1]
