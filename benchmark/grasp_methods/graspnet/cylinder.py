"""The points in cylinders before and behind seeds, in the frames of grippers."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

# Numbers in memory at once, about; several tensors of this many are.
_AT_ONCE = 4_000_000


@torch.no_grad()
def group_cylinders(
    cloud: Tensor,
    seeds: Tensor,
    rotations: Tensor,
    *,
    radius: float,
    behind: float,
    ends: Sequence[float],
    count: int,
) -> Tensor:
    """Up to `count` points of each cylinder, the first ones of the cloud.

    Cylinders of one seed have a common axis, x of the gripper, and a common beginning. Where there
    are fewer points the first is repeated, which a maximum over them does not see.

    Args:
        cloud: (b, n, 3) metres, in any order that has nothing to do with place.
        seeds: (b, s, 3) points of the cloud.
        rotations: (b, s, 3, 3) of grippers; columns are their x, y and z.
        radius: metres.
        behind: metres before the seed where cylinders begin.
        ends: metres beyond the seed where they end.
        count: of points.

    Returns:
        (b, s, d, count, 3) metres from the seed along the gripper's axes.
    """
    b, n, _ = cloud.shape
    s = seeds.shape[1]
    at_once = max(1, _AT_ONCE // n)
    found = cloud.new_empty(b, s, len(ends), count, 3)
    for image in range(b):
        for begin in range(0, s, at_once):
            part = slice(begin, begin + at_once)
            own = rotations[image, part]
            # p R of all rotations in one product: (n, 3) (3, 3 r).
            turned = cloud[image] @ own.permute(1, 0, 2).reshape(3, -1)
            turned = turned.reshape(n, -1, 3).permute(1, 2, 0)
            origin = torch.einsum("rij,ri->rj", own, seeds[image, part])
            local = turned - origin[:, :, None]
            x, y, z = local.unbind(1)
            inside = (y * y + z * z < radius * radius) & (x > -behind)
            for k, end in enumerate(ends):
                index = _first(inside & (x < end), count)
                index = index[:, None].expand(-1, 3, -1)
                found[image, part, k] = local.gather(2, index).transpose(1, 2)
    return found


def _first(inside: Tensor, count: int) -> Tensor:
    """(r, count) columns of the first true values of each of (r, n) rows.

    The first one stands for those that there are not, and column 0 where there is none at all.
    """
    rank = inside.cumsum(1, dtype=torch.int32)
    row, column = (inside & (rank <= count)).nonzero(as_tuple=True)
    found = column.new_full((len(inside), count), -1)
    found[row, rank[row, column].long() - 1] = column
    return torch.where(found < 0, found[:, :1].clamp(min=0), found)
