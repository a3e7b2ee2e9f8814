"""Depth relative to what was measured: its inverse, its scale, its holes, its digits."""

from __future__ import annotations

import pytest
import torch
from network_cases import CASES, frames

from benchmark.methods.relative_depth import (
    coarse_depth,
    in_metres,
    mean_depth,
    network_depth,
    relative_color,
    relative_to,
)


def test_relative_depth_by_hand():
    depth = torch.tensor([[[[0.0, 0.6], [0.8, 1.0]]], [[[0.0, 0.0], [0.0, 0.0]]]])
    mean = mean_depth(depth)
    torch.testing.assert_close(mean.flatten(), torch.tensor([0.8, 1.0]))
    told = relative_to(mean, depth)
    torch.testing.assert_close(told[0, 0], torch.tensor([[-5.0, -1.25], [0.0, 1.25]]))
    torch.testing.assert_close(told[1], torch.full((1, 2, 2), -5.0))
    torch.testing.assert_close(in_metres(mean, told), depth)


def test_coarse_depth_of_a_plane_is_the_plane_and_holes_are_filled_from_around():
    v, u = torch.meshgrid(torch.arange(64.0), torch.arange(96.0), indexing="ij")
    plane = (0.6 + 0.002 * u + 0.001 * v)[None, None]
    inner = (..., slice(2, -2), slice(2, -2))
    torch.testing.assert_close(coarse_depth(plane)[inner], plane[inner])
    holed = plane.clone()
    holed[..., 30:36, 40:48] = 0
    # At most half of the hole's size away from the plane, where it is steepest.
    assert (coarse_depth(holed) - plane)[inner].abs().max() < 0.002 * 6 + 0.001 * 4


def test_coarse_depth_is_a_mean_of_what_was_measured():
    depth = torch.zeros(2, 1, 13, 10)
    depth[0, 0, 3, 2], depth[0, 0, 12, 9] = 0.5, 0.9
    found = coarse_depth(depth)
    assert found.shape == depth.shape
    torch.testing.assert_close(found[0, 0, 0, 0], torch.tensor(0.5))
    torch.testing.assert_close(found[0, 0, 12, 9], torch.tensor(0.9))
    assert found[0].min() >= 0.5 - 1e-6 and found[0].max() <= 0.9 + 1e-6
    torch.testing.assert_close(found[1], torch.ones(1, 13, 10))
    torch.testing.assert_close(coarse_depth(3 * depth)[0], 3 * found[0])


def test_one_wrong_match_does_not_fill_a_hole():
    depth = torch.full((1, 1, 32, 32), 0.7)
    depth[..., 8:24, 8:24] = 0
    depth[..., 16, 16] = 9.0
    torch.testing.assert_close(coarse_depth(depth), torch.full_like(depth, 0.7))
    told = network_depth(depth)
    assert told[..., 16, 16] == told.max() and told.max() < 7.5 + 1e-4
    assert told[..., 12, 12] == -5


def test_colour_is_told_by_what_differs_from_the_mean():
    color = torch.full((1, 3, 8, 8), 0.4)
    color[:, 1, 2, 3] += 0.5
    told = relative_color(color)
    torch.testing.assert_close(told.mean(dim=(2, 3)), torch.zeros(1, 3), atol=1e-6, rtol=0)
    torch.testing.assert_close(told[0, 1, 2, 3], torch.tensor(0.5 * 63 / 64 / 0.25))
    torch.testing.assert_close(relative_color(color + 0.1), told)


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
