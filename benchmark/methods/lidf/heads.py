"""From the features of a ray in a voxel to one number."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import leaky_relu, linear

_SLOPE = 0.02
_SPREAD = 0.02  # standard deviation of untrained weights
_EMBEDDED = 16


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
        # Centimetres are told by this number: it has all digits, whatever the others have.
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
