"""Batch-norm statistics that are recomputed before each validation."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import nn
from training_set import packed, trained, wishes, write_scenes

from benchmark.training.step import recompute_batch_norm


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("batch_norm")
    return packed(top / "pack", write_scenes(top / "data"))


def test_statistics_are_those_of_all_numbers():
    network = nn.Sequential(nn.BatchNorm1d(3), nn.Dropout(0.9), nn.BatchNorm1d(3))
    network[2].eval()  # a frozen part
    numbers = torch.randn(60, 3, generator=torch.Generator().manual_seed(0)) * 3 + 5
    batches = [{"x": part} for part in numbers.split(20)]
    recompute_batch_norm(network, batches, lambda batch: network(batch["x"]))
    norm = network[0]
    torch.testing.assert_close(norm.running_mean, numbers.mean(0))
    within = torch.stack([batch["x"].var(0) for batch in batches]).mean(0)
    torch.testing.assert_close(norm.running_var, within)
    assert norm.momentum == 0.1
    assert network.training
    assert not network[2].training
    assert not network[2].running_mean.any()


def test_they_change_nothing_else(pack: Path, tmp_path: Path):
    """The steps are the same; only what trained weights normalise by differs."""
    by_kind = {
        kind: trained(wishes("swindrnet", pack, batch_norm=kind), tmp_path / kind)
        for kind in ("running", "recomputed")
    }
    running, measured = by_kind["running"], by_kind["recomputed"]
    differing = {name for name in running if not torch.equal(running[name], measured[name])}
    assert differing
    assert all("running_" in name or "num_batches" in name for name in differing)
