"""Confidence intervals of means over frames, by resampling scenes.

Frames of one scene show the same objects from nearby places: their errors go together, and an
interval that takes them for independent is several times too narrow. So whole scenes are drawn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

SAMPLES = 4000
_DRAWN_AT_ONCE = 4_000_000  # counts in memory: 32 MB


@dataclass(frozen=True)
class Interval:
    """A mean and where it lies.

    Attributes:
        mean: (...) means over all frames.
        low, high: (...) ends of the interval; NaN with fewer than two scenes.
    """

    mean: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def mean_interval(
    values: ArrayLike,
    scenes: ArrayLike,
    *,
    level: float = 0.95,
    samples: int = SAMPLES,
    seed: int = 0,
) -> Interval:
    """Mean over frames, with a percentile interval from drawing scenes with replacement.

    Args:
        values: (N,) or (N, M) one or more figures of each frame; all M share the draws, so that
            their intervals can be set side by side. A NaN makes its figure's answer NaN.
        scenes: (N,) the scene of each frame: text or numbers.
        level: share of draws that the interval holds.
        samples: draws.
        seed: of the draws: equal input gives equal output.

    Returns:
        The mean (a scalar array, or (M,)) and its interval. With fewer than about ten scenes a
        percentile interval is too narrow; with one there is none.

    Raises:
        ToolkitError: no frames, or lengths that differ, or a level outside (0, 1).

    >>> found = mean_interval([1.0, 1.0, 3.0, 3.0], ["a", "a", "b", "b"])
    >>> float(found.low), float(found.mean), float(found.high)
    (1.0, 2.0, 3.0)
    """
    if not 0 < level < 1 or samples < 1:
        raise ToolkitError("needs a level in (0, 1) and draws", value=(level, samples))
    sums, counts = scene_sums(values, scenes)
    mean = np.asarray(sums.sum(axis=0) / counts.sum())
    if len(counts) < 2:
        return Interval(mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan))
    rng = np.random.default_rng(seed)
    flat = sums.reshape(len(counts), -1)
    draws = _draws(rng, len(counts), samples)
    drawn = np.concatenate([(w @ flat) / (w @ counts)[:, None] for w in draws])
    tail = (1 - level) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0).reshape(2, *mean.shape)
    return Interval(mean, low, high)


def scene_sums(
    values: ArrayLike, scenes: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sums of frames' figures by scene.

    Args:
        values: (N,) or (N, M).
        scenes: (N,) the scene of each frame.

    Returns:
        (S,) or (S, M) sums and (S,) numbers of frames, in the sorted order of scenes.

    Raises:
        ToolkitError: no frames, or lengths that differ.

    >>> sums, counts = scene_sums([1.0, 2.0, 4.0], ["b", "a", "b"])
    >>> sums.tolist(), counts.tolist()
    ([2.0, 5.0], [1.0, 2.0])
    """
    v, names = np.asarray(values, dtype=np.float64), np.asarray(scenes)
    if len(v) == 0 or v.ndim > 2 or names.shape != v.shape[:1]:
        raise ToolkitError(
            "needs figures of frames, and the scene of each", value=(v.shape, names.shape)
        )
    _, inverse = np.unique(names, return_inverse=True)
    counts = np.bincount(inverse).astype(np.float64)
    sums = np.zeros((len(counts), *v.shape[1:]))
    np.add.at(sums, inverse, v)
    return sums, counts


def _draws(rng: np.random.Generator, scenes: int, samples: int) -> Iterator[NDArray[np.float64]]:
    """How often each scene is drawn: (samples, scenes) in all, some at a time."""
    at_once = max(1, _DRAWN_AT_ONCE // scenes)
    for begin in range(0, samples, at_once):
        size = min(at_once, samples - begin)
        # Counting drawn scenes takes a fifth of the time of rng.multinomial.
        drawn = rng.integers(0, scenes, (size, scenes))
        drawn += np.arange(size)[:, None] * scenes
        counts = np.bincount(drawn.ravel(), minlength=size * scenes)
        yield counts.reshape(size, scenes).astype(np.float64)
