"""DFNet: which depths it believes, and its sizes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from network_cases import CASES, frames

from benchmark.methods.depth.dfnet import PRESETS, DFNetConfig, DFNetwork, believable
from benchmark.methods.network import parameter_count


def test_sizes():
    with torch.device("meta"):
        assert parameter_count(DFNetwork()) == 1_251_279
        assert parameter_count(DFNetwork(PRESETS["compact"])) == 651_201


def test_every_parameter_learns():
    network = CASES["dfnet"].make().train()
    color, depth, truth = frames(2)
    abs(network(color, depth).depth - truth).mean().backward()
    for key, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), key


def test_depth_out_of_range_is_none():
    depth = torch.tensor([0.0, 0.29, 0.3, 1.0, 1.5, 1.51, 9.0]).reshape(1, 1, 1, 7)
    found = believable(depth, DFNetConfig()).flatten().tolist()
    assert found == pytest.approx([0, 0, 0.3, 1.0, 1.5, 0, 0])


def test_outliers_are_none_and_each_image_is_judged_by_itself():
    torch.manual_seed(0)
    usual = 0.5 + 0.001 * torch.randn(1, 1, 40, 40)
    odd = usual.clone()
    odd[0, 0, 3, 4] = 1.2
    both = torch.cat([odd, 0.6 + 0.4 * torch.rand(1, 1, 40, 40)])
    found = believable(both, DFNetConfig())
    assert found[0, 0, 3, 4] == 0
    assert (found[0] != both[0]).sum() == 1 and torch.equal(found[1], both[1])
    assert believable(odd, replace(DFNetConfig(), outlier=1000.0))[0, 0, 3, 4] == odd[0, 0, 3, 4]


def test_an_image_without_depth():
    assert not believable(torch.zeros(2, 1, 8, 8), DFNetConfig()).any()
    network = CASES["dfnet"].make().eval()
    with torch.inference_mode():
        assert network(torch.rand(1, 3, 64, 64), torch.zeros(1, 1, 64, 64)).depth.isfinite().all()


def test_raw_depth_reaches_every_level():
    """The sensor's depth goes into each block beside the features."""
    network = CASES["dfnet"].make().eval()
    seen = []
    for block in (network.skips[0], network.middle, network.decoders[0]):
        block.register_forward_hook(lambda _, inputs, __: seen.append(inputs[1]))
    depth = torch.full((1, 1, 64, 64), 0.7)
    with torch.inference_mode():
        network(torch.rand(1, 3, 64, 64), depth)
    assert [tuple(d.shape[-2:]) for d in seen] == [(64, 64), (4, 4), (64, 64)]
    assert all((d == 0.7).all() for d in seen)


@pytest.mark.parametrize("size", [(64, 64), (37, 50)])
def test_any_size(size):
    network = CASES["dfnet"].make().eval()
    with torch.inference_mode():
        found = network(torch.rand(2, 3, *size), torch.rand(2, 1, *size))
    assert found.depth.shape == (2, 1, *size)
