"""Recordings that cannot be right are refused, and no scene is left behind."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from std_toolkit.io.images import write_color, write_png

NOISE = np.random.default_rng(0).integers(0, 256, (72, 96, 3), dtype=np.uint8)
INTRINSICS = "90,90,47.5,35.5"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "recording"
    for i in range(3):
        write_color(folder / f"color/{i:06d}.png", NOISE)
        write_png(folder / f"depth/{i:06d}.png", np.full((72, 96), 800, np.uint16))
    return folder


def replaced(name: str, content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(content)


def removed(name: str) -> Callable[[Path], object]:
    return lambda folder: (
        shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink()
    )


def emptied(name: str) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        for path in (folder / name).iterdir():
            path.unlink()

    return damage


def all_depth(image: np.ndarray) -> Callable[[Path], object]:
    def damage(folder: Path) -> None:
        for path in sorted((folder / "depth").iterdir()):
            write_png(path, image)

    return damage


def encoded(suffix: str, image: np.ndarray = NOISE) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def bomb() -> bytes:
    png = bytearray(encoded(".png"))
    png[16:24] = struct.pack(">II", 100_000, 100_000)
    return bytes(png)


FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no_color_folder": (removed("color"), "color"),
    "no_images": (emptied("color"), "color"),
    "color_empty": (replaced("color/000001.png", b""), "000001.png"),
    "color_truncated": (replaced("color/000001.png", encoded(".png")[:500]), "000001.png"),
    "color_text": (replaced("color/000001.png", b"hello"), "000001.png"),
    "color_mislabelled": (replaced("color/000001.png", encoded(".jpg")), "000001.png"),
    "color_bomb": (replaced("color/000001.png", bomb()), "000001.png"),
    "color_of_another_size": (
        replaced("color/000001.png", encoded(".png", NOISE[:36, :48])),
        "000001.png",
    ),
    "no_depth_folder": (removed("depth"), "depth"),
    "depth_of_one_frame_missing": (removed("depth/000001.png"), "depth"),
    "color_of_one_frame_missing": (removed("color/000001.png"), "depth"),
    "depth_truncated": (
        replaced("depth/000001.png", encoded(".png", np.full((72, 96), 8, np.uint16))[:60]),
        "000001.png",
    ),
    "depth_of_another_size": (
        replaced("depth/000001.png", encoded(".png", np.full((36, 48), 8, np.uint16))),
        "000001.png",
    ),
    "depth_8_bit": (all_depth(np.full((72, 96), 80, np.uint8)), "000000.png"),
    "depth_is_colour": (all_depth(NOISE), "000000.png"),
    "depth_in_metres": (all_depth(np.full((72, 96), 1, np.uint16)), "depth"),
    "depth_in_tenths_of_mm": (all_depth(np.full((72, 96), 60_000, np.uint16)), "depth"),
    "depth_all_missing": (all_depth(np.zeros((72, 96), np.uint16)), "depth"),
}


def assert_refused(run: Any, out: Path, *arguments: object, names: str) -> None:
    siblings = sorted(p.name for p in out.parent.iterdir())
    outcome = run("import", *arguments, "--out", out)
    assert outcome.status in (1, 2), outcome.out + outcome.err
    assert len(outcome.error_lines) == 1, outcome.err
    assert names in outcome.error_lines[0]
    assert "Traceback" not in outcome.err
    assert "a defect of" not in outcome.err, outcome.err
    assert not (out / "scene.json").exists()
    left = {p.name for p in out.parent.iterdir()} - set(siblings)
    assert not left, f"left behind: {left}"


@pytest.mark.parametrize("case", FILES)
def test_damaged_recordings_are_refused(
    recording: Path, tmp_path: Path, run: Any, case: str
) -> None:
    damage, names = FILES[case]
    damage(recording)
    assert_refused(
        run,
        tmp_path / "scene",
        *("--color", recording / "color", "--depth", recording / "depth"),
        *("--depth-scale", "0.001", "--intrinsics", INTRINSICS),
        names=names,
    )


@pytest.mark.parametrize(
    "intrinsics",
    [
        "90,90,47.5",
        "90,90,47.5,35.5,0",
        "a,b,c,d",
        "nan,90,47.5,35.5",
        "inf,90,47.5,35.5",
        "-90,90,47.5,35.5",
        "0,0,0,0",
        "45,45,23.5,17.5",
        "180,180,95,71",
        "90,90,47.5,53.5",
        "1.93,1.93,47.5,35.5",
        "",
        "/nowhere/k.json",
        "/dev/null",
        "../../etc/passwd",
    ],
)
def test_intrinsics_that_do_not_fit_are_refused(
    recording: Path, tmp_path: Path, run: Any, intrinsics: str
) -> None:
    """Also those of half and twice the size, of another aspect, and in millimetres."""
    arguments = ("--color", recording / "color", f"--intrinsics={intrinsics}")
    assert_refused(run, tmp_path / "scene", *arguments, names="")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[1, 2]",
        b'{"K": [[90, 0, 47.5], [0, 90, 35.5]]}',
        b'{"K": [[90, 0, NaN], [0, 90, 35.5], [0, 0, 1]]}',
        b'{"K": "abc"}',
        b'{"fx": 90}',
        b'{"width": 48, "height": 36, "K": [[45, 0, 23.5], [0, 45, 17.5], [0, 0, 1]]}',
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b"fx: [1, 2\n",
    ],
)
def test_files_of_intrinsics_that_cannot_be_right_are_refused(
    recording: Path, tmp_path: Path, run: Any, content: bytes
) -> None:
    path = tmp_path / "k.json"
    path.write_bytes(content)
    arguments = ("--color", recording / "color", "--intrinsics", path)
    assert_refused(run, tmp_path / "scene", *arguments, names="k.json")


@pytest.mark.parametrize("scale", ["0", "-0.001", "nan", "inf", "1", "1000"])
def test_depth_scales_that_cannot_be_right_are_refused(
    recording: Path, tmp_path: Path, run: Any, scale: str
) -> None:
    assert_refused(
        run,
        tmp_path / "scene",
        *("--color", recording / "color", "--depth", recording / "depth"),
        *(f"--depth-scale={scale}", "--intrinsics", INTRINSICS),
        names="",
    )


def test_a_scene_is_never_overwritten(root: Path, recording: Path, refuse: Any) -> None:
    refuse(
        "import",
        *("--color", recording / "color", "--intrinsics", INTRINSICS, "--out", root),
        names="scene",
    )


@pytest.mark.parametrize("name", ["../up", "a/b", ".hidden", "a\nb", ""])
def test_names_that_are_no_names_are_refused(
    recording: Path, tmp_path: Path, run: Any, name: str
) -> None:
    arguments = ("--color", recording / "color", "--intrinsics", INTRINSICS, f"--name={name}")
    if name == "":
        return  # falls back to the folder's name
    assert_refused(run, tmp_path / "scene", *arguments, names="name")
