"""How good a network is on frames that it was not trained on, and pictures of some."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND, Material
from benchmark.metrics.accumulate import DepthMetrics
from benchmark.running.panels import strip
from benchmark.training.module import network_inputs
from benchmark.training.packed_frames import PackedFrames
from std_toolkit.io.images import write_color

# Pixels that are compared, the most telling first: the score is of the first that there are.
SUBSETS = ("specular_transparent", "objects", "all")
SHOWN = ("rmse", "rel", "mae", "d105", "d110", "d125")
_PICTURES = 6


class Judge:
    """Validation at the size of training; missing depth counts as missed.

    Args:
        frames: packed frames.
        chosen: those to judge by.
        batch: frames that go through the network together.
    """

    def __init__(self, frames: PackedFrames, chosen: Sequence[int], batch: int) -> None:
        self.frames, self.chosen, self.batch = frames, tuple(chosen), batch

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
        mine = self.chosen[rank::world]
        was_training = network.training
        network.eval()
        try:
            for begin in range(0, len(mine), self.batch):
                batch = self.frames[list(mine[begin : begin + self.batch])]
                batch = {name: tensor.to(device) for name, tensor in batch.items()}
                with context():
                    found = network(*network_inputs(batch)).depth
                pixels = _subsets(batch)
                for name, metric in metrics.items():
                    metric.update(found[:, 0].float(), batch["true"], pixels[name])
        finally:
            network.train(was_training)
        return np.stack([metric.state for metric in metrics.values()])

    def gallery(self, network: nn.Module, device: torch.device, path: Path) -> None:
        """One picture of a few frames, evenly spread: colour, raw, restored, true, error."""
        count = min(_PICTURES, len(self.chosen))
        places = [(2 * k + 1) * len(self.chosen) // (2 * count) for k in range(count)]
        shown = [self.chosen[place] for place in places]
        batch = {name: tensor.to(device) for name, tensor in self.frames[shown].items()}
        was_training = network.training
        network.eval()
        with torch.no_grad():
            found = network(*network_inputs(batch)).depth[:, 0].float().cpu().numpy()
        network.train(was_training)
        rows = [strip(self.frames.frame(i), d) for i, d in zip(shown, found, strict=True)]
        write_color(path, np.vstack(rows), quality=88)


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


def _subsets(batch: dict[str, Tensor]) -> dict[str, Tensor]:
    """(b, h, w) bool pixels with ground truth, by subset."""
    known = batch["true"] > 0
    ids = batch["mask"].flatten(1).long()
    material = batch["materials"].gather(1, ids).reshape(batch["mask"].shape)
    hard = (material == int(Material.TRANSPARENT)) | (material == int(Material.SPECULAR))
    objects = batch["mask"] != BACKGROUND
    return {"specular_transparent": known & hard, "objects": known & objects, "all": known}
