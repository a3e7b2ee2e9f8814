"""Confidence intervals over scenes, and paired tests between methods.

Frames are paired, and scenes are independent: both tests use differences between two methods by
scene, not single frames.

Confidence intervals of means over frames are computed by resampling whole scenes. Frames of one
scene show the same objects from nearby viewpoints, so that their errors are correlated; an interval
that treats them as independent is several times too narrow.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.flips import flip_test, flip_tests, scene_sums
from std_toolkit.errors import ToolkitError

SAMPLES = 4000

_DRAWN_AT_ONCE = 4_000_000  # counts in memory: 32 MB


@dataclass(frozen=True)
class Interval:
    """A mean with its interval.

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
        values: (N,) or (N, M) one or more figures of each frame; all M share the bootstrap samples,
            so that their intervals are comparable. A NaN makes the result of its figure NaN.
        scenes: (N,) the scene of each frame: text or numbers.
        level: fraction of bootstrap samples within the interval.
        samples: number of bootstrap samples.
        seed: seed of the bootstrap: equal input gives equal output.

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
    flat = sums.reshape(len(counts), -1)
    draws = _draws(len(counts), samples, seed)
    drawn = np.concatenate([(w @ flat) / (w @ counts)[:, None] for w in draws])
    tail = (1 - level) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0).reshape(2, *mean.shape)
    return Interval(mean, low, high)


