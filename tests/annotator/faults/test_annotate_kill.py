"""kill -9 while edits are made and saved, over and over, loses the last edit at most.

`make test` kills 8 times; STD_KILLS=100 does it 100 times, as before a release.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hostile_annotation import pose_in_frame
from scene_on_disk import contents, write_scene

from annotator.session.journal import history_folder
from std_toolkit.scene import Scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
KILLS = int(os.environ.get("STD_KILLS", "8"))
STEP_M = 1e-5
X0 = pose_in_frame(0).t[0]


def steps_done(root: Path) -> int:
    """How many moves the saved label has seen; they are all the same."""
    label = Scene.open(root).labels.of(1)
    assert label is not None
    done = (label.T_cam_obj[3] - X0) / STEP_M
    assert done == pytest.approx(round(done), abs=1e-3), "the pose of no step"
    return round(done)


def start(root: Path, script: Path, recover: str = "yes") -> subprocess.Popen[str]:
    command = [sys.executable, "-u", "-m", "annotator.cli", str(root), "--script", str(script)]
    return subprocess.Popen(
        [*command, "--annotator", "mk", "--recover", recover],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def whole(root: Path) -> None:
    """Every document can be read and fits the others; nothing half-written passes for a file."""
    scene = Scene.open(root)
    _ = scene.poses, scene.labels, scene.annotation
    for name in contents(root):
        assert ".tmp" not in name or name.rsplit("/", 1)[-1].startswith("."), name


def test_killed_in_the_middle_of_edits_and_saves(tmp_path: Path) -> None:
    moments = random.Random(int(os.environ.get("STD_KILL_SEED", "0")))
    root = write_scene(tmp_path / "scene").root
    move = {
        "edit": "move", "object": "box_1", "frame": 0, "shift_mm": [1000 * STEP_M, 0, 0]
    }  # fmt: skip
    script, save = tmp_path / "script.json", tmp_path / "save.json"
    # A save after every third edit: half of the time is spent in one.
    script.write_text(json.dumps([move, move, move, {"edit": "save"}] * 2000))
    save.write_text(json.dumps([{"edit": "save"}]))
    told = saved = 0
    for kill in range(KILLS):
        process = start(root, script)
        # The time from the first line on: starting takes longer than all that follows.
        lines: list[str] = []
        assert process.stdout is not None
        lines.append(process.stdout.readline())
        killer = threading.Timer(moments.uniform(0, 0.6), process.kill)
        killer.start()
        lines += process.stdout.readlines()
        killer.join()
        _, err = process.communicate(timeout=60)
        assert process.returncode == -9, err
        whole(root)
        before = told
        told += sum("Move box_1" in line for line in lines if line.endswith("\n"))
        if any("Saved" in line for line in lines):
            saved = before + max(3 * sum("Saved" in line for line in lines) - 3, 0)
        # What a save reported stands in the labels, whatever came after.
        assert steps_done(root) >= saved, f"kill {kill}"
        # What an edit reported comes back, and at most the one that was being made besides.
        process = start(root, save)
        out, err = process.communicate(timeout=60)
        assert process.returncode == 0, out + err
        done = steps_done(root)
        assert told <= done <= told + 1, f"kill {kill}: {told} edits were told, {done} came back"
        told = saved = done
    leftovers = [p for p in root.rglob("*") if ".tmp" in p.name]
    assert leftovers == []
    damaged = [p.name for p in history_folder(root).glob("*damaged*")]
    assert damaged == []
    print(f"{KILLS} kills, {told} edits, none lost")


def test_merging_killed_leaves_no_half_scene(tmp_path: Path) -> None:
    moments = random.Random(1)
    a, b = write_scene(tmp_path / "a", frames=60), write_scene(tmp_path / "b", frames=60)
    before = contents(a.root), contents(b.root)
    command = [sys.executable, "-m", "annotator.cli", "merge", str(a.root), str(b.root)]
    for _ in range(KILLS):
        process = subprocess.Popen(
            [*command, "--out", str(tmp_path / "out")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        try:
            process.wait(timeout=moments.uniform(0.6, 1.6))
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        if (tmp_path / "out").exists():
            scene = Scene.open(tmp_path / "out")
            assert len(scene.labels.labels) == 1
            np.testing.assert_array_equal(scene.read_color(scene.frames[59]).shape, (72, 96, 3))
            break
    if not (tmp_path / "out").exists():
        assert subprocess.run([*command, "--out", str(tmp_path / "out")], check=True)
    # The scene that is there has swept away what killed runs left beside it.
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "out"]
    assert (contents(a.root), contents(b.root)) == before
