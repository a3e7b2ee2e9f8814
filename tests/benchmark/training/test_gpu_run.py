"""Training from parts, as on a GPU elsewhere, with little of everything on the CPU."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from training_set import SPLIT, packed, write_scenes

from benchmark.methods.weights import read_weights
from benchmark.training.packed_frames import PackedFrames
from tools import gpu_run as program
from tools.gpu_parts import read_part

SHIPPED = Path("benchmark/weights/compactdr-compact.safetensors")


@pytest.fixture
def train_elsewhere(monkeypatch):
    def run(*arguments: object) -> None:
        monkeypatch.setattr(sys, "argv", ["gpu_run.py", *map(str, arguments)])
        program.main()

    return run


def test_parts_hold_the_frames(tmp_path, train_elsewhere) -> None:
    run = train_elsewhere
    pack = packed(tmp_path / "pack", write_scenes(tmp_path / "data"), size=(48, 32))
    run("prepare", tmp_path / "parts", "--data", pack, "--most-mb", 0.02)
    parts = sorted((tmp_path / "parts").glob("part-*.npz"))
    assert len(parts) > 1
    read = [read_part(part) for part in parts]
    found = {name: np.concatenate([one[name] for one in read]) for name in read[0]}
    frames = PackedFrames([pack])
    order = np.random.default_rng(0).permutation(len(frames))
    assert frames.setups[0].split == SPLIT
    for row, index in enumerate(order.tolist()):
        record = frames.record(index)
        for name in ("mask", "materials", "K"):
            assert np.array_equal(found[name][row], record[name])
        for name in ("true", "raw"):
            apart = np.abs(found[name][row] - record[name])
            assert np.array_equal(found[name][row] > 0, record[name] > 0)
            assert (apart <= 1e-4 * np.maximum(record[name], 1.0) ** 2).all()
        # Of pure noise a photographic format keeps the brightness alone.
        grey, before = found["color"][row].mean(axis=2), record["color"].mean(axis=2)
        assert np.corrcoef(grey.ravel(), before.ravel())[0, 1] > 0.8


@pytest.mark.slow
def test_it_trains_what_arrives(tmp_path, train_elsewhere) -> None:
    run = train_elsewhere
    pack = packed(tmp_path / "pack", write_scenes(tmp_path / "data"), size=(128, 96))
    run("prepare", tmp_path / "parts", "--data", pack)
    options = ("--parts", tmp_path / "parts", "--weights", SHIPPED, "--out", tmp_path / "out")
    run("train", *options, "--minutes", 0.2, "--try")
    summary = json.loads((tmp_path / "out" / "run.json").read_text())
    assert summary["steps"] > 2
    assert summary["frames"] == 12
    found, before = read_weights(tmp_path / "out" / "mean.safetensors"), read_weights(SHIPPED)
    assert found.keys() == before.keys()
    changed = [name for name in found if not np.array_equal(found[name], before[name])]
    assert {name.split(".")[0] for name in changed} >= {"encoder", "clear", "last", "of_depth"}
