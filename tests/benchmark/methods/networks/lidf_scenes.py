"""LIDF at a small size, and images with rays for it."""

from __future__ import annotations

import torch
from network_cases import SIDE, frames
from torch import Tensor

from benchmark.methods.depth.lidf.lidf import LIDFNetwork
from benchmark.methods.depth.lidf.voxels import LIDFConfig

TINY = LIDFConfig(
    channels=8,
    blocks=(1, 1, 1, 1),
    color_features=8,
    point_channels=8,
    head=(32, 16, 8),
    rays_at_once=1000,
    input_size=(SIDE, SIDE),
)
SETTINGS = {
    "channels": "8",
    "blocks": "1,1,1,1",
    "color_features": "8",
    "point_channels": "8",
    "head": "32,16,8",
    "rays_at_once": "1000",
    "input_size": f"{SIDE},{SIDE}",
}


def tiny(seed: int = 0, config: LIDFConfig = TINY) -> LIDFNetwork:
    """Its untrained heads all but ignore their inputs; let them answer something."""
    torch.manual_seed(seed)
    network = LIDFNetwork(config)
    for name, parameter in network.named_parameters():
        if parameter.ndim == 2 and ("offset" in name or "termination" in name):
            torch.nn.init.kaiming_normal_(parameter)
    return network


def pixel_rays_of(h: int, w: int, focal: float = 0.9) -> Tensor:
    """(1, 3, h, w) points at z = 1 of a camera of that focal length in image widths."""
    y, x = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
    f = focal * w
    return torch.stack([(x - w / 2 + 0.5) / f, (y - h / 2 + 0.5) / f, torch.ones(h, w)])[None]


def scene(count: int, side: int = SIDE, seed: int = 0) -> tuple[tuple[Tensor, ...], Tensor]:
    """What the network is called with, asking for what the sensor misses; and the true depth."""
    color, depth, truth = frames(count, side, seed)
    rays = pixel_rays_of(side, side).expand(count, -1, -1, -1)
    believed = (depth > 0) & ((depth - truth).abs() < 1e-6)
    return (color, depth, rays, believed, ~believed), truth
