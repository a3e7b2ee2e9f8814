"""Settings of the camera: what is set, in which unit, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from sensors.record.camera_settings import apply_settings, lock
from sensors.record.cli import main
from sensors.record.options import CameraSettings, StreamRequest
from sensors.record.realsense import Stream, requested_streams
from sensors.record.recording_document import read_recording
from std_toolkit.errors import ToolkitError

rs = pytest.importorskip("pyrealsense2")
from tests.sensors.record.software_camera import SoftwareCamera  # noqa: E402

# Ranges as a D415 tells them: colour counts exposure in tenths of milliseconds.
COLOR_OPTIONS = {
    "enable_auto_exposure": (0.0, 1.0, 1.0, 1.0),
    "exposure": (1.0, 10000.0, 1.0, 166.0),
    "gain": (0.0, 128.0, 1.0, 64.0),
    "enable_auto_white_balance": (0.0, 1.0, 1.0, 1.0),
    "white_balance": (2800.0, 6500.0, 10.0, 4600.0),
}
DEPTH_OPTIONS = {
    "enable_auto_exposure": (0.0, 1.0, 1.0, 1.0),
    "exposure": (1.0, 165000.0, 1.0, 8500.0),
    "emitter_enabled": (0.0, 2.0, 1.0, 1.0),
    "laser_power": (0.0, 360.0, 30.0, 150.0),
    "visual_preset": (0.0, 6.0, 1.0, 0.0),
}


@pytest.fixture
def device() -> SoftwareCamera:
    return SoftwareCamera(depth_options=DEPTH_OPTIONS, color_options=COLOR_OPTIONS)


@pytest.fixture
def streams(device: SoftwareCamera) -> dict[str, Stream]:
    return requested_streams(device.device, StreamRequest((320, 180), (320, 180)))


def value(stream: Stream, option: str) -> float:
    return float(stream.sensor.get_option(getattr(rs.option, option)))


def test_exposure_is_told_in_milliseconds(streams: dict[str, Stream]) -> None:
    done = apply_settings(streams, CameraSettings(exposure=8.0, infrared_exposure=6.5))
    assert value(streams["color"], "exposure") == 80
    assert value(streams["depth"], "exposure") == 6500
    assert value(streams["color"], "enable_auto_exposure") == 0
    assert value(streams["depth"], "enable_auto_exposure") == 0
    assert done == {"exposure": "8 ms", "infrared_exposure": "6.5 ms"}
    apply_settings(streams, CameraSettings(exposure="auto"))
    assert value(streams["color"], "enable_auto_exposure") == 1


def test_laser(streams: dict[str, Stream]) -> None:
    apply_settings(streams, CameraSettings(laser="max"))
    assert (value(streams["depth"], "laser_power"), value(streams["depth"], "emitter_enabled")) == (
        360,
        1,
    )
    assert apply_settings(streams, CameraSettings(laser=90.0)) == {"laser": "90 mW"}
    assert value(streams["depth"], "laser_power") == 90
    apply_settings(streams, CameraSettings(laser="off"))
    assert value(streams["depth"], "emitter_enabled") == 0


def test_white_balance_and_gain(streams: dict[str, Stream]) -> None:
    done = apply_settings(streams, CameraSettings(white_balance=4000.0, gain=20.0))
    color = streams["color"]
    assert value(color, "white_balance") == 4000 and value(color, "gain") == 20
    assert value(color, "enable_auto_white_balance") == 0
    assert done == {"white_balance": "4000.0", "gain": "20"}


def test_locked_when_recording_starts(streams: dict[str, Stream]) -> None:
    """The exposure of the last frame is taken: the option does not tell it while automatic."""
    settings = CameraSettings(exposure="lock", white_balance="lock")
    apply_settings(streams, settings)
    color = streams["color"]
    assert value(color, "enable_auto_exposure") == 1
    assert lock(streams, settings, 0.0123) == {"exposure": "lock: 12.3 ms", "white_balance": "lock"}
    assert value(color, "exposure") == 123
    assert value(color, "enable_auto_exposure") == 0
    assert value(color, "enable_auto_white_balance") == 0
    assert lock(streams, settings, None)["exposure"] == "lock"
    assert lock(streams, CameraSettings(exposure="auto"), 0.01) == {}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (CameraSettings(exposure=2000.0), ("--exposure", "between 0.1 and 1000 ms")),
        (CameraSettings(laser=500.0), ("--laser", "between 0 and 360 mW")),
        (CameraSettings(gain=1000.0), ("--gain", "between 0 and 128")),
        (CameraSettings(preset="crystal clear"), ("--preset", "no such preset")),
    ],
)
def test_values_that_the_camera_does_not_take(
    streams: dict[str, Stream], settings: CameraSettings, words: tuple[str, ...]
) -> None:
    with pytest.raises(ToolkitError) as error:
        apply_settings(streams, settings)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_an_option_that_the_camera_lacks() -> None:
    plain = requested_streams(SoftwareCamera().device, StreamRequest((320, 180), (320, 180)))
    for settings in (CameraSettings(laser="off"), CameraSettings(exposure=5.0)):
        with pytest.raises(ToolkitError, match="has no option"):
            apply_settings(plain, settings)


def test_settings_are_in_recording_json(device: SoftwareCamera, tmp_path: Path) -> None:
    device.feed(60, rate=40)
    out = tmp_path / "s"
    arguments = ["--color", "320x180", "--depth", "320x180", "--frames", "3", "--warm-up", "5"]
    options = ["--laser", "150", "--exposure", "lock"]
    assert main([str(out), *arguments, *options], devices=[device.device]) == 0
    device.close()
    (session,) = read_recording(out).sessions
    assert session.settings == {"exposure": "lock", "laser": "150 mW"}
