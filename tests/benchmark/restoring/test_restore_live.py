"""std-restore live: cameras in a file, and the software device of librealsense; videos."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from restore_cases import SIZE, K, sensor_depth, write_folder

from benchmark.cli.restore import main
from std_toolkit.io.images import read_depth

CAMERA = '''
import time
import numpy as np
from benchmark.restoring.onnx_export import made_up_views
from std_toolkit.cameras import LiveFrame
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

class Fake:
    """Twelve frames; one of them has no depth. It ends, or fails, as an unplugged camera does."""
    name, count, fails = "fake", 12, False

    def __init__(self, request):
        assert request.size == (640, 480)
        view = made_up_views((96, 72))[0]
        self.color, self.depth = view.color, view.depth
        self.camera = Camera(96, 72, 96, 96, 47.5, 35.5)

    def frames(self):
        for i in range(self.count):
            time.sleep(0.02)
            depth = np.rint(1000 * np.roll(self.depth, i, axis=1)) / 1000
            yield LiveFrame(self.color, (depth * (i != 3)).astype(np.float32), i / 30)
        if self.fails:
            raise ToolkitError("the camera sends nothing any more (5 s)")

    def close(self):
        pass

class Unplugged(Fake):
    fails = True

class Blind(Fake):
    count = 0
'''


@pytest.fixture
def camera_file(tmp_path: Path) -> str:
    path = tmp_path / "cameras.py"
    path.write_text(CAMERA)
    return str(path)


def live(*words: str) -> int:
    return main(["--live", "--method", "nearest", *words])


def test_frames_of_a_camera_are_restored_and_kept(
    camera_file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, preview = tmp_path / "live", tmp_path / "preview.jpg"
    words = ["--camera", f"{camera_file}:Fake", "--out", str(out), "--preview", str(preview)]
    assert live(*words) == 0
    assert "fake: " in capsys.readouterr().out
    names = sorted(p.stem for p in (out / "depth").iterdir())
    assert 3 <= len(names) <= 11
    for name in names:
        raw = read_depth(out / "recording/depth" / f"{name}.png", scale=1e-3)
        restored = read_depth(out / "depth" / f"{name}.png", scale=1e-3)
        assert (restored > 0).all()
        assert np.array_equal(restored[raw > 0], raw[raw > 0])
    picture = cv2.imread(str(preview))
    assert picture.shape[0] == SIZE[1] and picture.shape[1] >= 3 * SIZE[0]
    # What was kept is a recording that std-restore reads, with its intrinsics.
    again = tmp_path / "again"
    words = [str(out / "recording"), "--method", "nearest", "--engine", "serial"]
    assert main([*words, "--out", str(again)]) == 0
    assert (again / "depth" / f"{names[0]}.png").read_bytes() == (
        out / "depth" / f"{names[0]}.png"
    ).read_bytes()


@pytest.mark.parametrize(
    ("camera", "words"),
    [("Unplugged", "sends nothing any more"), ("Blind", "sent no frame"), ("None_", "None_")],
)
def test_a_camera_that_fails_is_reported(
    camera: str,
    words: str,
    camera_file: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = ["--camera", f"{camera_file}:{camera}", "--preview", str(tmp_path / "p.jpg")]
    assert live(*given) == 1
    assert words in capsys.readouterr().err


def test_a_live_run_needs_a_place_to_show_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert live() == 2
    assert "--web" in capsys.readouterr().err


def test_ctrl_c_ends_a_run(camera_file: str, tmp_path: Path) -> None:
    path = Path(camera_file)
    path.write_text(path.read_text().replace("12, False", "100000, False"))
    program = "import sys; from benchmark.cli.restore import main; sys.exit(main(sys.argv[1:]))"
    words = ["--live", "--method", "nearest", "--camera", f"{camera_file}:Fake", "--web", "0"]
    done = subprocess.Popen(
        [sys.executable, "-c", program, *words, "--out", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )
    assert done.stderr is not None
    while "restored" not in (line := done.stderr.readline()):
        assert line, "ended early"
    done.send_signal(2)
    out, _ = done.communicate(timeout=60)
    assert done.returncode == 0
    assert "frames" in out and (tmp_path / "out/restore.json").is_file()


@pytest.mark.slow
def test_a_realsense_is_a_live_camera() -> None:
    """The software device of librealsense; depth is aligned as std-record aligns it."""
    pytest.importorskip("pyrealsense2")
    from sensors.record.live_camera import RealSenseCamera
    from std_toolkit.cameras import CameraRequest
    from tests.sensors.record.software_camera import COLOR, SoftwareCamera

    made = SoftwareCamera()
    made.feed(60, rate=60)
    camera = RealSenseCamera(CameraRequest(size=(320, 180)), devices=[made.device])
    assert "D415" in camera.name
    assert camera.camera.size == COLOR.size and camera.camera.fx == pytest.approx(COLOR.fx)
    frames = []
    for frame in camera.frames():
        frames.append(frame)
        if len(frames) == 5:
            break
    camera.close()
    made.close()
    depth = frames[2].depth
    assert depth.shape == (180, 320) and depth.dtype == np.float32
    assert 0.79 < float(np.median(depth[depth > 0])) < 0.9
    assert [f.timestamp for f in frames] == sorted(f.timestamp for f in frames)


def test_a_video_shows_all_frames(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "rec", 4)
    words = [str(folder), "--intrinsics", K, "--method", "nearest", "--engine", "serial"]
    assert main([*words, "--out", str(tmp_path / "out"), "--video", "5"]) == 0
    video = cv2.VideoCapture(str(tmp_path / "out/video.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(5)
    pictures = []
    while (read := video.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == 4
    # The third panel has no holes, the second has some: holes are almost black.
    step = SIZE[0] + 4
    raw = pictures[1][:, step : step + SIZE[0]].astype(int).sum(axis=2)
    restored = pictures[1][:, 2 * step : 2 * step + SIZE[0]].astype(int).sum(axis=2)
    holes = sensor_depth(1) == 0
    assert raw[holes].mean() < 140 < restored[holes].mean()
