"""Farthest-point sampling, neighbourhoods of points, Chamfer distance."""

import torch
from torch import Tensor

from std_toolkit.errors import ToolkitError

# Distances that are in memory at once: 16 MB of them.
_PAIRS = 1 << 22


def at(values: Tensor, index: Tensor) -> Tensor:
    """(b, c, *shape) of (b, c, n) features at (b, *shape) indices."""
    b, c, _ = values.shape
    flat = index.reshape(b, 1, -1).expand(b, c, -1)
    return values.gather(2, flat).reshape(b, c, *index.shape[1:])


@torch.no_grad()
def ball_query(points: Tensor, centres: Tensor, radius: float, count: int) -> Tensor:
    """(b, m, count) indices of points nearer to a centre than `radius`.

    They are the first of them in the order of the set, so that a set in random order gives a random
    choice; where they are fewer than `count` the first of them fills the rest, and where there is
    none, the point that is nearest.

    Args:
        points: (b, n, 3).
        centres: (b, m, 3).
        radius: in the unit of the points.
        count: of neighbours; may exceed n.
    """
    n = points.shape[1]
    order = torch.arange(n, dtype=torch.int32, device=points.device)
    found = []
    for some in centres.split(_rows(points), dim=1):
        squared = _squared_distances(some, points)
        # Of what is out of reach the number is n, behind all others.
        number = torch.where(squared < radius**2, order, n)
        # topk sorts only what it keeps.
        first = number.topk(min(count, n), dim=2, largest=False, sorted=True).values.long()
        begin = torch.where(first[..., :1] < n, first[..., :1], squared.argmin(2, keepdim=True))
        first = torch.where(first < n, first, begin)
        found.append(torch.cat([first, begin.expand(-1, -1, count - first.shape[2])], dim=2))
    return torch.cat(found, dim=1)


@torch.no_grad()
def nearest(points: Tensor, centres: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """(b, m, count) squared distances and indices of the nearest points, the nearest first.

    Raises:
        ToolkitError: there are fewer points than `count`.
    """
    if points.shape[1] < count:
        raise ToolkitError(f"{count} nearest of {points.shape[1]} points")
    found = [
        _squared_distances(some, points).topk(count, dim=2, largest=False, sorted=True)
        for some in centres.split(_rows(points), dim=1)
    ]
    return torch.cat([f.values for f in found], 1), torch.cat([f.indices for f in found], 1)


def group(
    points: Tensor,
    centres: Tensor,
    features: Tensor | None,
    index: Tensor,
    *,
    scale: float = 1.0,
) -> Tensor:
    """(b, 3 + c, m, k) neighbours' places relative to their centre, and their features.

    Args:
        points: (b, n, 3).
        centres: (b, m, 3).
        features: (b, c, n) or None for places alone.
        index: (b, m, k) of the neighbours.
        scale: what relative places are divided by, such as the radius.
    """
    apart = (at(points.transpose(1, 2), index) - centres.transpose(1, 2)[..., None]) / scale
    return apart if features is None else torch.cat([apart, at(features, index)], dim=1)


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    # Differences, not a product of matrices: of points a metre from the origin and a millimetre
    # apart that would leave nothing but rounding.
    a, b = a.float(), b.float()
    total = (a[:, :, None, 0] - b[:, None, :, 0]).square_()
    for axis in (1, 2):
        total += (a[:, :, None, axis] - b[:, None, :, axis]).square_()
    return total


def _rows(points: Tensor) -> int:
    """Centres whose distances to all points are in memory at once."""
    return max(1, _PAIRS // max(1, points.shape[0] * points.shape[1]))


@torch.no_grad()
def farthest_points(points: Tensor, count: int) -> Tensor:
    """(b, count) indices of points, each the farthest from those chosen before it.

    The first is point 0; of equally far points the first is chosen. `count` steps of O(n) each.

    Args:
        points: (b, n, 3).
        count: 1 to n.

    Raises:
        ToolkitError: more points are asked for than there are.
    """
    b, n, _ = points.shape
    if not 1 <= count <= n:
        raise ToolkitError(f"{count} points of {n} cannot be chosen")
    # Coordinates one after the other: three short passes instead of one over strided memory.
    axes = points.detach().float().permute(2, 0, 1).contiguous()
    left = torch.full((b, n), torch.inf, device=points.device)
    chosen = torch.zeros(b, count, dtype=torch.long, device=points.device)
    newest = chosen[:, :1]
    for step in range(1, count):
        away = [axis - axis.gather(1, newest) for axis in axes]
        squared = away[0].square() + away[1].square() + away[2].square()
        left = torch.minimum(left, squared)
        newest = left.argmax(dim=1, keepdim=True)
        chosen[:, step] = newest[:, 0]
    return chosen


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
