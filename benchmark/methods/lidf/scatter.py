"""Values that belong to groups: the largest of each group, softmax over each group."""

from __future__ import annotations

import torch
from torch import Tensor


def largest_of_groups(values: Tensor, group: Tensor, count: int) -> Tensor:
    """The largest value of each group, channel by channel.

    Args:
        values: (n, c).
        group: (n,) int64 in [0, count).
        count: groups.

    Returns:
        (count, c); 0 for a group without members.
    """
    found = values.new_zeros(count, values.shape[1])
    index = group[:, None].expand_as(values)
    return found.scatter_reduce(0, index, values, "amax", include_self=False)


def log_softmax_of_groups(logits: Tensor, group: Tensor, count: int) -> Tensor:
    """(n,) logarithms of shares; the shares of each group add up to 1."""
    top = logits.new_full((count,), -torch.inf)
    top = top.scatter_reduce(0, group, logits.detach(), "amax")
    apart = logits - top[group]  # at most 0: the exponential stays finite
    total = logits.new_zeros(count).index_add(0, group, apart.exp())
    return apart - total[group].log()


def first_largest_of_groups(values: Tensor, group: Tensor, count: int) -> Tensor:
    """(count,) index of each group's first largest value; -1 for a group without members."""
    top = values.new_full((count,), -torch.inf).scatter_reduce(0, group, values, "amax")
    at = (values == top[group]).nonzero().squeeze(1)
    none = len(values)
    first = at.new_full((count,), none).scatter_reduce(0, group[at], at, "amin")
    return torch.where(first < none, first, -1)
