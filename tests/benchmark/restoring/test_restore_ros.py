"""std-restore reads recordings of ROS."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")

from benchmark.cli.restore import main
from tests.std_toolkit.importers.ros_on_disk import SIZE, depth_mm, write_recording


def test_a_recording_of_ros_is_restored_and_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_recording(tmp_path / "rec", frames=2)
    recording = next(folder.glob("*.mcap"))
    out = tmp_path / "restored"
    words = [str(recording), "--method", "nearest", "--out", str(out), "--engine", "serial"]
    for _ in range(2):
        assert main(words) == 0
        assert "2 frames" in capsys.readouterr().out
    files = sorted((out / "depth").iterdir())
    assert len(files) == 2
    depth = cv2.imread(str(files[1]), cv2.IMREAD_UNCHANGED)
    assert depth.shape == SIZE[::-1]
    measured = depth_mm(1)
    assert np.array_equal(depth[measured > 0], measured[measured > 0])
    assert (depth > 0).all()


def test_topics_of_a_folder_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--color and --depth name topics of recordings of ROS alone."""
    (tmp_path / "color").mkdir()
    words = [str(tmp_path), "--color", "/a", "--depth", "/b", "--out", str(tmp_path / "o")]
    assert main([*words, "--method", "nearest"]) == 1
    assert "either SOURCES or --color" in capsys.readouterr().err


def test_another_recording_of_the_same_name_is_read_again(tmp_path: Path) -> None:
    out, bag = tmp_path / "restored", tmp_path / "bag.mcap"
    words = [str(bag), "--method", "nearest", "--out", str(out), "--engine", "serial"]

    def run(frames: int, *more: str) -> dict[str, bytes]:
        folder = write_recording(tmp_path / f"rec{frames}", frames=frames)
        shutil.copy(next(folder.glob("*.mcap")), bag)
        shutil.rmtree(folder)
        assert main([*words, *more]) == 0
        return {p.name: p.read_bytes() for p in (out / "depth").iterdir()}

    first, second = run(2), run(3)
    assert len(first) == 2 and len(second) == 3
    scene = out / "recordings" / "bag"
    kept = (scene / "scene.json").stat().st_mtime_ns
    assert run(3) == second
    assert (scene / "scene.json").stat().st_mtime_ns == kept  # the same is not read again
    depth = next((scene / "depth").iterdir())
    whole = depth.read_bytes()
    depth.write_bytes(whole[:50])
    assert run(3) == second
    assert depth.read_bytes() == whole
    run(3, "--depth-correction", "0.9")
    assert '"depth_correction": 0.9' in (scene / "scene.json").read_text()
