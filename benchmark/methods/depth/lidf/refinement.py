"""LIDF's prediction heads, and the second stage, which refines along the ray."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import leaky_relu, linear

from benchmark.methods.depth.lidf.features import POSITION_WAVES, PointNet, encoded, encoded_size
from benchmark.methods.depth.lidf.voxels import Grid, LIDFConfig, Rays, occupied

_DISTURBED = 0.8  # chance that a point is disturbed in training

# By how many metres, and how often among the disturbed.
_DISTURBANCES = ((-0.05, 0.0, 0.5), (0.0, 0.05, 0.3), (-0.1, -0.05, 0.1), (0.05, 0.1, 0.1))

_SLOPE = 0.02

_SPREAD = 0.02  # standard deviation of untrained weights

_EMBEDDED = 16


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


class Features(NamedTuple):
    """Features of pairs of a ray and a voxel. What is the same for many pairs is there once.

    Attributes:
        voxels: (v, cv), voxel: (p,) which of them a pair has.
        rays: (r, cr), ray: (p,) which of them a pair has.
        pairs: (p, cp).
    """

    voxels: Tensor
    voxel: Tensor
    rays: Tensor
    ray: Tensor
    pairs: Tensor

    def chosen(self, which: Tensor) -> Features:
        """Those of some pairs."""
        return Features(
            self.voxels, self.voxel[which], self.rays, self.ray[which], self.pairs[which]
        )


class Head(nn.Module):
    """A perceptron of four layers.

    Args:
        sizes: channels of a voxel, of a ray and of a pair.
        widths: of the layers.
        embedded: further channels of the first layer.
    """

    def __init__(
        self, sizes: tuple[int, int, int], widths: tuple[int, int, int], embedded: int = 0
    ) -> None:
        super().__init__()
        self.sizes = (*sizes, embedded)
        self.first = nn.Linear(sum(self.sizes), widths[0])
        self.second = nn.Linear(widths[0], widths[1])
        self.third = nn.Linear(widths[1], widths[2])
        self.last = nn.Linear(widths[2], 1)
        for layer in (self.first, self.second, self.third, self.last):
            _begin(layer)

    def forward(self, features: Features) -> Tensor:
        """(p,) numbers."""
        return self.rest(self.begin(features))

    def begin(self, features: Features) -> Tensor:
        """The first layer without what is embedded: the sum of the parts of its product.

        The parts of voxels and of rays are multiplied once, not for every pair: of 385 inputs 102
        are a pair's own.
        """
        of_voxels, of_rays, of_pairs, _ = self.first.weight.split(self.sizes, dim=1)
        total = linear(features.pairs, of_pairs, self.first.bias)
        total = total + linear(features.rays, of_rays)[features.ray]
        return total + linear(features.voxels, of_voxels)[features.voxel]

    def rest(self, first: Tensor) -> Tensor:
        """(p,) numbers from the first layer's sums."""
        inner = leaky_relu(self.second(leaky_relu(first, _SLOPE)), _SLOPE)
        inner = leaky_relu(self.third(inner), _SLOPE)
        # This number decides centimetres: it keeps full precision whatever the others have.
        with torch.autocast(inner.device.type, enabled=False):
            return self.last(inner.float()).squeeze(1)


class OffsetHead(Head):
    """A number in [0, 1], improved some times from what it was.

    Args:
        sizes, widths: as of `Head`.
        start: the number to begin with.
        iterations: how often it is improved.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        widths: tuple[int, int, int],
        start: float = 0.001,
        iterations: int = 2,
    ) -> None:
        super().__init__(sizes, widths, _EMBEDDED)
        self.embed = nn.Linear(1, _EMBEDDED)
        _begin(self.embed)
        self.start, self.iterations = start, iterations

    def forward(self, features: Features) -> Tensor:
        """(p,) numbers, which may lie outside [0, 1] a little."""
        fixed = self.begin(features)
        of_embedded = self.first.weight[:, -_EMBEDDED:]
        number = features.pairs.new_full((len(features.pairs),), self.start, dtype=torch.float32)
        for _ in range(self.iterations):
            first = fixed + linear(self.embed(number[:, None]), of_embedded)
            number = number + self.rest(first)
        return leaky_clip(number)


def leaky_clip(numbers: Tensor) -> Tensor:
    """Numbers in [0, 1] as they are; beyond, a hundredth of how far they lie beyond."""
    return numbers.minimum(0.01 * numbers + 0.99).maximum(0.01 * numbers)


def _begin(layer: nn.Linear) -> None:
    nn.init.normal_(layer.weight, std=_SPREAD)
    nn.init.zeros_(layer.bias)
