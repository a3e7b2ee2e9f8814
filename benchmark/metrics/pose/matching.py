"""Pose errors (angles and distances), and matching of predictions with true objects."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.pose.box_iou import box_iou
from benchmark.metrics.pose.pose_frames import Flat, Groups, group
from benchmark.metrics.pose.pose_protocol import PoseProtocol
from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

Ids = NDArray[np.int64]

Mask = NDArray[np.bool_]

# Each pair of a round class is overlapped in 20 turns: 16 MB of poses.
_PAIRS_AT_ONCE = 8192


def rotation_errors_deg(
    RT_a: Floats,
    RT_b: Floats,
    *,
    round_about_y: Mask | None = None,
    upside_down: Mask | None = None,
) -> Floats:
    """Angles between the rotations of poses.

    Taken from sine and cosine together: the angle is that of the clipped arc cosine which
    evaluations use, but exact near 0 as well, and never NaN.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, a positive scale inside.
        round_about_y: (N,) objects that look the same after any turn about y: only the directions
            of the y axes are compared. None by default.
        upside_down: (N,) of those, the ones that look the same with top and bottom exchanged.

    Returns:
        (N,) degrees in [0, 180].

    Raises:
        ToolkitError: shapes that do not belong together.

    >>> from benchmark.metrics.pose.box_iou import turned_about_y
    >>> one, turned = turned_about_y(np.eye(4)[None], 4)[0, :2, None]
    >>> rotation_errors_deg(one, turned).round(9).tolist()
    [90.0]
    >>> rotation_errors_deg(one, turned, round_about_y=np.array([True])).tolist()
    [0.0]
    """
    a, b = _pairs(RT_a, RT_b)
    turning = _mask(round_about_y, len(a), "round_about_y")
    flipping = _mask(upside_down, len(a), "upside_down")
    Ra, Rb = (x[:, :3, :3] / np.cbrt(np.linalg.det(x[:, :3, :3]))[:, None, None] for x in (a, b))
    relative = Ra.transpose(0, 2, 1) @ Rb
    skew = relative - relative.transpose(0, 2, 1)
    sine = np.sqrt((skew**2).sum(axis=(1, 2)) / 8)
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    ya, yb = Ra[:, :, 1], Rb[:, :, 1]
    sine_y = np.linalg.norm(np.cross(ya, yb), axis=1)
    cosine_y = (ya * yb).sum(axis=1)
    cosine_y = np.where(flipping, np.abs(cosine_y), cosine_y)
    angle = np.arctan2(np.where(turning, sine_y, sine), np.where(turning, cosine_y, cosine))
    return np.rad2deg(angle)


def translation_errors_cm(RT_a: Floats, RT_b: Floats) -> Floats:
    """Distances between the centres of poses.

    Args:
        RT_a, RT_b: (N, 4, 4) object to camera, metres.

    Returns:
        (N,) centimetres.

    Raises:
        ToolkitError: shapes that do not belong together.

    >>> moved = np.eye(4)[None].copy()
    >>> moved[0, :3, 3] = 0.03, 0.0, 0.04
    >>> translation_errors_cm(np.eye(4)[None], moved).tolist()
    [5.0]
    """
    a, b = _pairs(RT_a, RT_b)
    return 100 * np.linalg.norm(a[:, :3, 3] - b[:, :3, 3], axis=1)


def _pairs(RT_a: Floats, RT_b: Floats) -> tuple[Floats, Floats]:
    a, b = np.asarray(RT_a, dtype=np.float64), np.asarray(RT_b, dtype=np.float64)
    if a.shape != b.shape or a.shape[1:] != (4, 4):
        raise ToolkitError("needs two equal arrays (N, 4, 4)", value=(a.shape, b.shape))
    return a, b


def _mask(mask: Mask | None, n: int, name: str) -> Mask:
    found = np.zeros(n, dtype=bool) if mask is None else np.asarray(mask)
    if found.shape != (n,):
        raise ToolkitError("must have shape (N,)", field=name, value=found.shape)
    return found


@dataclass(frozen=True, eq=False)
class PoseMatches:
    """What was found, of all frames: scores of any choice of frames follow from it.

    Attributes:
        protocol: that it was matched by.
        frames: how many there were.
        pred_frame, pred_class: (N,) of predictions.
        scores: (N,) of predictions.
        hits: (N, K) whether a prediction was matched, for each of the protocol's columns.
        pred_enters: (N, K) whether it counts in that column.
        true_frame, true_class: (M,) of true objects.
        true_enters: (M, K) whether the object counts in that column.
    """

    protocol: PoseProtocol
    frames: int
    pred_frame: Ids
    pred_class: Ids
    scores: Floats
    hits: Mask
    pred_enters: Mask
    true_frame: Ids
    true_class: Ids
    true_enters: Mask


def greedy(gain: Floats, allowed: Mask) -> Ids:
    """Match predictions with true objects, the first prediction first, each with the best left.

    Args:
        gain: (B, P, G) how well they go together, in B groups; finite where allowed.
        allowed: (B, P, G) which may go together.

    Returns:
        (B, P) the index of the true object, -1 for none.

    Raises:
        ToolkitError: shapes that differ.

    >>> gain = np.array([[[0.6, 0.9], [0.1, 0.8]]])
    >>> greedy(gain, gain > 0.5).tolist()  # the second finds its best one taken
    [[1, -1]]
    """
    if gain.shape != allowed.shape or gain.ndim != 3:
        value = (gain.shape, allowed.shape)
        raise ToolkitError("needs two equal arrays (groups, predictions, truths)", value=value)
    open_gain = np.where(allowed, gain, -np.inf)
    groups = np.arange(len(gain))
    matched = np.full(gain.shape[:2], -1)
    for rank in range(gain.shape[1]):
        best = open_gain[:, rank].argmax(axis=1)
        found = open_gain[groups, rank, best] > -np.inf
        matched[found, rank] = best[found]
        open_gain[groups[found], :, best[found]] = -np.inf
    return matched


def match(true: Flat, pred: Flat, protocol: PoseProtocol, *, frames: int) -> PoseMatches:
    """Match the predictions of many frames under every threshold of a protocol.

    Overlaps go to the true box that a prediction overlaps most; angles and distances to the object
    with the least sum of degrees and centimetres, of those within the gate.

    Args:
        true: true objects, as `flatten` lays them out.
        pred: predictions.
        protocol: overlap, gates and symmetries.
        frames: how many there were, those without objects included.

    Returns:
        The matches.

    Raises:
        ToolkitError: never with tables of `flatten`.

    >>> from benchmark.metrics.pose.pose_frames import PosePrediction, PoseTruth
    >>> from benchmark.metrics.pose.pose_frames import flatten
    >>> from benchmark.metrics.pose.pose_protocol import STRICT
    >>> truth = PoseTruth([3], np.eye(4)[None], np.ones((1, 3)))
    >>> same = PosePrediction([3], truth.RT, truth.sizes, [1.0])
    >>> match(*flatten([truth], [same], classes=8), STRICT, frames=1).hits.all()
    np.True_
    """
    overlaps = len(protocol.iou_thresholds)
    columns = len(protocol.columns)
    hits = np.zeros((len(pred), columns), dtype=bool)
    conditional = protocol.pose_needs_iou is not None
    pred_enters = np.ones((len(pred), columns), dtype=bool)
    true_enters = np.ones((len(true), columns), dtype=bool)
    if conditional:
        pred_enters[:, overlaps:] = true_enters[:, overlaps:] = False
    groups = group(true, pred)
    for these, (iou, degrees, cm) in zip(
        groups, _compare(groups, true, pred, protocol), strict=True
    ):
        for column, threshold in enumerate(protocol.iou_thresholds):
            hits[these.predictions, column] = greedy(iou, iou > threshold) >= 0
        admitted = np.ones(iou.shape, dtype=bool)
        if protocol.pose_needs_iou is not None:
            found = greedy(iou, iou > protocol.pose_needs_iou)
            truths = (found[:, :, None] == np.arange(iou.shape[2])).any(axis=1)
            pred_enters[these.predictions, overlaps:] = (found >= 0)[:, :, None]
            true_enters[these.truths, overlaps:] = truths[:, :, None]
            admitted = (found >= 0)[:, :, None] & truths[:, None]
        for column, gate in enumerate(protocol.gates, start=overlaps):
            within = admitted & (degrees <= gate.degrees) & (cm <= gate.centimetres)
            hits[these.predictions, column] = greedy(-(degrees + cm), within) >= 0
    return PoseMatches(
        protocol,
        frames,
        pred.frame,
        pred.class_ids,
        pred.scores,
        hits,
        pred_enters,
        true.frame,
        true.class_ids,
        true_enters,
    )


def _compare(groups: list[Groups], true: Flat, pred: Flat, protocol: PoseProtocol) -> list[Floats]:
    """(3, B, P, G): overlaps, degrees and centimetres of each of the groups."""
    nothing = np.zeros(0, np.int64)
    pairs = [these.pairs for these in groups]
    p, t = (np.concatenate([nothing, *(pair[i] for pair in pairs)]) for i in (0, 1))
    classes = protocol.classes
    kind = true.class_ids[t]
    turning = classes.are(kind, classes.round_about_y)
    turning |= classes.are(kind, classes.round_without_handle) & ~true.visible[t]
    flipping = classes.are(kind, classes.upside_down)
    found = np.empty((3, len(p)))
    for begin in range(0, len(p), _PAIRS_AT_ONCE):
        some = slice(begin, begin + _PAIRS_AT_ONCE)
        a, b = pred.RT[p[some]], true.RT[t[some]]
        found[0, some] = box_iou(
            a,
            pred.sizes[p[some]],
            b,
            true.sizes[t[some]],
            protocol.iou,
            round_about_y=turning[some],
            turns=protocol.turns,
        )
        found[1, some] = rotation_errors_deg(
            a, b, round_about_y=turning[some], upside_down=flipping[some]
        )
        found[2, some] = translation_errors_cm(a, b)
    ends = np.cumsum([len(pair[0]) for pair in pairs])[:-1]
    parts = np.split(found, ends, axis=1)[: len(groups)]
    shapes = [(3, *g.predictions.shape, g.truths.shape[1]) for g in groups]
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
