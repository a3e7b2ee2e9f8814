"""Weights and inputs of the known answers of published programs, kept beside the test data."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.methods.known.released import known_weights, waves

__all__ = ["oracle", "reference_folder", "released_state", "waves"]


def reference_folder() -> Path:
    """Folder of the known answers."""
    folder = Path(__file__).resolve().parents[5] / "shared" / "reference"
    if not folder.is_dir():
        pytest.skip(f"known answers not found at {folder}")
    return folder


def released_state(name: str, seed: int = 0) -> dict[str, torch.Tensor]:
    """The authors' keys and shapes with the known weights of a seed."""
    state = {}
    with (reference_folder() / f"{name}_released_state_dict.csv").open() as file:
        for row in csv.DictReader(file):
            shape = tuple(int(n) for n in row["shape"].split())
            if row["dtype"].startswith("int"):
                state[row["key"]] = torch.zeros(shape, dtype=torch.int64)
            else:
                state[row["key"]] = torch.from_numpy(
                    np.asarray(known_weights(row["key"], shape, seed))
                )
    return state


def oracle(name: str) -> dict[str, np.ndarray]:
    with np.load(reference_folder() / f"{name}_released_oracle.npz") as file:
        return dict(file)
