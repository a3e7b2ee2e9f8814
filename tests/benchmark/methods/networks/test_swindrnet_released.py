"""SwinDRNet against what the published program computes with known weights."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
import torch
from network_cases import CASES, frames

from benchmark.methods.depth.swindrnet.fast import FastSwinDRNetwork
from benchmark.methods.depth.swindrnet.swin import relative_index
from benchmark.methods.depth.swindrnet.swindrnet_network import PRESETS, SwinDRNetwork
from benchmark.methods.network import Prediction, parameter_count
from benchmark.methods.weights import architecture_of

DATA = Path(__file__).resolve().parents[3] / "data"
SIDE = 224


def published_keys() -> dict[str, tuple[str, str]]:
    with (DATA / "swindrnet_released_state_dict.csv").open() as file:
        return {row["key"]: (row["shape"], row["kind"]) for row in csv.DictReader(file)}


def test_keys_and_shapes_are_the_published_ones():
    with torch.device("meta"):
        network = SwinDRNetwork()
    parameters = dict(network.named_parameters())
    found = {
        key: ("x".join(map(str, t.shape)), "parameter" if key in parameters else "buffer")
        for key, t in network.state_dict().items()
    }
    assert found == published_keys()
    assert len(found) == 650
    assert parameter_count(network) == 160_117_727
    assert architecture_of(found) == "SwinDRNet"


@pytest.mark.parametrize(
    ("preset", "settings", "count"),
    [("compact", {}, 11_541_595), ("published", {"fusion": "paper"}, 155_327_799)],
)
def test_sizes(preset, settings, count):
    from std_toolkit.plugins import configured

    with torch.device("meta"):
        assert parameter_count(SwinDRNetwork(configured(PRESETS[preset], settings))) == count


def known(key: str, shape: tuple[int, ...]) -> np.ndarray:
    """The weights of the known answer; see oracles of the field."""
    x = np.random.RandomState(crc32(key.encode())).standard_normal(shape).astype(np.float32)
    if key.endswith("running_var"):
        return 1 + np.float32(0.1) * abs(x)
    if key.endswith("running_mean"):
        return np.float32(0.1) * x
    if x.ndim <= 1:
        return 1 + np.float32(0.1) * x if key.endswith("weight") else np.float32(0.02) * x
    return (x / np.sqrt(np.prod(shape[1:]))).astype(np.float32)


def known_inputs() -> tuple[torch.Tensor, torch.Tensor]:
    color = np.random.RandomState(0).rand(1, 3, SIDE, SIDE).astype(np.float32)
    y, x = np.mgrid[:SIDE, :SIDE]
    depth = (0.5 + 0.3 * y / 223 + 0.05 * np.sin(x / 9)).astype(np.float32)
    depth[60:110, 80:150] = 0
    return torch.from_numpy(color), torch.from_numpy(depth)[None, None]


def assert_known(found: Prediction, tolerance: float = 1e-4) -> None:
    assert found.confidence is not None and found.initial is not None
    outputs = (found.depth, found.initial, found.confidence, 1 - found.confidence)
    with np.load(DATA / "swindrnet_released_oracle.npz") as oracle:
        for index, output in enumerate(outputs):
            expected = oracle[f"output_{index}"]
            assert expected.std() > 1e-3
            np.testing.assert_allclose(
                output[:, :, ::4, ::4].numpy(), expected, rtol=0, atol=tolerance
            )


@pytest.mark.slow
@torch.inference_mode()
def test_answers_are_the_published_ones():
    with torch.device("meta"):
        network = SwinDRNetwork().eval()
    weights = {
        key: torch.from_numpy(known(key, tuple(tensor.shape)))
        for key, tensor in network.state_dict().items()
        if tensor.is_floating_point()
    }
    counts = {k: torch.tensor(0) for k in network.state_dict() if k.endswith("batches_tracked")}
    index = {
        k: relative_index(7) for k in network.state_dict() if k.endswith("relative_position_index")
    }
    network.load_state_dict(weights | counts | index, assign=True)
    inputs = known_inputs()
    assert_known(network(*inputs))
    assert_known(FastSwinDRNetwork(network)(*inputs))  # the network is taken apart by that


@pytest.mark.parametrize(
    "name",
    ["swindrnet-released", "swindrnet-paper", "swindrnet-no-confidence", "swindrnet-no-fusion"],
)
@pytest.mark.parametrize(("batch", "size"), [(1, (224, 224)), (3, (96, 150))])
def test_the_faster_form_gives_the_same(name, batch, size):
    network = CASES[name].make().eval()
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.normal_(std=0.1)
                module.running_var.uniform_(0.5, 2)
                module.weight.uniform_(0.5, 1.5)
                module.bias.normal_(std=0.1)
    h, w = size
    color, depth = torch.rand(batch, 3, h, w), torch.rand(batch, 1, h, w)
    with torch.inference_mode():
        expected = network(color, depth)
        found = FastSwinDRNetwork(network)(color, depth)
    for one, other in zip(found, expected, strict=True):
        if other is None:
            assert one is None
        else:
            assert other.std() > 1e-5
            torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-6)


def idle(key: str) -> bool:
    """Parameters of the published attention, whose result the published program discards."""
    parts = ("qkv_branch", "proj_branch", "relative_position_bias_table_", "norm1_branch_2")
    return key.startswith("cross_attention") and any(part in key for part in parts)


@pytest.mark.parametrize("name", [n for n in CASES if n.startswith("swindrnet")])
def test_which_parameters_learn(name):
    """All, except in the published form: its attention and what only that would use do not."""
    case = CASES[name]
    network = replace(case, config=replace(case.config, drop_path=0.0, dropout=0.0)).make().train()
    # Of tokens of 8x8 pixels the last level is to have several, too.
    color, depth, truth = frames(2, 128 if case.config.details else 64)
    found = network(color, depth)
    (abs(found.depth - truth).mean() + abs(found.initial - truth).mean()).backward()
    still = {
        key
        for key, parameter in network.named_parameters()
        if parameter.grad is None or not parameter.grad.any()
    }
    expected = {key for key, _ in network.named_parameters() if idle(key)}
    assert bool(expected) == (case.config.fusion == "released")
    assert still == expected


def test_a_pixel_of_the_published_fusion_depends_on_no_other():
    fusion = CASES["swindrnet-released"].make().eval().cross_attention_0
    color, depth = torch.rand(1, 14, 14, 16), torch.rand(1, 14, 14, 16)
    with torch.inference_mode():
        before = fusion(color, depth)
        depth[0, 3, 4] += 1
        changed = (fusion(color, depth) != before).any(dim=-1)[0]
    assert changed.nonzero().tolist() == [[3, 4]]


def test_how_many_parameters_of_the_published_network_are_idle():
    with torch.device("meta"):
        network = SwinDRNetwork()
    parts = ("qkv_branch", "proj_branch", "relative_position_bias_table_")
    attention = sum(p.numel() for k, p in network.named_parameters() if any(q in k for q in parts))
    assert round(attention / 1e6, 2) == 6.28
