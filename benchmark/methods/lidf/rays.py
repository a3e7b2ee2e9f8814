"""The pixels that are predicted, what is known of their rays, and what is found on them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from benchmark.methods.lidf.voxels import Pairs


class Rays(NamedTuple):
    """Rays of pixels.

    Attributes:
        pixel: (r,) indices into the flat batch of images, in rising order.
        image: (r,) which image of the batch.
        direction: (r, 3) unit vectors.
        features: (r, c) of colour around the pixel, and of the direction.
    """

    pixel: Tensor
    image: Tensor
    direction: Tensor
    features: Tensor

    def chosen(self, which: Tensor | slice) -> Rays:
        """Some of them."""
        return Rays(*(part[which] for part in self))


class Terminations(NamedTuple):
    """What the first stage says of rays and of the voxels that they pass through.

    Attributes:
        rays: those predicted.
        pairs: of rays and voxels.
        log_probability: (p,) logarithms of the chance that the ray ends in the voxel; the chances
            of a ray add up to 1.
        offset: (p,) where in the voxel: 0 at the entry, 1 a voxel's diagonal behind it.
        points: (p, 3) metres, where the ray ends if it ends in the voxel.
        chosen: (r,) which pair each ray was taken to end in; -1 for one that passes no voxel.
        true: (r,) which pair the ray truly ends in; -1 where that is not known or none of them.
    """

    rays: Rays
    pairs: Pairs
    log_probability: Tensor
    offset: Tensor
    points: Tensor
    chosen: Tensor
    true: Tensor


class Refinements(NamedTuple):
    """What the second stage makes of the rays for which the first has an answer.

    Attributes:
        rays: those with an answer.
        points: (r, 3) metres: from the first stage, and after each step.
    """

    rays: Rays
    points: tuple[Tensor, ...]


def points_on(direction: Tensor, pairs: Pairs, offset: Tensor, diagonal: float) -> Tensor:
    """(p, 3) metres, the points at offsets within voxels.

    Args:
        direction: (r, 3) unit vectors of the rays.
        pairs: of rays and voxels.
        offset: (p,) from the entry into the voxel, in its diagonals.
        diagonal: metres, of a voxel.
    """
    return (pairs.entry + offset * diagonal)[:, None] * direction[pairs.ray]


def true_pairs(pairs: Pairs, distance: Tensor) -> Tensor:
    """(r,) which pair holds the point at a distance; -1 where none does.

    Args:
        pairs: of rays and voxels.
        distance: (r,) metres along the rays; 0 where it is not known.
    """
    at = distance[pairs.ray]
    holds = ((pairs.entry <= at) & (at < pairs.exit) & (at > 0)).nonzero().squeeze(1)
    found = torch.full_like(distance, -1, dtype=torch.long)
    found[pairs.ray[holds]] = holds
    return found
