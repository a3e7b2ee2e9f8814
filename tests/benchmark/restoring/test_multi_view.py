"""`std-restore SCENE --multi-view`: files, resuming, what is refused."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmark.cli.restore import main
from std_toolkit.io.exr import read_exr
from std_toolkit.io.images import read_depth, read_png
from tests.benchmark.restoring.view_cases import Seen, errors, seen_from_around, write_scene

REPOSITORY = Path(__file__).resolve().parents[3]


def restore(*words: object) -> int:
    return main([*map(str, words), "--engine", "serial", "--quiet"])


@pytest.fixture(scope="module")
def scene() -> list[Seen]:
    return seen_from_around("bottle", views=12, size=(96, 72))


def results(out: Path) -> dict[str, bytes]:
    """All files of a folder of results, but what tells of the run."""
    found = {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    return {
        name: data for name, data in found.items() if not name.endswith(("lock", "restore.json"))
    }


def test_glass_is_fused_and_all_else_is_as_restored_alone(tmp_path, scene, capsys):
    root = write_scene(tmp_path, scene)
    out, method = tmp_path / "out", f"{tmp_path}/methods.py:Told"
    assert restore(root, "--out", out, "--method", method, "--multi-view") == 0
    assert "12 frames" in capsys.readouterr().out
    assert restore(root, "--out", tmp_path / "alone", "--method", method) == 0
    depths: dict[str, list[np.ndarray]] = {"depth": [], "single/depth": []}
    for seen in scene:
        name = f"{seen.view.name}.png"
        for folder, found in depths.items():
            found.append(read_depth(out / folder / name, scale=1e-3))
        for kind in ("depth", "changed", "spread", "glass", "confidence"):
            alone = read_png(tmp_path / "alone" / kind / name)
            assert np.array_equal(read_png(out / "single" / kind / name), alone)
            same = read_png(out / kind / name)[~seen.glass] == alone[~seen.glass]
            assert same.all(), kind
        changed = read_png(out / "changed" / name) > 0
        assert np.array_equal(
            changed, read_png(root / "depth" / name) != read_png(out / "depth" / name)
        )
        told = json.loads((out / f"frames/{seen.view.name}.json").read_text())
        assert "single frames or camera poses" in told["inputs"]
    fused, single = (np.median(np.abs(errors(depths[k], scene))) for k in ("depth", "single/depth"))
    assert fused < 0.004 < 0.010 < single
    setup, of_single = (
        json.loads((out / f / "restore.json").read_text())["setup"] for f in (".", "single")
    )
    assert setup["multi_view"] and not of_single["multi_view"]


def test_what_is_too_uncertain_after_the_fusion_is_left_out(tmp_path, scene):
    root, out = write_scene(tmp_path, scene), tmp_path / "out"
    given = ("--method", f"{tmp_path}/methods.py:Told", "--multi-view", "--max-error", "15mm")
    assert restore(root, "--out", out, *given) == 0
    for seen in scene[:3]:
        name = f"{seen.view.name}.png"
        depth, spread = (
            read_depth(out / f / name, scale=s) for f, s in (("depth", 1e-3), ("spread", 1e-4))
        )
        # All of it before the fusion: 20 mm are expected.
        assert (depth[seen.glass] > 0).mean() > 0.5
        assert (depth[spread > 0.0151] == 0).all() and (
            depth[seen.glass & (spread < 0.0149)] > 0
        ).all()


def test_a_new_pose_fuses_again_and_nothing_else(tmp_path, scene):
    root, out = write_scene(tmp_path, scene), tmp_path / "out"
    words = (root, "--out", out, "--method", f"{tmp_path}/methods.py:Told", "--multi-view")
    assert restore(*words) == 0
    before = {p: p.stat().st_mtime_ns for p in out.rglob("frames/*.json")}
    assert restore(*words) == 0
    assert before == {p: p.stat().st_mtime_ns for p in out.rglob("frames/*.json")}
    poses = json.loads((root / "poses.json").read_text())
    poses["frames"][3]["T_world_cam"][3] += 0.001
    (root / "poses.json").write_text(json.dumps(poses))
    assert restore(*words) == 0
    for path, then in before.items():
        assert (path.stat().st_mtime_ns == then) == ("single" in path.parts)


def test_a_frame_without_pose_stays_as_it_is_restored_alone(tmp_path, scene, capsys):
    root, out = write_scene(tmp_path, scene), tmp_path / "out"
    poses = json.loads((root / "poses.json").read_text())
    poses["frames"][5] = {"frame": 5, "status": "unregistered"}
    (root / "poses.json").write_text(json.dumps(poses))
    words = [str(root), "--out", str(out), "--method", f"{tmp_path}/methods.py:Told"]
    assert main([*words, "--multi-view", "--engine", "serial"]) == 0
    assert "1 of 12 frames have no camera pose" in capsys.readouterr().err
    for frame, same in (("000005", True), ("000004", False)):
        both = (read_png(out / f / f"{frame}.png") for f in ("depth", "single/depth"))
        assert np.array_equal(*both) == same


@pytest.mark.parametrize(
    ("posed", "method", "told"),
    [
        (False, "Told", "--multi-view: has no camera poses; .*std-curate poses"),
        (True, "Mute", "--multi-view: the method does not say how far off .*compactdr"),
    ],
)
def test_what_cannot_be_fused_is_refused_before_it_is_begun(
    tmp_path, scene, capsys, posed, method, told
):
    root = write_scene(tmp_path, scene, posed=posed)
    given = ("--method", f"{tmp_path}/methods.py:{method}", "--multi-view")
    assert restore(root, "--out", tmp_path / "out", *given) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(told, line), line
    assert not (tmp_path / "out").exists()


def test_a_folder_of_images_is_refused(tmp_path, scene, capsys):
    root = write_scene(tmp_path, scene)
    given = ("--intrinsics", "91.2,91.2,47.5,35.5", "--method", f"{tmp_path}/methods.py:Told")
    images = ("--color", root / "color", "--depth", root / "depth")
    assert restore(*images, "--out", tmp_path / "out", *given, "--multi-view") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "has no camera poses" in line and "std-curate import" in line


SLOW = """
import sys, time
sys.path.pop(0)
from benchmark.cli.restore import main
from benchmark.restoring import multi_view, run

