"""LIDF's second stage: moves a predicted point along its ray."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from benchmark.methods.lidf.config import LIDFConfig
from benchmark.methods.lidf.encoding import POSITION_WAVES, encoded, encoded_size
from benchmark.methods.lidf.heads import Features, OffsetHead
from benchmark.methods.lidf.points import PointNet
from benchmark.methods.lidf.rays import Rays
from benchmark.methods.lidf.voxels import Grid, occupied

_DISTURBED = 0.8  # chance that a point is disturbed in training
# By how many metres, and how often among the disturbed.
_DISTURBANCES = ((-0.05, 0.0, 0.5), (0.0, 0.05, 0.3), (-0.1, -0.05, 0.1), (0.05, 0.1, 0.1))


class Refinement(nn.Module):
    """Moves points by some centimetres, some times in sequence.

    Every step looks at the voxel that the point is in, among the measurements there and the other
    predicted points. It begins, untrained, by moving nothing.

    Args:
        config: sizes, and how far a step reaches.
        ray_size: features of a ray.
    """

    def __init__(self, config: LIDFConfig, ray_size: int) -> None:
        super().__init__()
        self.grid = Grid(config)
        self.reach, self.steps = config.refine_reach, config.refine_steps
        self.rays_at_once = config.rays_at_once
        self.points = PointNet(config.point_channels)
        sizes = (4 * config.point_channels, ray_size, encoded_size(POSITION_WAVES))
        self.offset = OffsetHead(sizes, config.head, start=0.5)

    def forward(
        self, start: Tensor, rays: Rays, color: Tensor, measured: tuple[Tensor, Tensor, Tensor]
    ) -> list[Tensor]:
        """The points after each step, the first of which is `start`, disturbed in training.

        Args:
            start: (r, 3) metres.
            rays: of the points.
            color: (r, 3) of their pixels.
            measured: points (n, 3), colour (n, 3) and image (n,) of measurements.
        """
        if self.training:
            start = start + disturbances(len(start), start.device)[:, None] * rays.direction
        points = [start]
        for _ in range(self.steps):
            points.append(self._moved(points[-1], rays, color, measured))
        return points

    def _moved(
        self, points: Tensor, rays: Rays, color: Tensor, measured: tuple[Tensor, Tensor, Tensor]
    ) -> Tensor:
        everything = torch.cat([measured[0], points])
        image = torch.cat([measured[2], rays.image])
        voxels, voxel = occupied(self.grid, everything.detach(), image)
        apart = everything - (voxels.corner + self.grid.side / 2)[voxel]
        colored = torch.cat([apart, torch.cat([measured[1], color])], dim=1)
        features = self.points(colored, voxel, len(voxels.image))
        own = voxel[len(measured[0]) :]
        moves = []
        for begin in range(0, len(points), self.rays_at_once):
            part = slice(begin, begin + self.rays_at_once)
            at = encoded(points[part], POSITION_WAVES)
            ray = torch.arange(len(at), device=at.device)
            numbers = self.offset(Features(features, own[part], rays.features[part], ray, at))
            moves.append((2 * numbers - 1) * self.reach)
        if not moves:
            return points
        return points + torch.cat(moves)[:, None] * rays.direction


def disturbances(count: int, device: torch.device) -> Tensor:
    """(count,) metres by which points are moved along their rays, to learn to move them back."""
    low, high, share = torch.tensor(_DISTURBANCES, device=device).unbind(dim=1)
    kind = torch.multinomial(share, count, replacement=True) if count else share.new_zeros(0).long()
    amount = low[kind] + torch.rand(count, device=device) * (high - low)[kind]
    return torch.where(torch.rand(count, device=device) < _DISTURBED, amount, 0.0)
