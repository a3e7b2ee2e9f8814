"""Chamfer distance of two point sets."""

from __future__ import annotations

from torch import Tensor

from benchmark.methods.pointnet.grouping import at, nearest


def one_way(points: Tensor, others: Tensor) -> Tensor:
    """(b, n) squared distance from each point to the nearest of the others, with gradient to both.

    Args:
        points: (b, n, 3).
        others: (b, m, 3).
    """
    index = nearest(others.detach(), points.detach(), 1)[1][..., 0]
    return (points - at(others.transpose(1, 2), index).transpose(1, 2)).square().sum(dim=2)


def chamfer(a: Tensor, b: Tensor) -> Tensor:
    """(batch,) mean squared distances to the nearest point, from a to b and from b to a, added."""
    return one_way(a, b).mean(dim=1) + one_way(b, a).mean(dim=1)
