"""The camera's own calibration beside the specification of its model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sensors.record.calibration import compare, sensor_of
from sensors.record.cli import main
from sensors.record.recording_document import Calibration, DeviceInfo, read_recording
from sensors.specs import load_sensor
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.scene.model import CameraModel

SPEC = load_sensor("d435")
D435 = DeviceInfo(name="Intel RealSense D435I")


def calibration() -> Calibration:
    return Calibration(
        color=CameraModel.of(SPEC.color_camera(1280, 720)),
        depth=CameraModel.of(SPEC.infrared_camera(848, 480)),
        T_color_depth=SPEC.pose_of_color.inverse(),
        depth_unit_m=0.001,
        baseline_m=SPEC.baseline_m,
    )


def test_names_of_devices() -> None:
    assert sensor_of(D435) == "d435"
    assert sensor_of(DeviceInfo(name="Intel RealSense D455F")) == "d455"
    assert sensor_of(DeviceInfo(name="Intel RealSense D405")) is None
    assert sensor_of(DeviceInfo()) is None


def test_a_camera_as_specified() -> None:
    assert compare(D435, calibration(), None) == []
    assert compare(D435, calibration(), "d435") == []


def test_units_of_one_model_differ_a_little() -> None:
    own = calibration()
    color = own.color.camera()
    moved = CameraModel.of(replace(color, fx=1.015 * color.fx, cx=color.cx + 12))
    assert compare(D435, replace(own, color=moved), None) == []


def test_what_does_not_fit_is_told() -> None:
    own = calibration()
    color = own.color.camera()
    wrong = CameraModel.of(replace(color, fx=1.5 * color.fx, fy=1.5 * color.fy))
    notes = compare(D435, replace(own, color=wrong), None)
    assert len(notes) == 2 and "colour fx" in notes[0] and "specified" in notes[0]
    (note,) = compare(D435, replace(own, baseline_m=0.095), None)
    assert "baseline 95.0 mm" in note
    far = SE3(np.eye(3), np.array([0.05, 0, 0])) @ own.T_color_depth
    (note,) = compare(D435, replace(own, T_color_depth=far), None)
    assert "50.0 mm" in note


def test_another_model_than_expected() -> None:
    """A D435 where the user expects a D415: its lenses are wider."""
    notes = compare(D435, calibration(), "d415")
    assert notes[0].startswith("the camera is Intel RealSense D435I, not Intel RealSense D415")
    assert any("depth fx" in note for note in notes)


def test_a_camera_without_specification() -> None:
    (note,) = compare(DeviceInfo(name="Intel RealSense D405"), calibration(), None)
    assert "no specification of Intel RealSense D405" in note
    with pytest.raises(ToolkitError, match="no such sensor"):
        compare(D435, calibration(), "d999")


def test_a_warning_and_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The software device has a D415's calibration; here it says that it is a D455."""
    pytest.importorskip("pyrealsense2")
    from tests.sensors.record.software_camera import SoftwareCamera

    camera = SoftwareCamera(name="Intel RealSense D455")
    camera.feed(30, rate=40)
    out = tmp_path / "s"
    arguments = ["--color", "320x180", "--depth", "320x180", "--frames", "2", "--warm-up", "0"]
    assert main([str(out), *arguments], devices=[camera.device]) == 0
    camera.close()
    assert "WARNING: Intel RealSense D455: colour fx" in capsys.readouterr().err
    assert any("baseline" in note for note in read_recording(out).notes)
