"""What `std-restore` warns of: smooth depth that is replaced, depth beside colour, a lens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.cli.restore import main
from benchmark.restoring.alignment import depth_beside_color
from std_toolkit.geometry import Camera
from std_toolkit.geometry.camera import undistort_image
from std_toolkit.importers.intrinsics import read_intrinsics
from std_toolkit.io.images import read_color, read_depth, write_color, write_depth_png16
from tests.benchmark.restoring.restore_cases import (
    SIZE,
    K,
    write_blocks,
    write_folder,
    write_methods,
)

WIDE = "300,300,159.5,119.5"


def restore(*words: object) -> int:
    return main([str(word) for word in (*words, "--engine", "serial")])


def plane(root: Path) -> Path:
    """A bare table, measured everywhere."""
    write_color(root / "color/0000.png", np.full((72, 96, 3), 90, np.uint8))
    depth = np.tile(np.linspace(0.9, 0.6, 72, dtype=np.float32)[:, None], (1, 96))
    write_depth_png16(root / "depth/0000.png", depth, scale=1e-3)
    return root


def test_smooth_depth_that_is_replaced_is_told_with_its_share(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, methods = plane(tmp_path / "rec"), write_methods(tmp_path)
    given = (folder, "--intrinsics", K, "--method")
    assert restore(*given, f"{methods}:Lifting", "--out", tmp_path / "out") == 0
    told = capsys.readouterr().err
    assert "% of the smooth depth that the sensor measured is replaced" in told
    record = json.loads((tmp_path / "out/frames/0000.json").read_text())
    assert record["smooth"] > 0.95
    assert record["smooth_moved"] == pytest.approx(0.25, abs=0.03)
    assert f"{record['smooth_moved']:.1%}" in told
    # The same of a run that is resumed.
    assert restore(*given, f"{methods}:Lifting", "--out", tmp_path / "out") == 0
    assert "smooth depth" in capsys.readouterr().err
    assert restore(*given, f"{methods}:FromBehind", "--out", tmp_path / "quiet") == 0
    assert "smooth depth" not in capsys.readouterr().err
    assert restore(*given, f"{methods}:Lifting", "--out", tmp_path / "out", "--json") == 0
    (told_json,) = json.loads(capsys.readouterr().out)
    assert told_json["smooth_moved"] == pytest.approx(0.25, abs=0.03)


@pytest.mark.parametrize("shift", [0, 4, 20, -16])
def test_depth_beside_colour_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], shift: int
) -> None:
    folder = write_blocks(tmp_path / "rec", shift)
    given = ("--intrinsics", WIDE, "--method", "nearest", "--out", tmp_path / "out")
    assert restore(folder, *given) == 0
    told = capsys.readouterr().err
    assert ("depth lies beside colour" in told) == (abs(shift) > 8)
    frames = [
        (
            read_color(folder / f"color/{i:04d}.png"),
            read_depth(folder / f"depth/{i:04d}.png", scale=1e-3),
        )
        for i in range(3)
    ]
    found = depth_beside_color(frames)
    if abs(shift) > 8:
        assert found is not None
        assert found.x_px == pytest.approx(shift, abs=2)
        assert found.y_px == pytest.approx(0, abs=2)
    else:
        assert found is None


def test_nothing_is_said_of_depth_that_cannot_tell(tmp_path: Path) -> None:
    """A bare table has no steps; noise for colour has edges everywhere, and agrees with none."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (240, 320, 3), dtype=np.uint8)
    table = np.tile(np.linspace(0.9, 0.6, 240, dtype=np.float32)[:, None], (1, 320))
    assert depth_beside_color([(noise, table)] * 3) is None
    assert depth_beside_color([(noise, 0 * table)] * 3) is None
    blocks = write_blocks(tmp_path / "rec", 15)
    depth = [read_depth(blocks / f"depth/{i:04d}.png", scale=1e-3) for i in range(3)]
    assert depth_beside_color([(noise, d) for d in depth]) is None
    assert depth_beside_color([]) is None


def test_distortion_is_taken_out_of_the_images(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "rec", 1)
    given = ("--intrinsics", K, "--method", "raw")
    assert restore(folder, *given, "--out", tmp_path / "plain") == 0
    assert restore(folder, *given, "--out", tmp_path / "out", "--distortion", "-0.2,0.05,0,0") == 0
    lens = Camera(*SIZE, 96, 96, 47.5, 35.5, (-0.2, 0.05, 0.0, 0.0))
    color = read_color(tmp_path / "out/color/0000.png")
    assert np.array_equal(color, undistort_image(read_color(folder / "color/0000.png"), lens))
    plain, depth = (
        read_depth(tmp_path / f"{name}/depth/0000.png", scale=1e-3) for name in ("plain", "out")
    )
    assert (plain != depth).mean() > 0.05
    written = read_intrinsics(str(tmp_path / "out/intrinsics.json"), size=SIZE)
    assert not any(written.distortion)
    zero = ("--distortion", "0,0,0,0")
    assert restore(folder, *given, *zero, "--out", tmp_path / "zero") == 0
    assert not (tmp_path / "zero/color").exists()


def test_distortion_that_is_not_the_cameras_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.scene_on_disk import write_scene

    scene = write_scene(tmp_path / "scene", labelled=False)
    words = (scene.root, "--method", "raw", "--out", tmp_path / "out")
    assert restore(*words, "--distortion", "-0.2,0.05,0,0") != 0
    told = capsys.readouterr().err
    assert "--distortion" in told and len(told.strip().splitlines()) == 1
