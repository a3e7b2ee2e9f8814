"""What the measurements in a voxel say: a small PointNet (Qi et al., CVPR 2017) in two stages."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import relu

from benchmark.methods.lidf.scatter import largest_of_groups

_INPUTS = 6  # x, y, z from the voxel's centre, and colour


class PointNet(nn.Module):
    """Features of voxels from their points.

    Args:
        channels: of the first layer; a voxel gets four times as many.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        c = channels
        self.one = nn.Sequential(nn.Linear(_INPUTS, c), nn.ReLU(), nn.Linear(c, 2 * c), nn.ReLU())
        self.of_voxel = nn.Linear(2 * c, 2 * c)
        self.two = nn.Sequential(
            nn.Linear(4 * c, 4 * c), nn.ReLU(), nn.Linear(4 * c, 4 * c), nn.ReLU()
        )
        self.last = nn.Linear(4 * c, 4 * c)

    def forward(self, points: Tensor, voxel: Tensor, count: int) -> Tensor:
        """(count, 4 channels) features.

        Args:
            points: (n, 6) x, y, z from the centre of the voxel, colour.
            voxel: (n,) which voxel each is in.
            count: voxels.
        """
        each = self.one(points)
        together = relu(self.of_voxel(largest_of_groups(each, voxel, count)))
        each = self.two(torch.cat([each, together[voxel]], dim=1))
        return relu(self.last(largest_of_groups(each, voxel, count)))
