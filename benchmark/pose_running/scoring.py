"""Figures of runs of poses: by protocol and by material of the objects, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import Material
from benchmark.metrics.pose import (
    PoseMatches,
    PoseProtocol,
    PoseScores,
    match_poses,
    score_matches,
)
from benchmark.metrics.pose.draws import figures_of_draws, scene_weights
from benchmark.pose_running.results import PoseResult
from benchmark.pose_running.table import frames_of

ALL, HARD = "all", "specular+transparent"
SUBSETS: dict[str, frozenset[Material]] = {
    ALL: frozenset(),
    HARD: frozenset({Material.SPECULAR, Material.TRANSPARENT}),
    "transparent": frozenset({Material.TRANSPARENT}),
    "specular": frozenset({Material.SPECULAR}),
    "diffuse": frozenset({Material.RAW, Material.DIFFUSE}),
}
SAMPLES = 1000
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Scored:
    """A run's figures by one protocol for objects of some materials.

    Attributes:
        result: the run.
        subset: key of `SUBSETS`.
        scores: figures by class.
        matches: which they come from.
        scenes, names: (F,) of the frames of the matches.
        low, high: (K,) ends of the 95 % intervals of the means over scenes; NaN with one scene,
            or where nothing was drawn.
    """

    result: PoseResult
    subset: str
    scores: PoseScores
    matches: PoseMatches
    scenes: NDArray[np.generic]
    names: NDArray[np.generic]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @property
    def objects(self) -> int:
        """True objects of the classes."""
        return int(self.scores.true_objects.sum())

    @property
    def scene_count(self) -> int:
        """Scenes with frames."""
        return len(np.unique(self.scenes))

    def interval(self, column: str) -> tuple[float, float]:
        """Ends of the interval of a column."""
        place = self.scores.columns.index(column)
        return float(self.low[place]), float(self.high[place])


def score_run(
    result: PoseResult, protocol: PoseProtocol, subset: str = ALL, *, samples: int = 0
) -> Scored:
    """Score a run.

    Args:
        result: the run.
        protocol: what counts, and how.
        subset: which objects, a key of `SUBSETS`.
        samples: draws of scenes for the intervals; 0 for none.

    Raises:
        ToolkitError: the table holds poses that are none.
    """
    frames = frames_of(result.table, SUBSETS[subset])
    matches = match_poses(frames.truths, frames.found, protocol)
    low = high = np.full(len(protocol.columns), np.nan)
    if samples and len(np.unique(frames.scenes)) > 1:
        draws = scene_draws(len(np.unique(frames.scenes)), samples)
        drawn = figures_of_draws(matches, scene_weights(frames.scenes, draws))
        low, high = interval_of(drawn)
    return Scored(
        result, subset, score_matches(matches), matches, frames.scenes, frames.names, low, high
    )


def score_runs(
    results: Sequence[PoseResult],
    protocol: PoseProtocol,
    subsets: Sequence[str] = (ALL, HARD),
    *,
    samples: int = 0,
) -> list[Scored]:
    """Every run for every subset that has objects, see `score_run`."""
    scored = [score_run(r, protocol, s, samples=samples) for s in subsets for r in results]
    return [each for each in scored if each.objects]


def interval_of(drawn: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ends (K,) of the intervals of drawn figures (D, K), each over the draws that have it."""
    low, high = np.full((2, drawn.shape[1]), np.nan)
    for column, values in enumerate(drawn.T):
        there = values[~np.isnan(values)]
        if len(there):
            low[column], high[column] = np.quantile(there, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return low, high


def scene_draws(scenes: int, samples: int, *, seed: int = 0) -> NDArray[np.float64]:
    """(samples, scenes) how often each scene is drawn, with replacement."""
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, scenes, (samples, scenes)) + scenes * np.arange(samples)[:, None]
    counts = np.bincount(drawn.ravel(), minlength=samples * scenes)
    return counts.reshape(samples, scenes).astype(np.float64)
