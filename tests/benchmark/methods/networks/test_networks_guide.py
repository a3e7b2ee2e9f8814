"""docs/methods.md: its tables of networks say what the networks are."""

from __future__ import annotations

import importlib
import re
from dataclasses import fields
from pathlib import Path

import pytest
import torch

from benchmark.methods.network import parameter_count
from benchmark.metrics.protocols.protocol import STRICT

REPOSITORY = Path(__file__).resolve().parents[4]
NETWORKS = {
    "swindrnet": "SwinDRNetwork",
    "nlspn": "NLSPNetwork",
    "lidf": "LIDFNetwork",
    "cleargrasp": "ClearGraspNetwork",
    "dfnet": "DFNetwork",
}
MODULES = {
    "swindrnet": "swindrnet.swindrnet_network",
    "nlspn": "nlspn",
    "lidf": "lidf.lidf",
    "cleargrasp": "cleargrasp.cleargrasp_network",
    "dfnet": "dfnet",
}


def module(name: str):
    return importlib.import_module(f"benchmark.methods.depth.{MODULES[name]}")


def presets(name: str):
    return module(name).PRESETS


@pytest.fixture(scope="module")
def text() -> str:
    return (REPOSITORY / "docs" / "methods.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", NETWORKS)
def test_sizes_and_parameters(text: str, name: str) -> None:
    row = re.search(rf"^\| `{name}` \| ([^|]*) \| ([\d.]+) M, ([\d.]+) M \|", text, re.M)
    assert row is not None
    w, h = presets(name)["published"].input_size
    assert f"{w}x{h}" in row[1]
    network = getattr(module(name), NETWORKS[name])
    with torch.device("meta"):
        sizes = [parameter_count(network(presets(name)[p])) for p in ("published", "compact")]
    assert [f"{size / 1e6:.2f}" for size in sizes] == [row[2], row[3]]
    assert sizes[1] < 15_000_000


@pytest.mark.parametrize("name", ["swindrnet", "nlspn", "dfnet"])
def test_compact_networks_work_at_the_size_of_the_main_tables(text: str, name: str) -> None:
    w, h = presets(name)["compact"].input_size
    assert (w, h) == STRICT.grids[0].size
    assert re.search(rf"^\| `{name}` \| [^|]*`compact`: {w}x{h}\)", text, re.M)


def test_settings_are_fields_with_those_defaults(text: str) -> None:
    rows = re.findall(r"^\| `(\w+)\.(\w+)` \| `([^`]*)` \|", text, re.M)
    assert len(rows) == 12 and {name for name, _, _ in rows} == set(NETWORKS)
    for name, setting, default in rows:
        config = presets(name)["published"]
        assert setting in {field.name for field in fields(config)}
        assert str(getattr(config, setting)).lower() == default
