"""Protocols for depth that is known up to scale and shift."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.cli.bench import main
from benchmark.cli.report import PROGRAM
from benchmark.data.frame import BACKGROUND, DepthFrame, Instance, Material, resize_nearest
from benchmark.data.splits import open_split
from benchmark.evaluation.results import TABLE
from benchmark.metrics.protocols import get_protocol, score_frame
from benchmark.metrics.protocols.alignment import Line, PairSums
from benchmark.metrics.protocols.score import pair_sums
from std_toolkit.geometry import Camera
from tests.benchmark.evaluation.bench_set import SPLIT, published_as, write_split

FRAME, CLIP = get_protocol("aligned-frame"), get_protocol("aligned-clip")
RNG = np.random.default_rng(0)


def a_frame(seed: int = 0) -> DepthFrame:
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.2, 1.8, (36, 64)).astype(np.float32)
    true[:4] = 0
    mask = np.full((36, 64), BACKGROUND, np.uint8)
    mask[10:20, 10:30] = 3
    glass = Instance(3, 1, Material.TRANSPARENT)
    color = np.zeros((36, 64, 3), np.uint8)
    camera = Camera(64, 36, 60, 60, 31.5, 17.5)
    return DepthFrame("a", str(seed), color, true, true, mask, camera, (glass,))


@settings(max_examples=20, deadline=None)
@given(st.floats(0.1, 50), st.floats(-0.15, 5), st.integers(0, 5))
def test_any_scale_and_shift_is_taken_back(scale: float, shift: float, seed: int) -> None:
    frame = a_frame(seed)
    there = frame.depth_true > 0
    guess = np.where(there, (frame.depth_true + shift) / scale, 0).astype(np.float32)
    rows = {r.subset: r.errors for r in score_frame(guess, frame, FRAME)}
    assert set(rows) == {"scene", "all", "specular+transparent"}
    for errors in rows.values():
        assert errors.rmse < 1e-4 and errors.d105 == 1
        assert errors.coverage == 1
    assert rows["scene"].n_pixels > 5 * rows["all"].n_pixels > 0


def test_the_line_is_numpys_and_the_range_is_kept() -> None:
    frame = a_frame()
    true = resize_nearest(frame.depth_true, (224, 126))
    guess = (true + RNG.uniform(1, 3, true.shape)).astype(np.float32)
    guess[:, ::3] = 0
    used = (true >= 0.3) & (true <= 1.5) & (guess > 0)
    scale, shift = np.polyfit(guess[used].astype(float), true[used].astype(float), 1)
    found = pair_sums(guess, frame.depth_true, FRAME)
    assert found.count == used.sum() > 1000
    np.testing.assert_allclose([found.line.scale, found.line.shift], [scale, shift], rtol=1e-6)
    again = score_frame(guess, frame, FRAME)[0].errors
    aligned = Line(found.line.scale, found.line.shift).of(guess)
    metric = replace(FRAME, align="")
    assert score_frame(aligned, frame, metric)[0].errors == again


def test_degenerate_predictions() -> None:
    frame = a_frame()
    flat = np.full((36, 64), 3, np.float32)
    line = pair_sums(flat, frame.depth_true, FRAME).line
    assert line.scale == 0 and 0.3 < line.shift < 1.5
    for none in (None, np.zeros((36, 64), np.float32), np.full((36, 64), np.nan, np.float32)):
        errors = score_frame(none, frame, FRAME)[0].errors
        assert errors.coverage == 0 and errors.rel == 1
    assert PairSums().line == Line(0.0, 0.0)
    # Nearer is larger, as disparity: it is not turned round, but scored as one flat answer.
    inverse = np.where(frame.depth_true > 0, 1 / np.maximum(frame.depth_true, 0.1), 0)
    line = pair_sums(inverse.astype(np.float32), frame.depth_true, FRAME).line
    assert line.scale == 0 and 0.3 < line.shift < 1.5


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_split(tmp_path_factory.mktemp("data"), scenes=2, frames=3)


def scenes_of(root: Path) -> list[str]:
    keys = open_split(SPLIT, root).keys()
    return sorted({key.scene for key in keys})


def relative(root: Path, folder: Path, factors: dict[str, list[float]]) -> Path:
    """Truth in a unit of its own for each frame."""
    source = open_split(SPLIT, root)
    for index, key in enumerate(source.keys()):
        path = folder / key.scene / f"{key.name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        true = source.load(index).depth_true
        np.save(path, np.where(true > 0, true * factors[key.scene][int(key.name)] + 0.5, 0))
    return folder


def rmse(out: Path, protocol: str) -> pd.Series:
    table = pd.read_parquet(out / SPLIT / "mine" / protocol / TABLE)
    assert table["harm_opaque"].isna().all()
    return table[table["subset"] == "scene"].groupby("scene")["rmse"].max()


def test_clips_have_one_scale(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = scenes_of(root)
    factors = {scenes[0]: [10.0] * 3, scenes[1]: [10.0, 10.0, 15.0]}
    folder = relative(root, tmp_path / "mine", factors)
    out = tmp_path / "out"
    words = ["depth", "--method", f"mine={folder}", "--data", str(root), "--split", SPLIT]
    words += ["--out", str(out), "--engine", "serial", "--protocol"]
    assert main([*words, "aligned-frame", "aligned-clip"]) == 0
    told = capsys.readouterr().out
    assert "protocol aligned-clip" in told and "RMSE cm" in told and "RMSE mm" not in told
    assert rmse(out, "aligned-frame").max() < 1e-4
    assert rmse(out, "aligned-clip")[scenes[0]] < 1e-4 < 0.01 < rmse(out, "aligned-clip")[scenes[1]]
    before = pd.read_parquet(out / SPLIT / "mine" / "aligned-clip" / TABLE)
    # One frame changes: its clip is aligned anew, and the same rows come from any beginning.
    relative(root, folder, factors | {scenes[1]: [10.0] * 3})
    assert main([*words, "aligned-clip"]) == 0
    assert rmse(out, "aligned-clip").max() < 1e-4
    relative(root, folder, factors)
    assert main([*words, "aligned-clip", "--batch-size", "1"]) == 1  # another batch size
    assert main([*words, "aligned-clip"]) == 0
    pd.testing.assert_frame_equal(
        before, pd.read_parquet(out / SPLIT / "mine" / "aligned-clip" / TABLE)
    )
    assert main([*words, "strict"]) == 1  # as metric depth it is refused
    assert "is likely in" in capsys.readouterr().err
    with published_as(6, 2):
        assert PROGRAM.main([str(out)]) == 0
    rows = pd.read_csv(out / "leaderboard.csv")
    assert not (rows["kind"] == "published").any()
    assert "not to be compared with metric depth" in (out / "report.html").read_text()
    assert "RMSE [cm]" in (out / "leaderboard.md").read_text()


def test_a_missing_frame_costs_and_probes_are_refused(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = scenes_of(root)
    folder = relative(root, tmp_path / "mine", dict.fromkeys(scenes, [2.0] * 3))
    next(folder.rglob("*.npy")).unlink()
    words = ["depth", "--data", str(root), "--split", SPLIT, "--protocol", "aligned-clip"]
    words += ["--engine", "serial", "--no-speed", "--out", str(tmp_path / "out")]
    assert main([*words, "--method", f"mine={folder}"]) == 1
    table = pd.read_parquet(tmp_path / "out" / SPLIT / "mine" / "aligned-clip" / TABLE)
    table = table[table["subset"] == "scene"]
    assert sorted(table["coverage"].round(3)) == [0, 1, 1, 1, 1, 1]
    capsys.readouterr()
    assert main([*words, "--method", "raw", "--probe", "holes"]) == 1
    assert "needs metric depth" in capsys.readouterr().err
