"""The two-branch baseline: its points, holes, scale, sizes, and that no part sees nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from network_cases import SIDE, frames

from benchmark.methods.depth.two_branch import (
    PRESETS,
    TwoBranchConfig,
    TwoBranchNetwork,
    on_grid,
    sampled,
)
from benchmark.methods.network import view_rays
from benchmark.methods.protocol import View
from benchmark.methods.registry import make_restorer
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera

CAMERA = Camera(SIDE, SIDE, 60.0, 62.0, 31.5, 30.5)
TINY = TwoBranchConfig(
    channels=16, depths=(1, 1, 1, 1), heads=(1, 1, 1, 1), head_channels=16, drop_path=0, dropout=0,
    input_size=(SIDE, SIDE), points=300, centres=(64, 32, 16, 8), neighbours=8, point_channels=16,
)  # fmt: skip


def _inputs(count=2):
    color, depth, _ = frames(count)
    views = [
        View(np.zeros((SIDE, SIDE, 3), np.uint8), np.zeros((SIDE, SIDE), np.float32), CAMERA)
    ] * count
    return color, depth, view_rays(views, depth)[0]


def _network(**changes):
    torch.manual_seed(0)
    return TwoBranchNetwork(replace(TINY, **changes)).eval()


def test_points_are_measured_pixels_in_the_camera():
    _, depth, rays = _inputs()
    depth = depth.clone()
    depth[0, :, :, :40] = 0
    points, places = sampled(depth, rays, TINY)
    assert points.shape == places.shape == (2, 300, 3)
    u = (CAMERA.fx * points[..., 0] / points[..., 2] + CAMERA.cx).round().long()
    v = (CAMERA.fy * points[..., 1] / points[..., 2] + CAMERA.cy).round().long()
    for k in range(2):
        torch.testing.assert_close(points[k, :, 2], depth[k, 0][v[k], u[k]])
        assert (points[k, :, 2] > 0).all()
    assert (u[0] >= 40).all() and len({*zip(u[0].tolist(), v[0].tolist(), strict=True)}) == 300
    torch.testing.assert_close(places[..., 0], points[..., 0] / points[..., 2])
    # Fewer than asked for: the first one fills the rest; none at all is no error.
    depth[0] = 0
    depth[0, 0, 5, 6] = 0.7
    points, _ = sampled(depth, rays, TINY)
    assert (points[0] == points[0, 0]).all() and points[0, 0, 2] == pytest.approx(0.7)
    depth[:] = 0
    assert torch.isfinite(sampled(depth, rays, TINY)[0]).all()


@pytest.mark.parametrize("relative", [False, True])
def test_each_branch_matters_and_holes_are_answered(relative):
    network = _network(relative=relative)
    torch.nn.init.normal_(network.decode_head_depth_restoration.conv_seg.weight)
    color, depth, rays = _inputs()
    depth = depth.clone()
    depth[:, :, 20:40, 20:40] = 0
    with torch.inference_mode():
        found = network(color, depth, rays)
        assert found.depth.shape == depth.shape and torch.isfinite(found.depth).all()
        moved = depth * torch.linspace(0.9, 1.1, SIDE)
        for other in (network(1 - color, depth, rays), network(color, moved, rays)):
            assert (other.initial - found.initial).abs().max() > 1e-4
        # One that has no depth at all has an answer, too.
        assert torch.isfinite(network(color, 0 * depth, rays).depth).all()
    confidence = found.confidence
    assert ((confidence >= 0) & (confidence <= 1)).all()
    if relative:
        assert (confidence[depth == 0] == 0).all()


def test_relative_depth_scales_with_the_scene():
    network = _network(relative=True)
    color, depth, rays = _inputs()
    with torch.inference_mode():
        near, far = network(color, depth, rays), network(color, 2 * depth, rays)
    torch.testing.assert_close(far.depth, 2 * near.depth, rtol=1e-3, atol=1e-4)


def test_tokens_have_the_features_of_points_beside_them():
    rays = _inputs(1)[2]
    # A point at the middle of each token of 16x16 pixels.
    corners = torch.tensor([7.5, 23.5, 39.5, 55.5])
    v, u = torch.meshgrid(corners, corners, indexing="ij")
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    places = torch.stack([x, y, 0 * x], dim=-1).reshape(1, -1, 3)
    numbers = torch.arange(16.0).reshape(1, 1, 16)
    found = on_grid(places, numbers, rays, (4, 4))
    torch.testing.assert_close(found.reshape(1, 1, 16), numbers, atol=1e-3, rtol=0)


def test_presets_and_missing_weights():
    with torch.device("meta"):
        network = TwoBranchNetwork(PRESETS["published"])
    swin = sum(p.numel() for n, p in network.named_parameters() if n.startswith("backbone"))
    assert swin == 27_520_698  # of the released SwinDRNet, one branch
    with pytest.raises(ToolkitError, match="weights"):
        make_restorer("two-branch")
