"""Choosing points that are spread over a set."""

from __future__ import annotations

import torch
from torch import Tensor

from std_toolkit.errors import ToolkitError


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
