"""Depth relative to the mean of what was measured: its inverse, its scale, its digits."""

from __future__ import annotations

import pytest
import torch
from network_cases import CASES, frames

from benchmark.methods.relative import in_metres, mean_depth, relative_to


def test_relative_depth_by_hand():
    depth = torch.tensor([[[[0.0, 0.6], [0.8, 1.0]]], [[[0.0, 0.0], [0.0, 0.0]]]])
    mean = mean_depth(depth)
    torch.testing.assert_close(mean.flatten(), torch.tensor([0.8, 1.0]))
    told = relative_to(mean, depth)
    torch.testing.assert_close(told[0, 0], torch.tensor([[-5.0, -1.25], [0.0, 1.25]]))
    torch.testing.assert_close(told[1], torch.full((1, 2, 2), -5.0))
    torch.testing.assert_close(in_metres(mean, told), depth)


@pytest.mark.parametrize("name", ["swindrnet-relative", "nlspn-relative", "dfnet-relative"])
def test_a_scene_one_and_a_half_times_as_large_and_far_is_restored_so(name):
    network = CASES[name].make().eval()
    color, depth, _ = frames(2)
    depth = 0.5 * depth  # both within what DFNet believes
    with torch.inference_mode():
        near, far = network(color, depth).depth, network(color, 1.5 * depth).depth
    torch.testing.assert_close(far, 1.5 * near, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["swindrnet-paper", "swindrnet-relative", "nlspn", "dfnet"])
def test_narrowed_arithmetic_keeps_the_digits_of_depth(name):
    network = CASES[name].make().eval()
    color, depth, _ = frames(1)
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        found = network(color, depth).depth
    assert found.dtype == torch.float32
    # As bfloat16 would have it, every number is a multiple of 1 / 256 of its size or less.
    found = found[found != 0]  # NLSPN lets nothing below 0
    assert (found != found.bfloat16().float()).float().mean() > 0.9
