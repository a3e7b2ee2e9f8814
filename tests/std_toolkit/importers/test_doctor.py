"""`std-curate doctor`: what an import finds, reads, guesses and ignores."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.importers.doctor import Report, examine
from std_toolkit.importers.importer import detect_format
from std_toolkit.importers.options import ImportRequest
from std_toolkit.io.images import write_color, write_png
from std_toolkit.options import KnownCameras

W, H = 64, 48


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    depth = np.linspace(500, 800, W * H).reshape(H, W).astype(np.uint16)
    depth[:4] = 65000
    for i in range(3):
        write_color(tmp_path / f"rec/color/{i}.png", np.full((H, W, 3), 90, np.uint8))
        write_png(tmp_path / f"rec/depth/{i}.png", depth)
    lens = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "k1": -0.2, "k2": 0.1}
    (tmp_path / "rec/intrinsics.json").write_text(json.dumps(lens))
    return tmp_path / "rec"


def rows(report: Report, kind: str) -> str:
    return "\n".join(text for k, text in report.rows if k == kind)


def test_a_recording(recording: Path) -> None:
    before = sorted(recording.parent.rglob("*"))
    report = examine(ImportRequest(source=recording, name="d"))
    assert not report.is_refused
    assert "camera color: 64x48, 3 frames" in rows(report, "found")
    assert "opencv lens -0.2 0.1 0 0 0 (from k1, k2)" in rows(report, "read")
    assert "median 0.66" in rows(report, "guessed") and "guessed" in rows(report, "guessed")
    assert "65000 means no measurement (8.3%" in rows(report, "ignored")
    assert sorted(recording.parent.rglob("*")) == before


def test_what_would_stop_the_import(recording: Path) -> None:
    for path in (recording / "depth").iterdir():
        write_png(path, np.full((H, W), 5600, np.uint16))
    report = examine(ImportRequest(source=recording, name="d"))
    assert report.is_refused and "--depth-scale 0.0001" in rows(report, "guessed")
    stated = examine(ImportRequest(source=recording, name="d", depth_scale=0.000125))
    assert not stated.is_refused and "median 0.7 m" in rows(stated, "read")
    (recording / "depth/1.png").unlink()
    report = examine(ImportRequest(source=recording, name="d"))
    assert "1 without depth" in rows(report, "refused")


def test_depth_that_no_reader_takes(recording: Path) -> None:
    for path in (recording / "depth").iterdir():
        write_png(path, np.full((H, W), 90, np.uint8))
    report = examine(ImportRequest(source=recording, name="d"))
    assert report.is_refused and "must be a single-channel 16-bit PNG" in rows(report, "refused")


def test_frames_without_a_pose(recording: Path) -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1] = np.nan
    np.save(recording.parent / "poses.npy", poses)
    known = KnownCameras(cameras=recording.parent / "poses.npy")
    report = examine(ImportRequest(source=recording, name="d", known=known))
    assert "no pose for 1 of 3 frames: 1" in rows(report, "ignored")


def test_single_files(recording: Path, tmp_path: Path) -> None:
    trimesh.creation.box((0.06, 0.08, 0.1)).export(tmp_path / "box.ply")
    found = examine(ImportRequest(source=tmp_path / "box.ply", name="d"))
    assert "mesh of 12 faces, 0.06 x 0.08 x 0.1 units" in rows(found, "found")
    found = examine(ImportRequest(source=recording / "intrinsics.json", name="d"))
    assert "intrinsics: fx 60.00" in rows(found, "found")
    np.save(tmp_path / "poses.npy", np.tile(np.eye(4), (3, 1, 1)))
    found = examine(ImportRequest(source=tmp_path / "poses.npy", name="d"))
    assert "camera poses (matrices): 3" in rows(found, "found")
    (tmp_path / "a.json").write_text('{"fx": 60, "fy": 60, "cx": 31, "cy": 23, "xi": 0.4}')
    assert examine(ImportRequest(source=tmp_path / "a.json", name="d")).is_refused


def test_the_command(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(recording)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("guessed  depth: median") for line in lines)
    assert main(["doctor", str(recording), "--json"]) == 0
    assert {"kind", "text"} == set(json.loads(capsys.readouterr().out)[0])
    assert main(["doctor", str(recording / "none")]) == 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("k.mkv", r"\.mkv files are not read; .*azure_kinect_mkv_reader"),
        ("K.MKV", r"\.mkv files are not read"),
        ("k.svo2", r"\.svo2 files are not read"),
        ("k.mp4", r"\.mp4 files are not read; a video has no depth"),
        ("k.dae", r"\.dae files are not read; .*as OBJ or GLB"),
    ],
)
def test_a_file_of_another_program_is_named_with_what_to_do(
    tmp_path: Path, name: str, words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(b"\x1aE\xdf\xa3 K4A_COLOR_MODE")
    report = examine(ImportRequest(source=path, name="k"))
    assert [kind for kind, _ in report.rows] == ["refused"]
    assert re.search(f"{name}: {words}", report.rows[0][1])
    with pytest.raises(ToolkitError, match=words):
        detect_format(path)
