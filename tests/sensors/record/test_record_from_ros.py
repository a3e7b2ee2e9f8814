"""std-record makes scenes of recordings of ROS, and tells them from those of librealsense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from sensors.record.cli import main
from std_toolkit.importers.foreign_files import is_ros_recording
from std_toolkit.scene.scene import Scene
from tests.std_toolkit.importers.ros_on_disk import depth_mm, write_recording


def test_a_recording_of_ros_becomes_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "rec")
    assert main([str(tmp_path / "scene"), "--from", str(tmp_path / "rec")]) == 0
    assert "4 frames" in capsys.readouterr().out
    scene = Scene.open(tmp_path / "scene")
    depth = scene.read_depth(scene.frames[2])
    assert np.array_equal(depth, depth_mm(2) * np.float32(0.001))


def test_options_of_a_camera_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recording(tmp_path / "rec")
    words = [str(tmp_path / "scene"), "--from", str(tmp_path / "rec"), "--exposure", "lock"]
    assert main(words) == 1
    assert "std-curate import" in capsys.readouterr().err
    assert not (tmp_path / "scene").exists()


@pytest.mark.slow
def test_a_file_of_librealsense_is_none(recorded_file: Path) -> None:
    assert not is_ros_recording(recorded_file)
