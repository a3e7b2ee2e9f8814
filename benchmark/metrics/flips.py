"""Sign-flip tests: how often a difference is as large if two methods are swapped at random.

Scenes are independent, so that all frames of a scene are swapped together.
"""

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

EXACT_SCENES = 14  # up to this number, all 2**scenes swaps of the methods are enumerated

FLIPS = 20_000  # random swaps for more scenes

_FLIPS_AT_ONCE = 1000  # a multiple of 8

# Sums of the same numbers in another order differ in their last bits.
_SLACK = 1e-12


def scene_sums(values: ArrayLike, scenes: ArrayLike) -> tuple[Floats, Floats]:
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


def flip_test(sums: Floats, seed: int = 0) -> float:
    """Two-sided p of the sum of the scenes' differences.

    Args:
        sums: (S,) sum of the differences of each scene.
        seed: seed of the random swaps.

    Returns:
        The fraction of swaps, all or many random ones, whose sum is at least as large.

    >>> flip_test(np.array([1.0, 2.0, 2.0]))
    0.25
    """
    least = abs(sums.sum()) - _SLACK * np.abs(sums).sum()
    parts = list(_signs(len(sums), seed))
    reached = sum(int((np.abs(part @ sums) >= least).sum()) for part in parts)
    return _share(reached, sum(map(len, parts)), len(sums))


def flip_tests(values: Floats, scenes: ArrayLike, seed: int = 0) -> Floats:
    """`flip_test` of every two methods, on the frames that both have.

    Args:
        values: (N, M) the figure of each frame and method; NaN for a frame that a method lacks.
        scenes: (N,) the scene of each frame.
        seed: seed of the random swaps.

    Returns:
        (M, M) symmetric; NaN on the diagonal, and for methods without a common frame.

    Raises:
        ToolkitError: a figure is infinite.

    >>> values = np.array([[1.0, 2.0], [2.0, 4.0], [3.0, 5.0]])
    >>> float(flip_tests(values, ["a", "b", "c"])[0, 1])
    0.25
    """
    if np.isinf(values).any():
        raise ToolkitError("paired figures must be finite", value="inf")
    names = np.asarray(scenes)
    found = np.full((values.shape[1],) * 2, np.nan)
    # Methods that have the same frames are compared together.
    patterns, of = np.unique(~np.isnan(values), axis=1, return_inverse=True)
    groups = [np.flatnonzero(of.ravel() == g) for g in range(patterns.shape[1])]
    for g, h in combinations_with_replacement(range(len(groups)), 2):
        both = patterns[:, g] & patterns[:, h]
        if both.any():
            first, second = (
                scene_sums(values[both][:, groups[i]], names[both])[0].T.copy() for i in (g, h)
            )
            p = _between(first, second, seed)
            found[np.ix_(groups[g], groups[h])] = p
            found[np.ix_(groups[h], groups[g])] = p.T
    np.fill_diagonal(found, np.nan)
    return found


def _between(first: Floats, second: Floats, seed: int) -> Floats:
    """(A, B) p of the methods with sums (A, S) of scenes against those with (B, S)."""
    scenes, same = first.shape[1], np.array_equal(first, second)
    observed, size = np.empty((2, len(first), len(second)))
    for i, one in enumerate(first):
        difference = one - second
        observed[i], size[i] = np.abs(difference.sum(axis=1)), np.abs(difference).sum(axis=1)
    least = observed - _SLACK * size
    # The sum of a pair is the difference of the sums of its methods, but for this:
    summed = np.abs(first).sum(axis=1)[:, None] + np.abs(second).sum(axis=1)
    error = 4 * (scenes + 2) * np.finfo(np.float64).eps * summed
    high, low = least + error, least - error
    flips = known = 0
    parts = []
    for signs in _signs(scenes, seed):
        # Where all scenes are swapped, or none, the sum is the observed one.
        given = np.abs(signs.sum(axis=1)) == scenes
        flips += len(signs)
        known += int(np.count_nonzero(given))
        parts.append((first @ signs[~given].T, second @ signs[~given].T))
    of_first, of_second = (np.hstack(part) for part in zip(*parts, strict=True))
    size_of, reached = np.empty(flips - known), np.empty(flips - known, bool)
    found = np.ones((len(first), len(second)))
    for i, j in zip(*np.nonzero(size), strict=True):  # without any difference p is 1
        if same and i > j:
            found[i, j] = found[j, i]
            continue
        np.subtract(of_first[i], of_second[j], out=size_of)
        np.abs(size_of, out=size_of)
        surely = np.count_nonzero(np.greater_equal(size_of, high[i, j], out=reached))
        perhaps = np.count_nonzero(np.greater_equal(size_of, low[i, j], out=reached))
        if surely == perhaps:
            found[i, j] = _share(int(surely) + known, flips, scenes)
        else:
            found[i, j] = flip_test(first[i] - second[j], seed)
    return found


def _signs(scenes: int, seed: int) -> Iterator[Floats]:
    """(F, scenes) +1, or -1 for a scene whose methods are swapped; some at a time."""
    if scenes <= EXACT_SCENES:
        # The other half of the swaps has the opposite signs.
        swapped = np.arange(2 ** (scenes - 1))[:, None] >> np.arange(scenes) & 1
        yield (1 - 2 * swapped).astype(np.float64)
        return
    rng = np.random.default_rng(seed)
    for _ in range(0, FLIPS, _FLIPS_AT_ONCE):
        bits = rng.bytes(_FLIPS_AT_ONCE * scenes // 8)
        swapped = np.unpackbits(np.frombuffer(bits, np.uint8)).astype(np.int64)
        yield (1 - 2 * swapped.reshape(_FLIPS_AT_ONCE, -1)).astype(np.float64)


def _share(reached: int, flips: int, scenes: int) -> float:
    if scenes <= EXACT_SCENES:
        return reached / flips
    return (reached + 1) / (flips + 1)  # what was observed is one of the ways
