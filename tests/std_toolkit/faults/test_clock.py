"""A clock that was set back by a day: files from tomorrow are neither redone nor trusted more."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from scene_on_disk import contents

from std_toolkit.cli.main import main
from std_toolkit.geometry import SE3
from std_toolkit.scene import Labels, Scene
from std_toolkit.scene.model import pose_from_list

pytestmark = pytest.mark.slow
DAY_S = 86_400
STEPS = (
    ("propagate",),
    ("render", "--renderer", "raycast", "--workers", "1"),
    ("check", "--workers", "1"),
)


def run(root: Path) -> None:
    for name, *options in STEPS:
        assert main(["--quiet", name, str(root), *options]) in (0, 1)  # a failed gate is no error


def times(root: Path) -> dict[Path, int]:
    return {p: p.stat().st_mtime_ns for p in sorted(root.rglob("*")) if p.is_file()}


def test_work_of_tomorrow_is_kept_and_older_labels_are_noticed(root: Path) -> None:
    run(root)
    made = contents(root)
    for path, time_ns in times(root).items():
        os.utime(path, ns=(time_ns + DAY_S * 10**9,) * 2)
    before = times(root)
    run(root)
    assert contents(root) == made
    assert {p.name for p, time_ns in times(root).items() if before.get(p) != time_ns} <= {"lock"}

    # Labels of today are older than the maps that were made of the former ones.
    scene = Scene.open(root)
    (label,) = scene.labels.labels
    moved = SE3.exp([0.02, 0, 0, 0, 0, 0]) @ pose_from_list(label.T_cam_obj)
    scene.save_labels(Labels(labels=[type(label)(object=1, frame=0, T_cam_obj=moved.flat())]))
    run(root)
    changed = {n for n, content in contents(root).items() if made.get(n) != content}
    assert {"gt/depth/000000.exr", "gt/mask/000002.png", "check/report.json"} <= changed
