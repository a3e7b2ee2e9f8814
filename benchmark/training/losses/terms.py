"""What a loss is given and what it answers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor

from benchmark.methods.network import Prediction

_LEAST = 1e-6  # so that no weight at all is no division by 0


class Target(NamedTuple):
    """What the network should have answered.

    Attributes:
        depth: (b, 1, h, w) true metres, 0 where there is no ground truth.
        foreground: (b, 1, h, w) bool pixels of objects.
        K: (b, 3, 3) intrinsics at this size.
        sensor: (b, 1, h, w) metres that the network was given, 0 = none; for losses that look at
            it.
    """

    depth: Tensor
    foreground: Tensor
    K: Tensor
    sensor: Tensor | None = None


class Loss(NamedTuple):
    """A loss and what it is made of.

    Attributes:
        total: scalar, what is minimised.
        parts: scalars without gradient by name, for logs.
    """

    total: Tensor
    parts: dict[str, Tensor]


class LossFunction(Protocol):
    """A loss of a batch."""

    def __call__(self, prediction: Prediction, target: Target) -> Loss: ...


def weighed(target: Target, objects: float) -> Tensor:
    """(b, 1, h, w) what each pixel counts: pixels of objects `objects` times as much as others."""
    return target.foreground.to(target.depth.dtype) * (objects - 1) + 1


def weighed_mean(values: Tensor, weights: Tensor, dim: tuple[int, ...] | None = None) -> Tensor:
    """Mean over `dim`, or over all, of finite values by their weights; 0 where none has any."""
    return (values * weights).sum(dim=dim) / weights.sum(dim=dim).clamp(min=_LEAST)


def mean_where(values: Tensor, where: Tensor) -> Tensor:
    """Mean over the pixels where `where` is true; 0, with a gradient of 0, where there is none."""
    # Products would make NaN of what is not finite and does not count.
    chosen = values.masked_fill(~where, 0.0)
    return chosen.sum() / where.sum().clamp(min=1)
