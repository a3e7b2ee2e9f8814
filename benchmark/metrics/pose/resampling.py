"""Pose scores of many resampled sets of frames at once: intervals, paired tests.

`score_matches` gives the figures of one choice; a bootstrap needs thousands.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.pose.matching import PoseMatches
from benchmark.metrics.pose.pose_protocol import PoseScoring
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

# Numbers held at a time for one class and column.
_AT_ONCE = 4_000_000
_FEW_RANKS = 64


def resampled_scores(matches: PoseMatches, weights: ArrayLike) -> Floats:
    """Figures of several choices of frames.

    Args:
        matches: of all frames.
        weights: (D, frames) how often each frame counts in each choice.

    Returns:
        (D, K) the mean over classes of each of the protocol's columns, as `PoseScores.mean` has it
        for each choice; NaN for one without any class.

    Raises:
        ToolkitError: weights of another shape, or negative ones.

    >>> from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
    >>> from benchmark.metrics.pose.scores import match_poses
    >>> truth = PoseTruth([3], np.eye(4)[None], np.ones((1, 3)))
    >>> found = [PosePrediction([3], truth.RT, truth.sizes, [1.0]), PosePrediction([], [], [], [])]
    >>> resampled_scores(match_poses([truth] * 2, found), [[1, 1], [2, 0]])[:, 0].tolist()
    [0.5, 1.0]
    """
    w = np.asarray(weights, dtype=np.float64)
    if w.ndim != 2 or w.shape[1] != matches.frames or not (w >= 0).all():
        raise ToolkitError("must be (draws, frames) and not negative", field="weights")
    protocol = matches.protocol
    largest = max(1, len(matches.scores), len(matches.true_frame))
    step = max(1, _AT_ONCE // largest)
    means = np.full((len(w), len(protocol.columns)), np.nan)
    for begin in range(0, len(w), step):
        some = w[begin : begin + step]
        values = np.stack(
            [_of_class(matches, c, some) for c in range(1, len(protocol.classes.names))]
        )
        there = ~np.isnan(values)
        count = there.sum(axis=0)
        total = np.where(there, values, 0.0).sum(axis=0)
        means[begin : begin + step] = np.divide(
            total, count, out=np.full(count.shape, np.nan), where=count > 0
        )
    return means


def side_by_side(first: PoseMatches, second: PoseMatches) -> PoseMatches:
    """The matches of two methods on the same frames as those of one on twice as many: weights
    (frames of the first, frames of the second) then choose whose answer counts where.

    Args:
        first, second: of all frames.

    Returns:
        Matches of twice as many frames: those of the first, then those of the second.

    Raises:
        ToolkitError: other frames, or another protocol.

    >>> from benchmark.metrics.pose import PosePrediction, PoseTruth, match_poses
    >>> truth = PoseTruth([1], [np.eye(4)], [[1, 1, 1]])
    >>> right = PosePrediction([1], [np.eye(4)], [[1, 1, 1]], [1.0])
    >>> wrong = PosePrediction([1], [np.diag([9, 9, 9, 1])], [[1, 1, 1]], [1.0])
    >>> both = side_by_side(match_poses([truth], [right]), match_poses([truth], [wrong]))
    >>> resampled_scores(both, [[1, 0], [0, 1]])[:, 2].tolist()
    [1.0, 0.0]
    """
    if first.frames != second.frames or first.protocol.columns != second.protocol.columns:
        raise ToolkitError("needs two methods on the same frames", value=second.frames)

    def joined(name: str, shift: int = 0) -> NDArray[np.generic]:
        return np.concatenate([getattr(first, name), getattr(second, name) + shift])

    frames = {name: joined(name, first.frames) for name in ("pred_frame", "true_frame")}
    others = ("pred_class", "scores", "true_class")
    arrays = {name: joined(name) for name in others}
    for name in ("hits", "pred_enters", "true_enters"):
        arrays[name] = np.concatenate([getattr(first, name), getattr(second, name)])
    return replace(first, frames=2 * first.frames, **frames, **arrays)  # type: ignore[arg-type]


def _of_class(matches: PoseMatches, number: int, w: Floats) -> Floats:
    """(D, K) figures of one class; NaN where it has none."""
    p = np.flatnonzero(matches.pred_class == number)
    t = np.flatnonzero(matches.true_class == number)
    there = _of_objects(matches.true_frame[t], np.ones(len(t)), w)
    is_ap = matches.protocol.score is PoseScoring.AP
    ranks = _Ranks(matches.pred_frame[p], matches.scores[p] if is_ap else np.zeros(len(p)), w)
    values = np.full((len(w), matches.hits.shape[1]), np.nan)
    for column in range(matches.hits.shape[1]):
        enters = matches.pred_enters[p, column].astype(np.float64)
        taken, found = ranks.sums(enters), ranks.sums(enters * matches.hits[p, column])
        if is_ap:
            true_enters = matches.true_enters[t, column].astype(np.float64)
            figure = _areas(found, taken, _of_objects(matches.true_frame[t], true_enters, w))
        else:
            figure = _shares(found.sum(axis=1), taken.sum(axis=1))
        # Of a class that is there, nothing found means nothing right, not nothing to say.
        values[:, column] = np.where(np.isnan(figure) & (there > 0), 0.0, figure)
    return values


class _Ranks:
    """Predictions of one class by score, those of one score together.

    Args:
        frame, scores: (N,) of the predictions.
        w: (D, frames) how often each frame counts.
    """

    def __init__(self, frame: NDArray[np.int64], scores: Floats, w: Floats) -> None:
        self._order = np.argsort(-scores, kind="stable")
        self._frame, self._w = frame[self._order], w
        sorted_scores = scores[self._order]
        first = np.append(True, sorted_scores[1:] != sorted_scores[:-1])[: len(scores)]
        self._starts = np.flatnonzero(first)
        self._rank = np.cumsum(first) - 1

    def sums(self, values: Floats) -> Floats:
        """(D, G) weighted sums of values (N,), by rank."""
        v, ranks = values[self._order], len(self._starts)
        if ranks <= _FEW_RANKS:  # as of methods that are equally sure of everything
            by_frame = np.zeros((self._w.shape[1], ranks))
            np.add.at(by_frame, (self._frame, self._rank), v)
            return self._w @ by_frame
        weighted = self._w[:, self._frame] * v
        if ranks == len(v):
            return weighted
        return np.add.reduceat(weighted, self._starts, axis=1)


def _of_objects(frame: NDArray[np.int64], values: Floats, w: Floats) -> Floats:
    """(D,) weighted sums of values (M,) of objects."""
    return w @ np.bincount(frame, values, minlength=w.shape[1])


def _areas(found: Floats, taken: Floats, objects: Floats) -> Floats:
    """Average precisions (D,): see `average_precision`."""
    hits = np.cumsum(found, axis=1)
    all_taken = np.cumsum(taken, axis=1)
    precision = np.divide(hits, all_taken, out=np.zeros_like(hits), where=all_taken > 0)
    best_from_here = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    return _shares((found * best_from_here).sum(axis=1), objects)


def _shares(part: Floats, whole: Floats) -> Floats:
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)


def scene_weights(scenes: Sequence[str] | NDArray[np.generic], draws: Floats) -> Floats:
    """Weights of frames from weights of their scenes.

    Args:
        scenes: (frames,) the scene of each.
        draws: (D, S) of the scenes in sorted order.

    Returns:
        (D, frames) how often each frame counts in each draw.

    Raises:
        ToolkitError: draws of another number of scenes.

    >>> scene_weights(["b", "a", "b"], np.array([[1.0, 0.0]])).tolist()
    [[0.0, 1.0, 0.0]]
    """
    names, place = np.unique(np.asarray(scenes), return_inverse=True)
    if draws.ndim != 2 or draws.shape[1] != len(names):
        raise ToolkitError(f"needs (D, {len(names)})", field="draws", value=draws.shape)
    return draws[:, place]
