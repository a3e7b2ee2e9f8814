"""Bad input: one line each, and nothing half-written."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sensors.record.cli import main
from sensors.record.recording_document import read_recording
from std_toolkit.scene import Scene
from tests.sensors.record.conftest import FRAMES

pytest.importorskip("pyrealsense2")
from tests.sensors.record.software_camera import (
    COLOR,
    SoftwareCamera,
    record_file,
)

SMALL = ["--color", "320x180", "--depth", "320x180"]


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> object:
    """Run it; it fails with one line that holds all of these words, and leaves nothing."""

    def run(arguments: list[str], *words: str, devices: list[object] | None = None) -> None:
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        assert main(arguments, devices=devices) == 1
        printed = capsys.readouterr()
        lines = [x for x in printed.err.splitlines() if x.startswith("error: ")]
        assert len(lines) == 1 and printed.out == ""
        assert "Traceback" not in printed.err and "unexpected" not in lines[0]
        for word in words:
            assert word in lines[0], lines[0]
        assert sorted(tmp_path.rglob("*")) == before

    return run


def test_no_camera(refused, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    refused([str(tmp_path / "s")], "no RealSense camera", devices=[])


def test_librealsense_is_missing(refused, tmp_path: Path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    refused([str(tmp_path / "s")], "librealsense is not there", "std-toolkit[realsense]")


def test_an_unknown_serial_number(refused, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    cameras = [SoftwareCamera(serial="11").device, SoftwareCamera(serial="12").device]
    arguments = [str(tmp_path / "s"), *SMALL]
    refused([*arguments, "--serial", "13"], "--serial", "'13'", "11 (", "12 (", devices=cameras)
    refused(arguments, "several cameras", "11 (", "12 (", devices=cameras)


def test_a_size_that_the_camera_does_not_offer(refused, camera, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    arguments = [str(tmp_path / "s"), "--depth", "320x180", "--color", "640x480"]
    refused(arguments, "color", "640x480 at 30 fps", "320x180 (30 fps)", devices=[camera.device])
    refused([str(tmp_path / "s"), *SMALL, "--fps", "90"], "90 fps", devices=[camera.device])


@pytest.mark.parametrize(
    ("streams", "missing"), [(("depth",), "color"), (("color",), "depth"), (("infrared",), "color")]
)
def test_a_file_without_colour_or_depth(refused, tmp_path, streams, missing) -> None:  # type: ignore[no-untyped-def]
    file = recorded(tmp_path / "file", SoftwareCamera(streams=streams))
    refused([str(tmp_path / "s"), "--from", str(file)], str(file), f"no {missing} images")


def test_a_file_without_infrared_when_it_is_wanted(refused, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = recorded(tmp_path / "file", SoftwareCamera(streams=("color", "depth")))
    refused([str(tmp_path / "s"), "--from", str(file), "--infrared"], "no infrared images")


def test_a_file_without_the_place_of_the_colour_camera(refused, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = recorded(tmp_path / "file", SoftwareCamera(extrinsics=False))
    refused([str(tmp_path / "s"), "--from", str(file)], "extrinsics", "cannot be aligned")


def recorded(stem: Path, camera: SoftwareCamera) -> Path:
    try:
        return record_file(stem.with_suffix(".db3"), 4, camera)
    except RuntimeError:
        return record_file(stem.with_suffix(".bag"), 4, camera)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.4, 0.97])
@pytest.mark.parametrize("kind", ["bag", "installed"])
def test_a_file_that_was_cut_short(refused, tmp_path, recorded_file, kind, share) -> None:  # type: ignore[no-untyped-def]
    whole = recorded_file
    if kind == "bag":
        whole = Path(__file__).resolve().parents[2] / "data" / "software_device.bag"
    cut = tmp_path / f"cut{whole.suffix}"
    cut.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    refused([str(tmp_path / "s"), "--from", str(cut)], str(cut))


def test_files_of_another_kind(refused, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    refused([str(tmp_path / "s"), "--from", str(tmp_path / "no.bag")], "file not found")
    other = tmp_path / "video.mp4"
    other.write_bytes(b"ftyp")
    refused([str(tmp_path / "s"), "--from", str(other)], "not a recording of librealsense", ".bag")
    other = tmp_path / "other.bag"
    other.write_bytes(b"#ROSBAG V1.2\n" * 100)
    refused([str(tmp_path / "s"), "--from", str(other)], "not a readable recording")


@pytest.mark.slow
def test_something_is_there_already(refused, tmp_path: Path, recorded_file: Path) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "s"
    assert main([str(out), "--from", str(recorded_file), "--frames", "2"]) == 0
    refused([str(out), "--from", str(recorded_file)], "a scene here already", "--resume")
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.txt").write_text("mine")
    refused([str(full), "--from", str(recorded_file)], "not empty")
    refused([str(full / "thesis.txt"), "--from", str(recorded_file)], "a file already exists here")


@pytest.mark.slow
def test_going_on_with_what_is_not_there_or_another_camera(
    refused, tmp_path, recorded_file
) -> None:  # type: ignore[no-untyped-def]
    out = tmp_path / "s"
    resume = ["--from", str(recorded_file), "--resume"]
    refused([str(out), *resume], "no scene to resume")
    refused([str(out), "--recover"], "no scene here")
    assert main([str(out), "--from", str(recorded_file), "--frames", "2"]) == 0
    other = COLOR.resized(*COLOR.size)
    other = type(other)(*other.size, other.fx + 3, other.fy + 3, other.cx, other.cy)
    file = recorded(tmp_path / "other", SoftwareCamera(color=other))
    refused([str(out), "--from", str(file), "--resume"], "another camera")
    file = recorded(tmp_path / "unit", SoftwareCamera(depth_unit=0.0001))
    refused([str(out), "--from", str(file), "--resume"], "another unit")
    refused([str(out), *resume, "--infrared"], "same options")
    assert len(Scene.open(out).frames) == 2


@pytest.mark.slow
def test_options_that_a_file_cannot_follow(refused, tmp_path: Path, recorded_file: Path) -> None:  # type: ignore[no-untyped-def]
    arguments = [str(tmp_path / "s"), "--from", str(recorded_file)]
    for option in (["--exposure", "5"], ["--laser", "off"], ["--preset", "hand"]):
        refused([*arguments, *option], option[0], "as it was recorded")
    refused([*arguments, "--sensor", "d999"], "no such sensor")


def test_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (
        [],
        [str(tmp_path / "s"), "--color", "large"],
        [str(tmp_path / "s"), "--frames", "0"],
        [str(tmp_path / "s"), "--exposure", "long"],
        [str(tmp_path / "s"), "--quality", "7"],
        [str(tmp_path / "s"), "--seconds", "inf"],
    ):
        assert main(arguments) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_nearly_full_disk(refused, tmp_path: Path, recorded_file: Path) -> None:  # type: ignore[no-untyped-def]
    arguments = [str(tmp_path / "s"), "--from", str(recorded_file), "--keep-free", "1e9"]
    refused(arguments, "disk is nearly full", "--keep-free")


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """A limit on the size of files, as the kernel enforces it, in place of a full disk."""
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


@pytest.mark.slow
def test_a_disk_that_is_full_at_the_first_frame(refused, tmp_path, recorded_file) -> None:  # type: ignore[no-untyped-def]
    # What is compiled at the first recording is kept in files of its own: before the disk is full.
    assert main([str(tmp_path / "before"), "--from", str(recorded_file), "--frames", "1"]) == 0
    with largest_file(1000):
        refused([str(tmp_path / "s"), "--from", str(recorded_file)], "cannot write the file")


@pytest.mark.slow
def test_a_disk_that_becomes_full(
    tmp_path: Path, recorded_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table outgrows what may be written: what was finished stays a scene."""
    out = tmp_path / "s"
    arguments = [str(out), "--from", str(recorded_file), "--frames", "3"]
    assert main(arguments) == 0
    largest = max(p.stat().st_size for p in out.rglob("*") if p.is_file())
    row = (out / "frames.json").stat().st_size / 3
    limit = int(max(largest + 2000, 10 * row))
    # As many sessions as make frames.json outgrow the images.
    sessions = int(limit / row / FRAMES) + 1
    with largest_file(limit):
        statuses = [
            main([str(out), "--from", str(recorded_file), "--resume"]) for _ in range(sessions)
        ]
    assert statuses[-1] == 1
    assert "cannot write the file" in capsys.readouterr().err
    scene = Scene.open(out)
    assert len(scene.frames) >= 3 + FRAMES * (sessions - 2)
    for frame in scene.frames:
        scene.read_color(frame)
    # With room again, nothing that was finished is missing.
    assert main([str(out), "--recover"]) == 0
    finished = len(list((out / "depth").glob("*.png")))
    assert finished - 2 <= len(Scene.open(out).frames) <= finished
    assert read_recording(out).sessions[0].ended