def _draws(scenes: int, samples: int, seed: int) -> Iterator[NDArray[np.float64]]:
    """How often each scene is drawn: (samples, scenes) in all, some at a time."""
    at_once = max(1, _DRAWN_AT_ONCE // scenes)
    if samples <= at_once:
        yield _one_draw(scenes, samples, seed)
        return
    rng = np.random.default_rng(seed)
    for begin in range(0, samples, at_once):
        yield _drawn(rng, scenes, min(at_once, samples - begin))


@lru_cache(maxsize=2)  # means of many methods are over the same scenes
def _one_draw(scenes: int, samples: int, seed: int) -> NDArray[np.float64]:
    return _drawn(np.random.default_rng(seed), scenes, samples)


def _drawn(rng: np.random.Generator, scenes: int, size: int) -> NDArray[np.float64]:
    # Counting drawn scenes takes a fifth of the time of rng.multinomial.
    drawn = rng.integers(0, scenes, (size, scenes))
    drawn += np.arange(size)[:, None] * scenes
    counts = np.bincount(drawn.ravel(), minlength=size * scenes)
    return counts.reshape(size, scenes).astype(np.float64)


@dataclass(frozen=True)
class Paired:
    """Two methods on the same frames.

    Attributes:
        difference: mean over frames of first minus second.
        low, high: 95 % interval of it over scenes; NaN with one scene.
        p_flip: two-sided p of the sign-flip test: how often the mean difference is at least as
            large if the methods are swapped at random in each scene. It is at least
            2 / 2**scenes: with five scenes or fewer no difference is significant at 0.05.
        p_wilcoxon: two-sided p of Wilcoxon's signed-rank test of the scenes' mean differences:
            less affected by one outlying scene, and independent of the number of frames.
        frames, scenes: numbers of frames and scenes compared.
    """

    difference: float
    low: float
    high: float
    p_flip: float
    p_wilcoxon: float
    frames: int
    scenes: int


def paired_test(
    first: ArrayLike, second: ArrayLike, scenes: ArrayLike, *, samples: int = SAMPLES, seed: int = 0
) -> Paired:
    """Compare two methods by one figure.

    Args:
        first, second: (N,) the figure of each frame, in the same order, without NaN.
        scenes: (N,) the scene of each frame.
        samples: draws for the interval.
        seed: of all that is drawn.

    Returns:
        The difference and how likely it is by chance.

    Raises:
        ToolkitError: no frames, lengths that differ, or a NaN.

    >>> scenes = np.repeat(list("abcdefgh"), 2)
    >>> found = paired_test(np.linspace(2, 3, 16), np.linspace(1, 2, 16), scenes)
    >>> found.difference, found.p_flip, found.scenes
    (1.0, 0.0078125, 8)
    """
    from scipy.stats import wilcoxon  # half a second that only comparisons should wait for

    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1 or not np.isfinite(a).all() or not np.isfinite(b).all():
        raise ToolkitError(
            "paired figures must be finite, and as many of one method as of the other",
            value=(a.shape, b.shape),
        )
    sums, counts = scene_sums(a - b, scenes)
    found = mean_interval(a - b, scenes, samples=samples, seed=seed)
    means = sums / counts
    # Without any difference the ranks are empty and scipy returns NaN.
    p_wilcoxon = float(wilcoxon(means).pvalue) if np.any(means) else 1.0
    return Paired(
        float(found.mean),
        float(found.low),
        float(found.high),
        flip_test(sums, seed),
        p_wilcoxon,
        len(a),
        len(counts),
    )


def holm(p_values: ArrayLike) -> NDArray[np.float64]:
    """P-values of several comparisons, corrected so that all hold together (Holm, 1979).

    Args:
        p_values: (N,) of the comparisons, NaN for those that were not made.

    Returns:
        (N,) corrected ones, at most 1, in the order given; NaN stays and does not count.

    >>> holm([0.01, 0.04, 0.03]).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p_values, dtype=np.float64)
    made = np.flatnonzero(~np.isnan(p))
    order = made[np.argsort(p[made], kind="stable")]
    adjusted = np.full(p.shape, np.nan)
    adjusted[order] = np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1))
    return np.minimum(adjusted, 1)


def compare_methods(
    rows: pd.DataFrame, metric: str = "rmse", *, samples: int = SAMPLES, seed: int = 0
) -> pd.DataFrame:
    """Compare every two methods on the frames that both were scored on.

    Args:
        rows: columns `method`, `scene`, `frame` and `metric`: of one data set, protocol, grid and
            subset, hence one row for each method and frame. Rows with NaN (frames without pixels
            to compare) do not take part.
        metric: the column to compare.
        samples: draws for intervals; 0 for the sign-flip test alone, many times as fast: the other
            columns are NaN.
        seed: of all that is drawn.

    Returns:
        A row for each pair, in the order in which methods first appear: `first`, `second`, the
        fields of `Paired`, `p_flip_holm` and `p_wilcoxon_holm` corrected for the number of pairs,
        and `unpaired`, the frames that only one of the two has.

    Raises:
        ToolkitError: a column is missing, or a method has a frame twice.

    >>> rows = pd.DataFrame({"method": list("aabb"), "scene": list("xyxy"), "frame": 0})
    >>> found = compare_methods(rows.assign(rmse=[1.0, 2.0, 3.0, 4.0]))
    >>> found[["first", "second", "difference", "frames"]].to_numpy().tolist()
    [['a', 'b', -2.0, 2]]
    """
    key = ["method", "scene", "frame"]
    absent = [name for name in (*key, metric) if name not in rows]
    if absent:
        raise ToolkitError("rows lack columns", field=", ".join(absent), value=list(rows.columns))
    there = rows[[*key, metric]].dropna(subset=[metric])
    if there.duplicated(key).any():
        twice = there[there.duplicated(key)].iloc[0]
        raise ToolkitError(
            "is there twice for one method",
            path=f"{twice['scene']}/{twice['frame']}",
            value=twice["method"],
            hint="compare rows of one data set, protocol, grid and subset",
        )
    table = there.set_index(["scene", "frame", "method"])[metric].unstack("method")
    names = list(dict.fromkeys(there["method"]))
    if samples:
        pairs = [_pair(table, *two, samples, seed) for two in combinations(names, 2)]
    else:
        scenes = table.index.get_level_values("scene").to_numpy()
        p = flip_tests(table[names].to_numpy(np.float64), scenes, seed)
        of = combinations(range(len(names)), 2)
        pairs = [{"first": names[i], "second": names[j], "p_flip": p[i, j]} for i, j in of]
    columns = ["first", "second", *Paired.__dataclass_fields__, "unpaired"]
    out = pd.DataFrame(pairs, columns=columns)
    for name in ("p_flip", "p_wilcoxon"):
        out[f"{name}_holm"] = holm(out[name].to_numpy(dtype=np.float64))
    return out


def _pair(
    table: pd.DataFrame, first: str, second: str, samples: int, seed: int
) -> dict[str, object]:
    either = table[[first, second]].dropna(how="all")
    both = either.dropna()
    pair = {"first": first, "second": second, "unpaired": len(either) - len(both)}
    if len(both):
        scenes = both.index.get_level_values("scene").to_numpy()
        found = paired_test(
            both[first].to_numpy(), both[second].to_numpy(), scenes, samples=samples, seed=seed
        )
        pair |= vars(found)
    return pair
