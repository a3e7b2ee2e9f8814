"""std-record on a software device and on files that librealsense recorded."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from sensors.align import align_depth
from sensors.record.cli import main
from sensors.record.recording_document import read_recording
from std_toolkit.io.images import read_color, read_png
from std_toolkit.scene import Scene
from tests.sensors.record.conftest import FRAMES

pytest.importorskip("pyrealsense2")
from tests.sensors.record.software_camera import (
    COLOR,
    DEPTH,
    SPEC,
    T_COLOR_DEPTH,
    Pictures,
    pictures,
    plain_pictures,
)

if TYPE_CHECKING:
    from tests.sensors.record.software_camera import SoftwareCamera

BAG = Path(__file__).resolve().parents[2] / "data" / "software_device.bag"
SMALL = ["--color", "320x180", "--depth", "320x180"]


def number_of(scene: Scene, index: int) -> int:
    """Which of the camera's pictures a frame shows, by its time."""
    timestamp = scene.frames[index].timestamp
    assert timestamp is not None
    return round((timestamp - 1.0004) * 30)


def check_frame(scene: Scene, index: int, shown: Pictures, *, lossless: bool = False) -> None:
    """A frame shows what the camera was shown, with depth aligned to colour."""
    frame = scene.frames[index]
    color = scene.read_color(frame).astype(int)
    assert abs(color - shown.color).mean() < (1e-9 if lossless else 5)
    depth = scene.read_depth(frame)
    assert depth is not None
    expected = align_depth(shown.depth * 0.001, DEPTH, COLOR, T_COLOR_DEPTH)
    assert ((depth > 0) == (expected > 0)).all()
    # float32 intrinsics of the file against double ones, and whole units.
    assert abs(depth - expected).max() < 0.00051
    assert 0.9 < (depth > 0).mean() < 1