for module in (run, multi_view):
    def write(*words, _write=module.write_frame):
        time.sleep(0.2)
        return _write(*words)
    module.write_frame = write
sys.exit(main())
"""


@pytest.mark.parametrize(("within", "done"), [("single", 1), ("single", 8), (".", 1)])
def test_killed_and_run_again(tmp_path, scene, within, done):
    """Killed in the first pass, after it, and while fused frames are written."""
    root = write_scene(tmp_path, scene[:8])
    method = f"{tmp_path}/methods.py:Told"
    words = [str(root), "--method", method, "--multi-view", "--quiet", "--engine", "serial"]
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    running = subprocess.Popen(
        [sys.executable, "-c", SLOW, *words, "--out", "killed"], cwd=tmp_path, env=environment
    )
    killed = tmp_path / "killed"
    end = time.monotonic() + 120
    while len(list((killed / within).glob("frames/[0-9]*.json"))) < done:
        assert time.monotonic() < end and running.poll() is None
        time.sleep(0.01)
    running.send_signal(signal.SIGKILL)
    running.wait()
    assert len(list(killed.glob("frames/[0-9]*.json"))) < (8 if within == "." else 1)
    assert main([*words, "--out", str(tmp_path / "whole")]) == 0
    assert main([*words, "--out", str(killed)]) == 0
    assert results(killed) == results(tmp_path / "whole")


def test_worker_processes_and_a_lens_with_distortion(tmp_path, scene):
    """Views are fused as those of a pinhole; what is written belongs to the images as recorded."""
    lens = (0.12, -0.05, 0.001, -0.001)
    bent = seen_from_around("bottle", views=12, size=(96, 72), lens=lens)
    root, out = write_scene(tmp_path, bent), tmp_path / "out"
    words = [str(root), "--out", str(out), "--method", f"{tmp_path}/methods.py:Told"]
    assert main([*words, "--multi-view", "--quiet", "--workers", "2", "--format", "exr"]) == 0
    found, alone = (
        [read_exr(out / f / f"{seen.view.name}.exr")["Y"] for seen in bent]
        for f in ("depth", "single/depth")
    )
    fused, single = (np.median(np.abs(errors(d, bent))) for d in (found, alone))
    assert fused < 0.004 < 0.010 < single
    for seen, a, b in zip(bent, found, alone, strict=True):
        assert np.array_equal(a[~seen.glass], b[~seen.glass])
