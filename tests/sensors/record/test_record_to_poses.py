"""A recorded scene goes through curation as it is: `std-curate poses` finds the camera's way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sensors.output.recording_writer import read_truth
from sensors.record.cli import main
from sensors.synthetic.recording import RecordingOptions, make_recording
from std_toolkit.cli.main import main as curate
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.images import read_color, read_png
from std_toolkit.scene import Scene

pytest.importorskip("pyrealsense2")
from tests.sensors.record.software_camera import (
    Pictures,
    SoftwareCamera,
    record_file,
)

FRAMES = 12


@pytest.mark.slow
def test_recorded_then_curated(tmp_path: Path) -> None:
    options = RecordingOptions(frames=FRAMES, arc_degrees=18, samples=1)
    made = tmp_path / "made"
    make_recording(made, options)
    colors, depths = sorted((made / "color").iterdir()), sorted((made / "depth").iterdir())
    assert len(colors) == len(depths) == FRAMES

    def shown(number: int) -> Pictures:
        depth = read_png(depths[number]).astype(np.uint16)
        grey = np.zeros(depth.shape, dtype=np.uint8)
        return Pictures(read_color(colors[number]), depth, grey, grey)

    camera = SoftwareCamera(
        streams=("color", "depth"),
        color=options.camera(),
        depth=options.camera(),
        T_color_depth=SE3.identity(),
    )
    try:
        file = record_file(tmp_path / "file.db3", FRAMES, camera, shown)
    except RuntimeError:
        file = record_file(tmp_path / "file.bag", FRAMES, camera, shown)
    out = tmp_path / "scene"
    assert main([str(out), "--from", str(file)]) == 0
    assert curate(["poses", str(out)]) == 0
    scene, truth = Scene.open(out), read_truth(made)
    poses = [scene.T_world_cam(f.id) for f in scene.frames]
    assert len(poses) == FRAMES and None not in poses
    first, last = poses[0], poses[-1]
    assert first is not None and last is not None
    found = np.linalg.norm((first.inverse() @ last).t)
    true = np.linalg.norm((truth.camera_pose(0).inverse() @ truth.camera_pose(FRAMES - 1)).t)
    # The simulated sensor's depth, from which the metres come, is 1.5 % too long.
    assert found == pytest.approx(true * options.depth_bias, rel=0.015)
