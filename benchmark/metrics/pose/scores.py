"""Figures of category-level poses, from matches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.metrics.pose import matching, pose_frames, pose_protocol
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseScores:
    """Figures by class.

    Attributes:
        columns: names of the K figures: `iou25`, ..., `10deg10cm`.
        class_names: of the C classes, class 0 left out.
        values: (C, K) shares in [0, 1]; NaN for a class without true objects and predictions that
            count, and for average precision without true objects.
        true_objects: (C,) number of them.
        predictions: (C,) number of them.
    """

    columns: tuple[str, ...]
    class_names: tuple[str, ...]
    values: Floats
    true_objects: NDArray[np.int64]
    predictions: NDArray[np.int64]

    @property
    def mean(self) -> dict[str, float]:
        """Mean of each figure over the classes that have it, by its name; NaN if none has."""
        there = ~np.isnan(self.values)
        count = there.sum(axis=0)
        total = np.where(there, self.values, 0.0).sum(axis=0)
        means = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
        return dict(zip(self.columns, means.tolist(), strict=True))

    def of_class(self, name: str) -> dict[str, float]:
        """Figures of one class by their names.

        Raises:
            ToolkitError: no such class.
        """
        if name not in self.class_names:
            raise ToolkitError("no such class", value=name, hint=", ".join(self.class_names))
        row = self.values[self.class_names.index(name)]
        return dict(zip(self.columns, row.tolist(), strict=True))


def average_precision(
    scores: ArrayLike, hits: ArrayLike, objects: float, weights: ArrayLike | None = None
) -> float:
    """Area under precision over recall, all points interpolated (VOC since 2010).

    Predictions of one score come in together: which of them stands first in a list says nothing,
    and must not change the figure. With distinct scores this is the usual sum.

    Args:
        scores: (N,) of the predictions, in any order.
        hits: (N,) whether each was matched with a true object of its own.
        objects: number of true objects.
        weights: (N,) how often each prediction counts; once by default.

    Returns:
        The area in [0, 1]; NaN without true objects.

    Raises:
        ToolkitError: shapes that differ, or scores that are not finite.

    >>> average_precision([0.9, 0.8, 0.7], [True, False, True], 4)  # 1/4 * 1 + 1/4 * 2/3
    0.41666666666666663
    """
    s, h = np.asarray(scores, dtype=np.float64), np.asarray(hits, dtype=bool)
    w = np.ones(len(s)) if weights is None else np.asarray(weights, dtype=np.float64)
    if not s.shape == h.shape == w.shape or s.ndim != 1 or not np.isfinite(s).all():
        value = (s.shape, h.shape, w.shape)
        raise ToolkitError("needs finite scores, hits and weights (N,)", value=value)
    if not objects > 0:
        return float("nan")
    order = np.argsort(-s, kind="stable")
    order = order[w[order] > 0]
    if not len(order):
        return 0.0
    last = np.append(s[order][1:] != s[order][:-1], True)
    found = np.cumsum(w[order] * h[order])[last]
    precision = found / np.cumsum(w[order])[last]
    best_from_here = np.maximum.accumulate(precision[::-1])[::-1]
    return float((np.diff(found, prepend=0.0) * best_from_here).sum() / objects)


def score_matches(
    matches: matching.PoseMatches, frame_weights: ArrayLike | None = None
) -> PoseScores:
    """Figures of matches, of all frames or of a choice of them.

    Args:
        matches: of all frames.
        frame_weights: (frames,) how often each frame counts; for bootstraps and parts of a set.

    Returns:
        Figures by class.

    Raises:
        ToolkitError: weights that are not (frames,) or negative.

    >>> from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
    >>> truth = PoseTruth([3], np.eye(4)[None], np.ones((1, 3)))
    >>> nothing = PosePrediction([], [], [], [])
    >>> score_poses([truth], [nothing]).mean["iou25"]
    0.0
    """
    protocol = matches.protocol
    w = np.ones(matches.frames) if frame_weights is None else np.asarray(frame_weights, float)
    if w.shape != (matches.frames,) or not (w >= 0).all():
        raise ToolkitError("must be (frames,) and not negative", field="frame_weights")
    names = protocol.classes.names
    values = np.full((len(names) - 1, len(protocol.columns)), np.nan)
    counts = np.zeros((2, len(names) - 1))
    for row in range(len(names) - 1):
        p = np.flatnonzero(matches.pred_class == row + 1)
        t = np.flatnonzero(matches.true_class == row + 1)
        wp, wt = w[matches.pred_frame[p]], w[matches.true_frame[t]]
        counts[:, row] = wt.sum(), wp.sum()
        for column in range(len(protocol.columns)):
            pw = wp * matches.pred_enters[p, column]
            objects = float((wt * matches.true_enters[t, column]).sum())
            hit = matches.hits[p, column]
            if protocol.score is pose_protocol.PoseScoring.AP:
                figure = average_precision(matches.scores[p], hit, objects, pw)
            elif pw.sum() > 0:
                figure = float((pw * hit).sum() / pw.sum())
            else:
                figure = 0.0 if counts[0, row] else np.nan
            # Of a class that is there, nothing found means nothing right, not nothing to say.
            if np.isnan(figure) and counts[0, row]:
                figure = 0.0
            values[row, column] = figure
    true_objects, predictions = counts.round().astype(np.int64)
    return PoseScores(protocol.columns, names[1:], values, true_objects, predictions)


def score_poses(
    truths: Sequence[pose_frames.PoseTruth],
    predictions: Sequence[pose_frames.PosePrediction],
    protocol: pose_protocol.PoseProtocol = pose_protocol.STRICT,
) -> PoseScores:
    """Figures of predictions of many frames.

    Args:
        truths: of each frame.
        predictions: of each frame, in the same order.
        protocol: what counts, and how.

    Returns:
        Figures by class.

    Raises:
        ToolkitError: unequal numbers of frames, or classes that are not there.

    >>> from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
    >>> truth = PoseTruth([3], np.eye(4)[None], np.ones((1, 3)))
    >>> same = PosePrediction([3], truth.RT, truth.sizes, [1.0])
    >>> score_poses([truth, truth], [same, PosePrediction([], [], [], [])]).mean["5deg2cm"]
    0.5
    """
    return score_matches(match_poses(truths, predictions, protocol))


def match_poses(
    truths: Sequence[pose_frames.PoseTruth],
    predictions: Sequence[pose_frames.PosePrediction],
    protocol: pose_protocol.PoseProtocol = pose_protocol.STRICT,
) -> matching.PoseMatches:
    """Match the predictions of many frames: the slow part of `score_poses`.

    Args:
        truths: of each frame.
        predictions: of each frame, in the same order.
        protocol: what counts, and how.

    Returns:
        The matches, for `score_matches`.

    Raises:
        ToolkitError: unequal numbers of frames, or classes that are not there.

    >>> from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
    >>> truth = PoseTruth([3], np.eye(4)[None], np.ones((1, 3)))
    >>> same = PosePrediction([3], truth.RT, truth.sizes, [1.0])
    >>> score_matches(match_poses([truth], [same]), [2.0]).true_objects.tolist()
    [0, 0, 2, 0, 0, 0, 0]
    """
    n = len(protocol.classes.names)
    both = protocol.both_sides_only
    true, pred = pose_frames.flatten(truths, predictions, classes=n, both_sides_only=both)
    return matching.match(true, pred, protocol, frames=len(truths))
