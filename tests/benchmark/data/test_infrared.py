"""Infrared pairs of data sets: where they lie, their calibration, and rows of stereo methods."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.data.infrared import calibration_file, infrared_inputs, read_infrared
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.images import write_png
from std_toolkit.scene.pose_model import CameraModel
from tests.benchmark.data.stereo_set import (
    BASELINE_M,
    LEFT,
    T_COLOR_LEFT,
    calibration,
    plane_pair,
    write_stereo_scene,
)

SPLIT = "dreds-catknown-test"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write_stereo_scene(tmp_path / "DREDS-CatKnown/test/00000")


def bench(root: Path, *methods: str, out: str = "out") -> list[str]:
    words = ["--data", str(root), "--split", SPLIT, "--out", str(root / out), "--engine", "serial"]
    return ["--method", *methods, *words, "--no-gallery", "--no-speed"]


def test_a_pair_and_its_calibration_are_read(scene: Path, tmp_path: Path) -> None:
    pair = read_infrared(scene, "0001", 1)
    wanted = plane_pair(1)
    assert (pair.left == wanted.left).all() and (pair.right == wanted.right).all()
    assert pair.camera.fx == LEFT.fx and pair.baseline_m == BASELINE_M
    assert np.allclose(pair.T_color_left.matrix(), T_COLOR_LEFT.matrix())
    # One file may serve a whole data set; that of the scene goes before.
    (scene / "infrared.json").rename(tmp_path / "infrared.json")
    assert calibration_file(scene) == tmp_path / "infrared.json"
    assert len(infrared_inputs(scene, "0001")) == 3
    assert read_infrared(scene, "0001", 1).baseline_m == BASELINE_M


def test_records_of_std_sim_and_std_record_tell_it(tmp_path: Path) -> None:
    cam = SE3(T_COLOR_LEFT.R, np.array([0.1, 0.2, 1.0]))
    left = json.loads(json.dumps(calibration()))["left"] | {"distortion": []}
    record = {
        "infrared_camera": left, "baseline_m": BASELINE_M, "sensor": "d415",
        "frames": [{"index": 3, "T_world_cam": cam.flat(),
                    "T_world_ir": (cam @ T_COLOR_LEFT).flat()}],
    }  # fmt: skip
    for kind in ("left", "right"):
        (tmp_path / "infrared" / kind).mkdir(parents=True)
        write_png(tmp_path / "infrared" / kind / "000003.png", getattr(plane_pair(), kind))
    (tmp_path / ".std").mkdir()
    path = tmp_path / ".std/simulation.json"
    path.write_text(json.dumps(record))
    pair = read_infrared(tmp_path, "000003", 3)
    assert np.allclose(pair.T_color_left.matrix(), T_COLOR_LEFT.matrix(), atol=1e-9)
    path.write_text(json.dumps(record | {"baseline_m": None}))
    with pytest.raises(ToolkitError, match="does not tell the infrared pair") as told:
        read_infrared(tmp_path, "000003", 3)
    assert "infrared.json" in str(told.value.hint)
    path.write_text(json.dumps(record))
    with pytest.raises(ToolkitError, match="no such frame"):
        read_infrared(tmp_path, "000003", 4)
    path.unlink()
    recorded = {"infrared": left, "T_color_depth": T_COLOR_LEFT.flat(), "baseline_m": 0.05}
    (tmp_path / "recording.json").write_text(json.dumps(recorded))
    assert read_infrared(tmp_path, "000003", 3).baseline_m == 0.05
    assert CameraModel.of(read_infrared(tmp_path, "000003", 3).camera).width == LEFT.width


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (lambda s: (s / "0000_ir_r.png").unlink(), "no such file"),
        (lambda s: (s / "infrared.json").unlink(), "nothing tells the cameras"),
        (lambda s: write_png(s / "0000_ir_r.png", np.zeros((9, 16), np.uint8)), "differ in size"),
        (lambda s: write_png(s / "0000_ir_l.png", np.zeros((180, 320), np.uint16)), "8-bit grey"),
        (lambda s: edit(s, baseline_m=-0.05), "baseline_m"),
        (lambda s: edit(s, baseline_m=55.0), "baseline_m"),
        (lambda s: edit(s, T_color_left=[1.0] * 16), "T_color_left"),
        (lambda s: edit(s, T_color_left=[1.0] * 9), "T_color_left"),
        (lambda s: edit(s, left=calibration()["left"] | {"height": 240}), "other proportions"),
        (lambda s: edit(s, right={}), "right"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(scene: Path, harm, told: str) -> None:
    harm(scene)
    with pytest.raises(ToolkitError, match=told) as caught:
        read_infrared(scene, "0000", 0)
    assert "\n" not in str(caught.value)


def edit(scene: Path, **changes: object) -> None:
    path = scene / "infrared.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_stereo_rows_beside_the_sensor(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(bench(tmp_path, "raw", "stereo-local", "stereo-sgbm")) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("raw", "stereo-local", "stereo-sgbm"))
    table = pd.read_parquet(tmp_path / "out" / SPLIT / "stereo-local/strict/images.parquet")
    rows = table[(table["subset"] == "all") & (table["grid"] == "native")]
    answered = rows["n_answered"] / rows["n_pixels"]
    assert len(rows) == 2 and (answered > 0.9).all() and (rows["rmse_answered"] < 0.01).all()
    # Other images of one frame: that frame is scored again, the same command resumes.
    pair = plane_pair(7)
    write_png(scene / "0001_ir_r.png", pair.right)
    assert main(bench(tmp_path, "stereo-local")) == 0
    again = pd.read_parquet(tmp_path / "out" / SPLIT / "stereo-local/strict/images.parquet")
    changed = again[(again["subset"] == "all") & (again["grid"] == "native")]
    assert changed["n_answered"].iloc[1] < rows["n_answered"].iloc[1] / 2
    assert changed["rmse"].iloc[0] == rows["rmse"].iloc[0]


def test_data_without_a_pair_are_refused_before_any_work(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in scene.glob("*_ir_l.png"):
        path.unlink()
    assert main(bench(tmp_path, "raw", "stereo-sgbm")) == 1
    said = capsys.readouterr()
    assert "stereo-sgbm" in said.err and "no infrared pair" in said.err
    assert "raw" in said.out and not list((tmp_path / "out" / SPLIT).glob("stereo*/strict/images*"))


@pytest.mark.slow
def test_simulated_frames(tiny_dreds: Path, tmp_path: Path) -> None:
    """What std-sim writes is read without a further file: its depth is by the local matcher."""
    split = "dreds-catknown-train"
    words = ["--method", "raw", "stereo-local", "--data", str(tiny_dreds), "--split", split]
    words += ["--out", str(tmp_path), "--engine", "serial", "--no-gallery", "--no-speed"]
    assert main(words) == 0
    found = {}
    for name in ("raw", "stereo-local"):
        (path,) = tmp_path.glob(f"*/{name}/strict/images.parquet")
        table = pd.read_parquet(path)
        rows = table[(table["subset"] == "all") & (table["grid"] == "native")]
        found[name] = (
            rows["n_answered"].sum() / rows["n_pixels"].sum(),
            rows["mae_answered"].mean(),
        )
    assert found["stereo-local"][0] == pytest.approx(found["raw"][0], abs=0.1)
    assert found["stereo-local"][1] < 1.5 * found["raw"][1] + 0.005
