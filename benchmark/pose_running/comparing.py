"""Whether one depth gives better poses than another, on the same frames by the same method.

Scenes are what is independent. Average precision is no mean of frames, so that scenes cannot have
differences of their own; but if the depth made no difference, the answers to each scene could be
swapped between the two, and the figures of all swapped tables be as likely as the observed ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.draws import figures_of_draws, scene_weights, side_by_side
from benchmark.pose_running.scoring import SAMPLES, Scored, interval_of, scene_draws
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

EXACT_SCENES = 11  # up to so many, all 2**scenes ways to swap are counted
FLIPS = 2000  # drawn ways above that


@dataclass(frozen=True, eq=False)
class PoseDifference:
    """Two runs on the same frames, by one protocol.

    Attributes:
        columns: names of the K figures.
        difference: (K,) first minus second, shares.
        low, high: (K,) 95 % interval over scenes; NaN with one scene.
        p: (K,) two-sided p of the swap test: how often a difference is as large when each scene's
            answers are swapped between the two by chance. Never below 2 / 2**scenes: with five
            scenes or fewer nothing can be significant at 0.05.
        scenes, frames: how many were compared.
    """

    columns: tuple[str, ...]
    difference: Floats
    low: Floats
    high: Floats
    p: Floats
    scenes: int
    frames: int

    def of(self, column: str) -> tuple[float, float, float, float]:
        """Difference, its interval, and p of a column."""
        i = self.columns.index(column)
        values = (self.difference[i], self.low[i], self.high[i], self.p[i])
        return values[0].item(), values[1].item(), values[2].item(), values[3].item()


def compare_runs(
    first: Scored, second: Scored, *, samples: int = SAMPLES, seed: int = 0
) -> PoseDifference:
    """Compare two runs.

    Args:
        first, second: by the same protocol, of the same objects.
        samples: draws for the interval.
        seed: of all that is drawn.

    Raises:
        ToolkitError: they are not of the same frames and objects.
    """
    same = (
        np.array_equal(first.names, second.names)
        and np.array_equal(first.scenes, second.scenes)
        and first.objects == second.objects
    )
    if not same:
        raise ToolkitError(
            "only runs over the same frames can be compared",
            value=", ".join(second.result.name),
            hint="run both over all frames, with the same --limit",
        )
    both = side_by_side(first.matches, second.matches)
    scenes = len(np.unique(first.scenes))
    frames = len(first.scenes)

    def differences(of_first: Floats, of_second: Floats) -> Floats:
        """(D, K) for weights (D, scenes) of the first run's answers and of the second's."""
        a, b = (scene_weights(first.scenes, w) for w in (of_first, of_second))
        return figures_of_draws(both, np.hstack([a, b])) - figures_of_draws(both, np.hstack([b, a]))

    ones, zeros = np.ones((1, scenes)), np.zeros((1, scenes))
    observed = differences(ones, zeros)[0]
    low = high = np.full(len(observed), np.nan)
    if scenes > 1:
        draws = scene_draws(scenes, samples, seed=seed)
        drawn = differences(draws, np.zeros_like(draws))
        low, high = interval_of(drawn)
    swaps = _swaps(scenes, seed)
    swapped = differences(1.0 - swaps, swaps)
    # The same figures summed in another order differ in their last bits.
    reached = (np.abs(swapped) >= np.abs(observed) - 1e-12).sum(axis=0)
    exact = scenes <= EXACT_SCENES
    p = reached / len(swaps) if exact else (reached + 1) / (len(swaps) + 1)
    p = np.where(np.isnan(observed), np.nan, p)
    columns = first.scores.columns
    return PoseDifference(columns, observed, low, high, p, scenes, frames)


def _swaps(scenes: int, seed: int) -> Floats:
    """(W, scenes) which scenes are swapped: all ways, or some that are drawn."""
    if scenes <= EXACT_SCENES:
        ways: Floats = (np.arange(2**scenes)[:, None] >> np.arange(scenes) & 1).astype(np.float64)
        return ways
    rng = np.random.default_rng(seed)
    return rng.integers(0, 2, (FLIPS, scenes)).astype(np.float64)