@pytest.mark.slow
def test_a_file_becomes_a_scene(recorded_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene"
    options = ["--infrared", "--raw-depth", "--color-format", "png"]
    assert main([str(out), "--from", str(recorded_file), *options]) == 0
    scene = Scene.open(out)
    assert [number_of(scene, i) for i in range(len(scene.frames))] == list(range(FRAMES))
    assert [f.id for f in scene.frames] == list(range(FRAMES))
    for index in (0, 11, FRAMES - 1):
        shown = pictures(index)
        check_frame(scene, index, shown, lossless=True)
        name = scene.frames[index].name
        for kind, image in (
            ("infrared_left", shown.left),
            ("infrared_right", shown.right),
            ("depth_raw", shown.depth),
        ):
            np.testing.assert_array_equal(read_png(out / f"reference/{kind}/{name}.png"), image)
    camera = scene.info.cameras["color"].camera()
    np.testing.assert_allclose(camera.K, COLOR.K, rtol=1e-6)
    known = read_recording(out)
    assert known.device.name == "Intel RealSense D415" and known.device.serial == "840412060001"
    assert known.baseline_m == pytest.approx(SPEC.baseline_m, rel=1e-4)
    np.testing.assert_allclose(known.depth.camera().K, DEPTH.K, rtol=1e-6)
    np.testing.assert_allclose(known.T_color_depth, T_COLOR_DEPTH.flat(), atol=1e-6)
    assert known.kept == ["infrared_left", "infrared_right", "depth_raw"]
    (session,) = known.sessions
    assert session.ended and session.frames == FRAMES and session.dropped == 0
    assert session.source == recorded_file.name
    assert set(session.lost.values()) == {0}
    assert session.seconds == pytest.approx((FRAMES - 1) / 30, abs=0.001)
    assert known.notes == []
    assert not (out / ".std" / "recording.jsonl").exists()


@pytest.mark.slow
def test_a_ros1_bag(tmp_path: Path) -> None:
    """A .bag that librealsense 2.56 recorded of the same software device."""
    out = tmp_path / "scene"
    assert main([str(out), "--from", str(BAG), "--color-format", "png"]) == 0
    scene = Scene.open(out)
    assert [number_of(scene, i) for i in range(len(scene.frames))] == list(range(10))
    for index in range(10):
        check_frame(scene, index, plain_pictures(index), lossless=True)
    np.testing.assert_allclose(read_recording(out).T_color_depth, T_COLOR_DEPTH.flat(), atol=1e-6)


@pytest.mark.slow
def test_the_same_file_gives_the_same_scene(recorded_file: Path, tmp_path: Path) -> None:
    for name, threads in (("a", "1"), ("b", "4")):
        arguments = [str(tmp_path / name), "--name", "s", "--from", str(recorded_file)]
        assert main([*arguments, "--threads", threads]) == 0
    files = [
        {
            p.relative_to(tmp_path / n): p.read_bytes()
            for p in (tmp_path / n).rglob("*")
            if p.is_file()
        }
        for n in ("a", "b")
    ]
    assert files[0] == files[1] and len(files[0]) > 2 * FRAMES


@pytest.mark.slow
def test_a_slow_writer_loses_nothing_of_a_file(recorded_file: Path, tmp_path: Path) -> None:
    """librealsense waits for its reader; a queue of one frame and one thread make it wait."""
    out = tmp_path / "scene"
    arguments = [str(out), "--from", str(recorded_file), "--queue", "1", "--threads", "1"]
    assert main([*arguments, "--color-format", "png"]) == 0
    assert len(Scene.open(out).frames) == FRAMES


@pytest.mark.slow
def test_part_of_a_file(recorded_file: Path, tmp_path: Path) -> None:
    for name, options, expected in (
        ("frames", ["--frames", "5"], list(range(5))),
        ("every", ["--every", "7"], list(range(0, FRAMES, 7))),
        ("seconds", ["--seconds", "0.35"], list(range(11))),
        ("warm_up", ["--warm-up", "20"], list(range(20, FRAMES))),
    ):
        out = tmp_path / name
        assert main([str(out), "--from", str(recorded_file), *options]) == 0
        scene = Scene.open(out)
        assert [number_of(scene, i) for i in range(len(scene.frames))] == expected, name


def test_aligned_by_librealsense(recorded_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene"
    options = ["--align", "librealsense", "--frames", "3"]
    assert main([str(out), "--from", str(recorded_file), *options]) == 0
    assert read_recording(out).aligned_by == "librealsense"
    scene = Scene.open(out)
    theirs = scene.read_depth(scene.frames[2])
    assert theirs is not None
    ours = align_depth(pictures(2).depth * 0.001, DEPTH, COLOR, T_COLOR_DEPTH)
    assert ((theirs > 0) == (ours > 0)).mean() > 0.98
    both = (theirs > 0) & (ours > 0)
    # librealsense keeps the depth camera's z, cut to whole units.
    assert abs(theirs - ours)[both].max() < 0.003
    assert not np.array_equal(theirs, ours)


def test_more_frames_for_a_scene(recorded_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene"
    assert main([str(out), "--from", str(recorded_file), "--frames", "5"]) == 0
    before = {p: p.read_bytes() for p in (out / "color").iterdir()}
    assert main([str(out), "--from", str(recorded_file), "--resume", "--frames", "4"]) == 0
    scene = Scene.open(out)
    assert [f.id for f in scene.frames] == list(range(9))
    assert [number_of(scene, i) for i in range(9)] == [0, 1, 2, 3, 4, 0, 1, 2, 3]
    assert all(p.read_bytes() == data for p, data in before.items())
    sessions = read_recording(out).sessions
    assert [(s.first_frame, s.frames, s.ended) for s in sessions] == [(0, 5, True), (5, 4, True)]


def test_live(camera: SoftwareCamera, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, preview = tmp_path / "scene", tmp_path / "preview.jpg"
    camera.feed(60, rate=40)
    options = ["--frames", "12", "--warm-up", "6", "--preview", str(preview)]
    assert main([str(out), *SMALL, *options], devices=[camera.device]) == 0
    scene = Scene.open(out)
    assert len(scene.frames) == 12 and scene.info.source == "record:camera"
    assert number_of(scene, 0) >= 6
    for index in (0, 11):
        check_frame(scene, index, pictures(number_of(scene, index)))
    assert read_color(preview).shape[1] == 1280
    printed = capsys.readouterr()
    assert "12 frames in" in printed.out and f"std-curate poses {out}" in printed.out
    assert "views 1" in printed.err


@pytest.mark.slow
def test_images_that_never_came_are_counted(camera: SoftwareCamera, tmp_path: Path) -> None:
    def step(number: int) -> None:
        if number == 20:
            return  # lost in all streams
        camera.send(number, only=["color"] if number == 25 else None)

    camera.feed(60, rate=40, step=step)
    out = tmp_path / "scene"
    arguments = [str(out), *SMALL, "--warm-up", "0", "--frames", "35"]
    assert main(arguments, devices=[camera.device]) == 0
    (session,) = read_recording(out).sessions
    scene = Scene.open(out)
    recorded = [number_of(scene, i) for i in range(len(scene.frames))]
    assert not {20, 25} & set(recorded)
    assert session.lost["color"] == 1 and session.lost["depth"] == 2
    assert session.single["color"] == 1


@pytest.mark.slow
def test_frames_beyond_the_queue_are_dropped_and_counted(
    camera: SoftwareCamera, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A burst is more than one thread with a queue of one can take; nothing is lost silently."""
    from tests.sensors.record.software_camera import FPS

    total = 60

    for number in range(total):
        pictures(number)  # made beforehand: sending must be faster than writing
    camera.feed(total, rate=20 * FPS)
    out = tmp_path / "scene"
    end = threading.Timer(2.5, lambda: os.kill(os.getpid(), signal.SIGINT))
    end.start()
    options = ["--queue", "1", "--threads", "1", "--color-format", "png", "--warm-up", "0"]
    assert main([str(out), *SMALL, *options], devices=[camera.device]) == 0
    end.join()
    (session,) = read_recording(out).sessions
    scene = Scene.open(out)
    first = number_of(scene, 0)
    assert session.frames == len(scene.frames)
    assert session.dropped > 0
    lost = max(session.lost.values())
    assert session.frames + session.dropped + lost == pytest.approx(total - first, abs=2)
    assert f"{session.dropped} because writing was behind" in capsys.readouterr().out


@pytest.mark.slow
def test_streams_that_nobody_opened_cost_no_frame(
    camera: SoftwareCamera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A software device sends infrared too; where the line is full, that counts as no loss."""
    total = 60
    for number in range(total):
        pictures(number)
    monkeypatch.setattr("sensors.record.device_source._BACKLOG", 2)
    camera.feed(total, rate=600)
    out = tmp_path / "scene"
    end = threading.Timer(2.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    end.start()
    options = ["--queue", "60", "--warm-up", "0"]
    assert main([str(out), *SMALL, *options], devices=[camera.device]) == 0
    end.join()
    (session,) = read_recording(out).sessions
    assert session.dropped > 0
    assert session.frames + session.dropped <= total


@pytest.mark.slow
def test_ctrl_c_ends_a_recording_cleanly(camera: SoftwareCamera, tmp_path: Path) -> None:
    camera.feed(400, rate=40)
    out = tmp_path / "scene"

    def interrupt() -> None:
        while not (out / "frames.json").exists() or len(Scene.open(out).frames) < 10:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    before = signal.getsignal(signal.SIGINT)
    assert main([str(out), *SMALL], devices=[camera.device]) == 0
    thread.join()
    assert signal.getsignal(signal.SIGINT) is before
    (session,) = read_recording(out).sessions
    assert session.ended and session.frames == len(Scene.open(out).frames) >= 10


@pytest.mark.slow
def test_a_camera_that_falls_silent(
    camera: SoftwareCamera,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sensors.record.device_source.SILENCE_S", 1.0)
    camera.feed(15, rate=40)
    out = tmp_path / "scene"
    assert main([str(out), *SMALL, "--warm-up", "0"], devices=[camera.device]) == 1
    assert "sends nothing any more" in capsys.readouterr().err
    assert len(Scene.open(out).frames) >= 13
    assert read_recording(out).sessions[0].ended


def test_nothing_is_recorded_before_enter(
    camera: SoftwareCamera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, write = os.pipe()
    out, preview = tmp_path / "scene", tmp_path / "preview.jpg"

    def press() -> None:
        while not preview.exists():  # the picture is shown before
            time.sleep(0.02)
        time.sleep(0.3)
        assert not out.exists()
        os.write(write, b"\n")

    thread = threading.Thread(target=press)
    thread.start()
    camera.feed(400, rate=40)
    options = ["--wait", "--warm-up", "0", "--frames", "3", "--preview", str(preview)]
    with os.fdopen(read) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert main([str(out), *SMALL, *options], devices=[camera.device]) == 0
    thread.join()
    os.close(write)
    assert number_of(Scene.open(out), 0) > 5


@pytest.mark.slow
def test_preview_page(camera: SoftwareCamera, tmp_path: Path) -> None:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    found: dict[str, bytes] = {}

    def look() -> None:
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline and "picture" not in found:
            time.sleep(0.05)
            for key, path in (("page", ""), ("picture", "preview.jpg")):
                try:
                    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}") as answer:
                        found[key] = answer.read()
                except OSError:
                    continue

    thread = threading.Thread(target=look)
    thread.start()
    camera.feed(80, rate=30)
    arguments = [str(tmp_path / "s"), *SMALL, "--frames", "40", "--web", str(port)]
    assert main(arguments, devices=[camera.device]) == 0
    thread.join()
    assert b"preview.jpg" in found["page"]
    (tmp_path / "seen.jpg").write_bytes(found["picture"])
    assert read_color(tmp_path / "seen.jpg").shape[1] == 1280


@pytest.mark.slow
def test_a_picture_in_the_making_is_never_seen(camera: SoftwareCamera, tmp_path: Path) -> None:
    preview, seen, stop = tmp_path / "p.jpg", [0], threading.Event()

    def look() -> None:
        while not stop.is_set():
            if preview.exists():
                read_color(preview)  # raises for half a picture
                seen[0] += 1

    thread = threading.Thread(target=look)
    thread.start()
    camera.feed(60, rate=40)
    arguments = [str(tmp_path / "s"), *SMALL, "--frames", "25", "--preview", str(preview)]
    assert main(arguments, devices=[camera.device]) == 0
    stop.set()
    thread.join()
    assert seen[0] > 3


def test_recording_json_is_plain(recorded_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "scene"
    assert main([str(out), "--from", str(recorded_file), "--frames", "1"]) == 0
    document = json.loads((out / "recording.json").read_text())
    assert document["format"] == "std-recording" and document["depth_unit_m"] == 0.001
