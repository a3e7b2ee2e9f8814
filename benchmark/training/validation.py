"""How good a network is on frames that it was not trained on, and pictures of some."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND, Material
from benchmark.evaluation.depth_panels import strip
from benchmark.metrics.depth.accumulate import DepthMetrics
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import Batch, made_of, network_depth
from std_toolkit.io.images import write_color

# Pixels that are compared, the most telling first: the score is of the first that there are.
SUBSETS = ("specular_transparent", "objects", "all")
SHOWN = ("rmse", "rel", "mae", "d105", "d110", "d125")
_PICTURES = 6


class Validator(Protocol):
    """How good a network is, as sums over frames that several processes can add up."""

    def states(
        self,
        network: nn.Module,
        device: torch.device,
        *,
        rank: int = 0,
        world: int = 1,
        context: Callable[[], AbstractContextManager[Any]] = nullcontext,
    ) -> np.ndarray:
        """float64 sums over this process's share of the frames; those of processes add."""
        ...

    def scores(self, states: np.ndarray) -> dict[str, float]:
        """What summed states mean, by name; NaN for what is not known."""
        ...

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        """Name and value of what networks are ranked by, the less the better."""
        ...

    def gallery(self, network: nn.Module, device: torch.device, path: Path) -> None:
        """Write a picture of a few frames."""
        ...


class DepthValidator:
    """Validation of depth at the size of training; missing depth counts as missed.

    Args:
        frames: packed frames.
        chosen: those to judge by.
        batch: frames that go through the network together.
        loss: the method's, which does not matter here.
        restore: (b, h, w) metres of a network and a batch.
    """

    def __init__(
        self,
        frames: PackedFrames,
        chosen: Sequence[int],
        batch: int,
        loss: Any = None,  # noqa: ARG002
        *,
        restore: Callable[[nn.Module, Batch], Tensor] = network_depth,
    ) -> None:
        self.frames, self.chosen, self.batch = frames, tuple(chosen), batch
        self.restore = restore

    def scores(self, states: np.ndarray) -> dict[str, float]:
        return scores_of(states)

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        return main_score(scores)

    @torch.no_grad()
    def states(
        self,
        network: nn.Module,
        device: torch.device,
        *,
        rank: int = 0,
        world: int = 1,
        context: Callable[[], AbstractContextManager[Any]] = nullcontext,
    ) -> np.ndarray:
        """(subsets, n) sums over this process's share of the frames; those of processes add."""
        metrics = {name: DepthMetrics() for name in SUBSETS}
        with evaluating(network):
            for batch in batches(self.frames, self.chosen[rank::world], self.batch, device):
                with context():
                    found = self.restore(network, batch)
                pixels = _subsets(batch)
                for name, metric in metrics.items():
                    metric.update(found.float(), batch["true"], pixels[name])
        return np.stack([metric.state for metric in metrics.values()])

    def gallery(self, network: nn.Module, device: torch.device, path: Path) -> None:
        """One picture of a few frames, evenly spread: colour, raw, restored, true, error."""
        shown = shown_of(self.chosen)
        batch = {name: tensor.to(device) for name, tensor in self.frames[shown].items()}
        with evaluating(network), torch.no_grad():
            found = self.restore(network, batch).float().cpu().numpy()
        rows = [strip(self.frames.frame(i), d) for i, d in zip(shown, found, strict=True)]
        write_color(path, np.vstack(rows), quality=88)


@contextmanager
def evaluating(network: nn.Module) -> Iterator[None]:
    """The network in evaluation mode, and every part of it as it was afterwards."""
    modes = [(module, module.training) for module in network.modules()]
    network.eval()
    try:
        yield
    finally:
        for module, training in modes:
            module.training = training


def batches(
    frames: PackedFrames, chosen: Sequence[int], size: int, device: torch.device
) -> Iterator[dict[str, Tensor]]:
    """Batches of the chosen frames, in their order, on a device."""
    for begin in range(0, len(chosen), size):
        batch = frames[list(chosen[begin : begin + size])]
        yield {name: tensor.to(device) for name, tensor in batch.items()}


def shown_of(chosen: Sequence[int]) -> list[int]:
    """A few frames for a picture, evenly spread."""
    count = min(_PICTURES, len(chosen))
    return [chosen[(2 * k + 1) * len(chosen) // (2 * count)] for k in range(count)]


def scores_of(states: np.ndarray) -> dict[str, float]:
    """`<subset>_<metric>` of summed states; NaN for a subset without pixels."""
    found: dict[str, float] = {}
    for name, state in zip(SUBSETS, states, strict=True):
        metrics = DepthMetrics()
        metrics.merge_state(state)
        means = metrics.compute()
        found |= {f"{name}_{metric}": means[metric] for metric in SHOWN}
    return found


def main_score(scores: dict[str, float]) -> tuple[str, float]:
    """Name and value of what networks are ranked by: RMSE in metres, the less the better."""
    for name in SUBSETS:
        value = scores[f"{name}_rmse"]
        if not math.isnan(value):
            return f"{name}_rmse", value
    return "all_rmse", math.inf


def _subsets(batch: Batch) -> dict[str, Tensor]:
    """(b, h, w) bool pixels with ground truth, by subset."""
    known = batch["true"] > 0
    hard = made_of(batch, Material.TRANSPARENT, Material.SPECULAR)
    objects = batch["mask"] != BACKGROUND
    return {"specular_transparent": known & hard, "objects": known & objects, "all": known}
