"""Data sets from the command line: made, gone on with, killed, refused."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from set_on_disk import arguments, contents

from sensors.output.dreds import SUFFIXES, scene_folder
from sensors.simulation.cli import main
from sensors.simulation.set_report import set_statistics
from std_toolkit.io.exr import read_exr_depth
from std_toolkit.scene import Scene

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, shapes: Path) -> Path:
    """Two scenes in both layouts, made without workers."""
    out = tmp_path_factory.mktemp("set") / "made"
    both = ("--layout", "dreds", "--layout", "scene")
    assert main(arguments(out, shapes, "--scenes", "2", "--engine", "serial", *both)) == 0
    return out


def test_every_frame_has_every_file_and_depth_is_about_right(made: Path) -> None:
    for name in ("00000", "00001"):
        folder = scene_folder(made, "train", name)
        for index in range(2):
            assert all((folder / f"{index:04d}{suffix}").is_file() for suffix in SUFFIXES)
        raw = read_exr_depth(folder / "0000_simDepthImage.exr")
        exact = read_exr_depth(folder / "0000_depth_120.exr")
        seen = raw > 0
        # 160 pixels across are an eighth of what the sensor has: half a pixel is 40 mm at 0.7 m.
        assert seen.mean() > 0.2
        assert np.median(np.abs(raw - exact)[seen]) < 0.04
        assert (exact > 0).mean() > 0.99


def test_a_scene_of_the_toolkit_lies_beside_it(made: Path) -> None:
    scene = Scene.open(made / "scenes" / "00001")
    assert len(scene.frames) == 2
    assert scene.objects.objects and scene.labels.labels


def test_statistics_count_what_is_there(made: Path) -> None:
    found = set_statistics(made)
    assert (found.scenes, found.frames) == (2, 4)
    assert found.depth.loc["background", "pixels"] > 0
    assert (found.depth["complete %"] <= 100).all()


def test_another_engine_makes_the_same_set(made: Path, shapes: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    # One process with all threads made the other one.
    assert main(arguments(out, shapes, "--scenes", "2", "--workers", "2")) == 0
    assert contents(out / "DREDS-CatKnown") == contents(made / "DREDS-CatKnown")


def test_what_is_there_is_kept(made: Path, shapes: Path, capsys: pytest.CaptureFixture) -> None:
    before = contents(made / "DREDS-CatKnown")
    assert main(arguments(made, shapes, "--scenes", "2", "--engine", "serial")) == 0
    assert "0 scenes made, 2 kept" in capsys.readouterr().out
    assert contents(made / "DREDS-CatKnown") == before


@pytest.mark.parametrize(
    "name",
    [
        "DREDS-CatKnown/train/00001/0001_simDepthImage.exr",
        "scenes/00001/depth/000001.exr",
        "cad_model",
    ],
)
def test_a_file_that_changed_is_named(
    name: str, made: Path, shapes: Path, capsys: pytest.CaptureFixture
) -> None:
    both = ("--layout", "dreds", "--layout", "scene")
    path = made / name
    path = path if path.is_file() else next(path.rglob("*.obj"))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    try:
        assert main(arguments(made, shapes, "--scenes", "2", "--engine", "serial", *both)) == 1
    finally:
        path.write_bytes(data)
    said = capsys.readouterr()
    assert f"{path.name} changed since the scene was made" in said.err + said.out
    assert main(arguments(made, shapes, "--scenes", "2", "--engine", "serial", *both)) == 0


def has_frames(folder: Path) -> bool:
    """Whether a frame was written below a folder, which the program removes between scenes."""
    return any(name.endswith("_meta.txt") for _, _, names in os.walk(folder) for name in names)


def test_killed_in_the_middle_nothing_is_half_there(
    made: Path, shapes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    command = [sys.executable, "-m", "sensors.simulation.cli"]
    command += arguments(out, shapes, "--scenes", "2", "--engine", "serial")
    run = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    first = scene_folder(out, "train", "00000")
    partial = out / ".partial"
    end = time.monotonic() + 120
    while time.monotonic() < end and not (first.is_dir() and has_frames(partial)):
        if run.poll() is not None:
            break
        time.sleep(0.01)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    assert first.is_dir()
    assert not scene_folder(out, "train", "00001").exists()
    assert main(arguments(out, shapes, "--scenes", "2", "--engine", "serial")) == 0
    assert contents(out / "DREDS-CatKnown") == contents(made / "DREDS-CatKnown")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--sensor", "d4150"), "no such sensor"),
        (("--environments", "/no/such/folder"), "/no/such/folder"),
        (("--views", "3"), "options.views"),
        (("--scenes", "0"), "no scene"),
        (("--seed", "100000"), "five digits"),
        (("--width", "200"), "200x90"),
        (("--matcher", "guess"), "guess"),
        (("--share", "0"), "--share"),
    ],
)
def test_bad_input_is_one_line(
    more: tuple[str, ...],
    said: str,
    made: Path,
    shapes: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    # Other options than those that a set was begun with need a set.
    out = made if "--views" in more else tmp_path / "new"
    status = 2 if "--share" in more else 1
    assert main(arguments(out, shapes, "--engine", "serial", *more)) == status
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error:")]
    assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "new" / "DREDS-CatKnown").exists()


def test_too_little_room_is_told_first(
    shapes: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=10_000_000))
    assert main(arguments(tmp_path / "full", shapes, "--engine", "serial")) == 1
    assert "GB" in capsys.readouterr().err


def test_without_a_compiler_it_renders_slowly_and_says_so(shapes: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sensors.simulation.cli", "preview"]
    command += ["--out", str(tmp_path / "sheet.png"), "--views", "1", "--quality", "rough"]
    command += ["--width", "160", "--height", "90"]
    command += ["--assets", "folder", "--assets-root", str(shapes)]
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(tmp_path / "libLLVM.so")}
    environment.pop("STD_SIM_VARIANT", None)
    # Where there is a graphics card this would take it.
    environment["CUDA_VISIBLE_DEVICES"] = ""
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    assert "several times slower" in done.stderr and "libllvm19" in done.stderr
    assert (tmp_path / "sheet.png").is_file()
