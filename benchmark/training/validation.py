"""Validation on held-out frames: errors and pictures."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND, Material
from benchmark.evaluation.depth_panels import strip
from benchmark.metrics.depth.accumulate import DepthMetrics
from benchmark.metrics.depth.figures import NAMES
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import Batch, made_of, network_depth
from std_toolkit.io.images import write_color

# Pixels that are compared, the most telling first: the score is of the first that there are.
SUBSETS = ("specular_transparent", "objects", "all")
_PICTURES = 6

Context = Callable[[], AbstractContextManager[Any]]


class Validator(ABC):
    """How good a network is, as sums over frames that several processes can add up.

    Args:
        frames: packed frames.
        chosen: those to validate on.
        batch: frames that go through the network together.
        loss: the method's.
    """

    def __init__(
        self, frames: PackedFrames, chosen: Sequence[int], batch: int, loss: Any = None
    ) -> None:
        self.frames, self.chosen, self.batch, self.loss = frames, tuple(chosen), batch, loss

    @abstractmethod
    def zeros(self, network: nn.Module) -> np.ndarray:
        """float64 sums over no frame."""

    @abstractmethod
    def add(self, total: np.ndarray, network: nn.Module, batch: Batch, context: Context) -> None:
        """Add the sums of a batch to `total`; the network runs within `context()`."""

    @abstractmethod
    def scores(self, states: np.ndarray) -> dict[str, float]:
        """What summed states mean, by name; NaN for what is not known."""

    # Name of the score that networks are ranked by; lower is better.
    main: str

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        """Name and value of what networks are ranked by; infinite if it is not known."""
        value = scores[self.main]
        return self.main, math.inf if math.isnan(value) else value

    @abstractmethod
    def pictures(
        self, network: nn.Module, shown: Sequence[int], batch: Batch
    ) -> Sequence[np.ndarray]:
        """(h, w, 3) uint8 rows of the gallery, of the frames `shown`."""

    @torch.no_grad()
    def states(
        self,
        network: nn.Module,
        device: torch.device,
        *,
        rank: int = 0,
        world: int = 1,
        context: Context = nullcontext,
    ) -> np.ndarray:
        """Sums over this process's share of the frames; those of processes add."""
        total = self.zeros(network)
        own = self.chosen[rank::world]
        with evaluating(network):
            for begin in range(0, len(own), self.batch):
                batch = self.frames[list(own[begin : begin + self.batch])]
                self.add(total, network, {n: t.to(device) for n, t in batch.items()}, context)
        return total

    @torch.no_grad()
    def gallery(self, network: nn.Module, device: torch.device, path: Path) -> None:
        """Write one picture of a few frames, evenly spread."""
        count = min(_PICTURES, len(self.chosen))
        shown = [self.chosen[(2 * k + 1) * len(self.chosen) // (2 * count)] for k in range(count)]
        batch = {name: tensor.to(device) for name, tensor in self.frames[shown].items()}
        with evaluating(network):
            rows = self.pictures(network, shown, batch)
        write_color(path, np.vstack(rows), quality=88)


class DepthValidator(Validator):
    """Validation of depth at the size of training; missing depth counts as missed.

    The sums are of (subsets, n).

    Args:
        restore: (b, h, w) metres of a network and a batch.
    """

    def __init__(
        self, *args: Any, restore: Callable[[nn.Module, Batch], Tensor] = network_depth
    ) -> None:
        super().__init__(*args)
        self.restore = restore

    def zeros(self, network: nn.Module) -> np.ndarray:  # noqa: ARG002
        return np.stack([DepthMetrics().state] * len(SUBSETS))

    def add(self, total: np.ndarray, network: nn.Module, batch: Batch, context: Context) -> None:
        with context():
            found = self.restore(network, batch).float()
        pixels = _subsets(batch)
        for row, name in zip(total, SUBSETS, strict=True):
            metrics = DepthMetrics()
            metrics.merge_state(row)
            metrics.update(found, batch["true"], pixels[name])
            row[:] = metrics.state

    def scores(self, states: np.ndarray) -> dict[str, float]:
        return scores_of(states)

    def main_score(self, scores: dict[str, float]) -> tuple[str, float]:
        return main_score(scores)

    def pictures(
        self, network: nn.Module, shown: Sequence[int], batch: Batch
    ) -> Sequence[np.ndarray]:
        """Colour, raw, restored, true, error."""
        found = self.restore(network, batch).float().cpu().numpy()
        return [strip(self.frames.frame(i), d) for i, d in zip(shown, found, strict=True)]


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


def scores_of(states: np.ndarray) -> dict[str, float]:
    """`<subset>_<metric>` of summed states; NaN for a subset without pixels."""
    found: dict[str, float] = {}
    for name, state in zip(SUBSETS, states, strict=True):
        metrics = DepthMetrics()
        metrics.merge_state(state)
        means = metrics.compute()
        found |= {f"{name}_{metric}": means[metric] for metric in NAMES}
    return found


def main_score(scores: dict[str, float]) -> tuple[str, float]:
    """Name and value of what networks are ranked by: RMSE in metres; lower is better."""
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
