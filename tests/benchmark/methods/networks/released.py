"""Weights and inputs of the known answers of published programs, kept beside the test data."""

from __future__ import annotations

import csv
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
import torch


def reference_folder() -> Path:
    """Folder of the known answers."""
    folder = Path(__file__).resolve().parents[5] / "shared" / "reference"
    if not folder.is_dir():
        pytest.skip(f"known answers not found at {folder}")
    return folder


def known(key: str, shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Weights of a key; with seed 0, as the known answers were computed with."""
    random = np.random.RandomState((crc32(key.encode()) + seed) % 2**32)
    x = random.standard_normal(shape).astype(np.float32)
    if key.endswith("running_var"):
        return 1 + np.float32(0.1) * abs(x)
    if key.endswith("running_mean"):
        return np.float32(0.1) * x
    if x.ndim <= 1:
        return 1 + np.float32(0.1) * x if key.endswith("weight") else np.float32(0.02) * x
    return (x / np.sqrt(np.prod(shape[1:]))).astype(np.float32)


def released_state(name: str, seed: int = 0) -> dict[str, torch.Tensor]:
    """The authors' keys and shapes with the known weights of a seed."""
    state = {}
    with (reference_folder() / f"{name}_released_state_dict.csv").open() as file:
        for row in csv.DictReader(file):
            shape = tuple(int(n) for n in row["shape"].split())
            if row["dtype"].startswith("int"):
                state[row["key"]] = torch.zeros(shape, dtype=torch.int64)
            else:
                state[row["key"]] = torch.from_numpy(np.asarray(known(row["key"], shape, seed)))
    return state


def oracle(name: str) -> dict[str, np.ndarray]:
    with np.load(reference_folder() / f"{name}_released_oracle.npz") as file:
        return dict(file)


def waves(height: int, width: int) -> np.ndarray:
    """Depth of the known answers, metres, with a hole."""
    y, x = np.mgrid[:height, :width]
    depth = (0.5 + 0.3 * y / (height - 1) + 0.05 * np.sin(x / 9)).astype(np.float32)
    depth[60:110, 80:150] = 0
    return depth
