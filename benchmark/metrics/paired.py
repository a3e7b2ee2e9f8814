"""Whether one method is better than another on the same frames.

Frames are paired, and scenes are what is independent: both tests below look at differences
between two methods by scene, never at frames as if each were a sample of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.bootstrap import SAMPLES, mean_interval, scene_sums
from std_toolkit.errors import ToolkitError

EXACT_SCENES = 14  # up to so many, all 2**scenes ways to swap the methods are counted
FLIPS = 20_000  # drawn ways above that
_FLIPS_AT_ONCE = 1000  # a multiple of 8


@dataclass(frozen=True)
class Paired:
    """Two methods on the same frames.

    Attributes:
        difference: mean over frames of first minus second.
        low, high: 95 % interval of it over scenes; NaN with one scene.
        p_flip: two-sided p of the sign-flip test: how often the mean difference is at least as
            large when in each scene the methods are swapped by chance. Never below
            2 / 2**scenes: with five scenes or fewer nothing can be significant at 0.05.
        p_wilcoxon: two-sided p of Wilcoxon's signed-rank test of the scenes' mean differences:
            less moved by one scene that differs greatly, and blind to how many frames it has.
        frames, scenes: how many were compared.
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
    # Without any difference the ranks are empty and scipy's answer is NaN.
    p_wilcoxon = float(wilcoxon(means).pvalue) if np.any(means) else 1.0
    return Paired(
        float(found.mean),
        float(found.low),
        float(found.high),
        _flip_test(sums, np.random.default_rng(seed)),
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
        samples: draws for intervals.
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
    pairs = []
    for first, second in combinations(dict.fromkeys(there["method"]), 2):
        either = table[[first, second]].dropna(how="all")
        both = either.dropna()
        pair = {"first": first, "second": second, "unpaired": len(either) - len(both)}
        if len(both):
            scenes = both.index.get_level_values("scene").to_numpy()
            found = paired_test(
                both[first].to_numpy(), both[second].to_numpy(), scenes, samples=samples, seed=seed
            )
            pair |= vars(found)
        pairs.append(pair)
    columns = ["first", "second", *Paired.__dataclass_fields__, "unpaired"]
    out = pd.DataFrame(pairs, columns=columns)
    for name in ("p_flip", "p_wilcoxon"):
        out[f"{name}_holm"] = holm(out[name].to_numpy(dtype=np.float64))
    return out


def _flip_test(sums: NDArray[np.float64], rng: np.random.Generator) -> float:
    """Two-sided p of the sum of the scenes' differences under all swaps, or many drawn ones."""
    observed = abs(sums.sum())
    # Sums of the same numbers in another order differ in their last bits.
    least = observed - 1e-12 * np.abs(sums).sum()
    if len(sums) <= EXACT_SCENES:
        ways = np.arange(2 ** len(sums))[:, None] >> np.arange(len(sums)) & 1
        return float((np.abs((1 - 2 * ways) @ sums) >= least).mean())
    reached = 0
    for _ in range(0, FLIPS, _FLIPS_AT_ONCE):
        bits = rng.bytes(_FLIPS_AT_ONCE * len(sums) // 8)
        swapped = np.unpackbits(np.frombuffer(bits, np.uint8)).reshape(_FLIPS_AT_ONCE, -1)
        left = sums.sum() - 2 * (swapped.astype(np.float64) @ sums)
        reached += int((np.abs(left) >= least).sum())
    return (reached + 1) / (FLIPS + 1)  # what was observed is one of the ways
