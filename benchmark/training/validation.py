"""Validation on held-out frames: errors and pictures."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmark.data.frame import BACKGROUND, Material
from benchmark.evaluation.depth_panels import strip
from benchmark.evaluation.probes import with_nearest
from benchmark.metrics.depth import harm, holes
from benchmark.metrics.depth.accumulate import DepthMetrics
from benchmark.metrics.depth.figures import NAMES
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import Batch, made_of, network_depth
from std_toolkit.io.images import write_color
from std_toolkit.settings import Settings, limit

# Pixels that are compared, the most telling first: the score is of the first that there are.
SUBSETS = ("specular_transparent", "objects", "all")
_PICTURES = 6

# What a user sees of the other pixels; see `benchmark.evaluation.probes`.
SEEN = (*harm.NAMES, *(column.name for column in holes.COLUMNS))

RANKED = "ranked_rmse"


@dataclass(frozen=True, kw_only=True)
class RankSettings(Settings):
    """Harm and holes that cost a network nothing when the best weights are chosen."""

    harm: float = limit(0.01, source="what std-restore may spoil of good depth, in any place")
    """largest share of right pixels harmed"""
    holes: float = limit(1.5, source="what std-restore may be worse than the nearest pixel")
    """largest error in cut holes, times that of `nearest`"""


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
        with evaluating(network):
            for batch in self.batches(self.chosen[rank::world]):
                self.add(total, network, {n: t.to(device) for n, t in batch.items()}, context)
        return total

    def batches(self, frames: Sequence[int]) -> Iterator[Batch]:
        """These of the frames, some at a time."""
        for begin in range(0, len(frames), self.batch):
            yield self.frames[list(frames[begin : begin + self.batch])]

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

    The network's own map is judged, before `std-restore` keeps what the sensor has. The sums are
    of each subset (`DepthMetrics`), then sum and count of each of `SEEN`.

    Args:
        restore: (b, h, w) metres of a network and a batch.
    """

    def __init__(
        self, *args: Any, restore: Callable[[nn.Module, Batch], Tensor] = network_depth
    ) -> None:
        super().__init__(*args)
        self.restore = restore

    def zeros(self, network: nn.Module) -> np.ndarray:  # noqa: ARG002
        return np.zeros(len(SUBSETS) * len(DepthMetrics().state) + 2 * len(SEEN))

    def add(self, total: np.ndarray, network: nn.Module, batch: Batch, context: Context) -> None:
        with context():
            found = self.restore(network, batch).float()
        pixels = _subsets(batch)
        rows, seen = _parts(total)
        for row, name in zip(rows, SUBSETS, strict=True):
            metrics = DepthMetrics()
            metrics.merge_state(row)
            metrics.update(found, batch["true"], pixels[name])
            row[:] = metrics.state
        for figures in self._seen(network, batch, found, context):
            values = np.array([figures.get(name, math.nan) for name in SEEN])
            known = np.isfinite(values)
            seen[0, known] += values[known]
            seen[1] += known

    def _seen(
        self, network: nn.Module, batch: Batch, found: Tensor, context: Context
    ) -> Iterator[dict[str, float]]:
        """Figures of `SEEN` of each frame; the network runs once more, with holes."""
        raw, true = (batch[name].float().cpu().numpy() for name in ("raw", "true"))
        clear = made_of(batch, Material.TRANSPARENT, Material.SPECULAR).cpu().numpy()
        objects = (batch["mask"] != BACKGROUND).cpu().numpy()
        keys = [self.frames.key(i) for i in batch["index"].tolist()]
        cuts = [
            holes.cut_holes(raw[i], key, true=true[i], avoid=clear[i]) for i, key in enumerate(keys)
        ]
        cut = np.stack([raw[i] if c is None else c.cut for i, c in enumerate(cuts)])
        holed = {**batch, "raw": torch.from_numpy(cut).to(batch["raw"])}
        with context():
            again = self.restore(network, holed).float().cpu().numpy()
        for i, depth in enumerate(found.cpu().numpy()):
            figures = harm.harm_by_region(depth, raw[i], true[i], clear[i], objects[i])
            one = cuts[i]
            yield figures if one is None else figures | with_nearest(one, again[i])

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


def _parts(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Views of the sums of `DepthValidator`: (subsets, n), and (2, figures) of `SEEN`."""
    count = 2 * len(SEEN)
    return states[:-count].reshape(len(SUBSETS), -1), states[-count:].reshape(2, -1)


def scores_of(states: np.ndarray) -> dict[str, float]:
    """`<subset>_<metric>`, figures of `SEEN` and `RANKED` of summed states; NaN without pixels."""
    found: dict[str, float] = {}
    rows, seen = _parts(states)
    for name, state in zip(SUBSETS, rows, strict=True):
        metrics = DepthMetrics()
        metrics.merge_state(state)
        means = metrics.compute()
        found |= {f"{name}_{metric}": means[metric] for metric in NAMES}
    with np.errstate(invalid="ignore"):
        found |= dict(zip(SEEN, (seen[0] / seen[1]).tolist(), strict=True))
    ranked = main_score(found)[1]
    return found | {RANKED: ranked if math.isfinite(ranked) else math.nan}


def main_score(scores: dict[str, float]) -> tuple[str, float]:
    """Name and value of what networks are ranked by; lower is better.

    RMSE in metres, of the first of `SUBSETS` that there is, times how far the worst harm and the
    error in cut holes exceed `RankSettings`: a network that raises what is doubtful has the
    smaller error on glass, and pays for it here.
    """
    limits = RankSettings.current()
    rmse = next((v for name in SUBSETS if not math.isnan(v := scores[f"{name}_rmse"])), math.inf)
    worst = max((scores[n] for n in harm.NAMES if not math.isnan(scores[n])), default=0.0)
    factor = max(1.0, worst / limits.harm)
    allowed = limits.holes * scores["holes_nearest"]
    if allowed > 0:  # not NaN
        factor *= max(1.0, scores["holes"] / allowed)
    return RANKED, rmse * factor


def _subsets(batch: Batch) -> dict[str, Tensor]:
    """(b, h, w) bool pixels with ground truth, by subset."""
    known = batch["true"] > 0
    hard = made_of(batch, Material.TRANSPARENT, Material.SPECULAR)
    objects = batch["mask"] != BACKGROUND
    return {"specular_transparent": known & hard, "objects": known & objects, "all": known}
