"""Damaged files that parsers accept: refused, or a warning with the file's name."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.foreign_files import read_json
from std_toolkit.io.images import read_color
from std_toolkit.poses.board_scale import Board


@pytest.fixture(scope="module")
def photo() -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2)


def jpeg(photo: np.ndarray, *, progressive: bool) -> bytes:
    flags = [cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive)]
    return cv2.imencode(".jpg", photo, flags)[1].tobytes()


@pytest.mark.parametrize("progressive", [False, True])
def test_jpegs_with_zeroed_bytes_are_refused(
    progressive: bool, photo: np.ndarray, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    whole, path = jpeg(photo, progressive=progressive), tmp_path / "a.jpg"
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(20):
        at = int(rng.integers(700, len(whole) - 700))
        path.write_bytes(whole[:at] + bytes(512) + whole[at + 512 :])
        try:
            read_color(path)
        except ToolkitError as error:
            refused += 1
            assert "a.jpg: the JPEG file is" in str(error)
    assert refused >= 19
    assert capfd.readouterr().err == ""  # no line of libjpeg's own, without a file name


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_jpegs_that_are_cut_before_an_end_marker_are_refused(
    part: float, progressive: bool, photo: np.ndarray, tmp_path: Path
) -> None:
    whole = jpeg(photo, progressive=progressive)
    (tmp_path / "a.jpg").write_bytes(whole[: int(part * len(whole))] + b"\xff\xd9")
    with pytest.raises(ToolkitError, match=r"a\.jpg: .*(damaged|truncated)"):
        read_color(tmp_path / "a.jpg")


def test_whole_jpegs_and_lines_of_others_pass(
    photo: np.ndarray, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(photo, progressive=False))
    decode = cv2.imdecode

    def chatty(*arguments: Any) -> Any:
        os.write(2, b"a line of another thread\n")
        return decode(*arguments)

    monkeypatch.setattr("cv2.imdecode", chatty)
    assert np.abs(read_color(tmp_path / "a.jpg")[..., ::-1].astype(int) - photo).mean() < 5
    assert capfd.readouterr().err == "a line of another thread\n"


@pytest.mark.parametrize("suffix", ["ply", "obj", "off", "stl", "glb"])
@pytest.mark.parametrize("part", [0.5, 0.8])
def test_meshes_that_are_cut_are_refused(suffix: str, part: float, tmp_path: Path) -> None:
    more = {"encoding": "ascii"} if suffix == "ply" else {}
    path = tmp_path / f"m.{suffix}"
    trimesh.creation.icosphere(subdivisions=3, radius=0.05).export(path, **more)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))].rstrip(b"\n0123456789") + b"2")
    with pytest.raises(ToolkitError, match=f"m.{suffix}"):
        load_mesh(path)


def test_an_obj_cut_between_two_faces_is_warned_about(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "m.obj"
    trimesh.creation.icosphere(subdivisions=3, radius=0.05).export(path)
    load_mesh(path)
    assert caplog.text == ""
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[: -len(lines) // 4]) + "\n")
    load_mesh(path)
    assert "m.obj" in caplog.text and "belong to no face; is the file cut off?" in caplog.text


def test_an_obj_with_fewer_faces_than_its_comment_says_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    trimesh.creation.box([0.1, 0.1, 0.1]).export(path)
    lines = path.read_text().splitlines()
    path.write_text("# Vertices: 8\n# Faces: 12\n" + "\n".join(lines) + "\n")
    load_mesh(path)
    path.write_text("# Vertices: 8\n# Faces: 12\n" + "\n".join(lines[:-2]) + "\n")
    with pytest.raises(ToolkitError, match=r"m\.obj: faces: .* announces 12 faces"):
        load_mesh(path)


TWICE: dict[str, tuple[str, Callable[[Path], object]]] = {
    "intrinsics": (
        '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "fx": 300}',
        lambda p: read_intrinsics(str(p)),
    ),
    "board": (
        '{"0": [[0,0,0],[9,0,0],[9,9,0],[0,9,0]], "0": [[0,0,0],[5,0,0],[5,5,0],[0,5,0]]}',
        Board.read,
    ),
    "any": ('{"a": {"b": 1, "b": 2}}', read_json),
}


@pytest.mark.parametrize("name", TWICE)
def test_a_key_given_twice_is_refused(name: str, tmp_path: Path) -> None:
    text, read = TWICE[name]
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(ToolkitError, match=r"a\.json: \w+: a key appears twice"):
        read(path)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, "1" * 400, "1" * 5000, json.dumps("x" * 17_000_000)]
)
def test_json_of_others_that_asks_for_too_much(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ToolkitError, match=r"a\.json") as caught:
        read_json(tmp_path / "a.json")
    assert len(str(caught.value)) < 400


@pytest.mark.slow
def test_an_export_without_depth_says_so_and_comes_back(
    root: Path, tmp_path: Path, run: Callable[..., Any]
) -> None:
    document = json.loads((root / "frames.json").read_text())
    for frame in document["frames"]:
        frame["depth"] = None
    (root / "frames.json").write_text(json.dumps(document))
    jobs = ("--engine", "serial")
    assert run("render", root, "--renderer", "raycast", *jobs).status == 0
    outcome = run("export", root, "--format", "std", "--out", tmp_path / "out", *jobs)
    assert outcome.status == 0
    assert "3 of 3 frames have no sensor depth" in outcome.err
    outcome = run("import", tmp_path / "out", "--out", tmp_path / "again", *jobs)
    assert outcome.status == 0, outcome.err
    assert "3, 0 with sensor depth" in outcome.out
