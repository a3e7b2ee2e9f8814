"""True and predicted poses by frame, and as flat tables to match.

A pose is a 4x4 matrix with a uniform scale, which maps the object's normalised coordinates into the
camera frame in metres; a box is that matrix and its size along x, y, z before it.

Predictions are matched with true objects of their class in their frame. The sizes of such groups
vary; groups of equal size are combined, so that each step of matching is a few array operations for
any number of frames, without padding.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

Floats = NDArray[np.float64]

Ids = NDArray[np.int64]

# A rotation of released results is stored with 6 digits at least.
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class PoseTruth:
    """True objects of a frame. Array-like values are converted to arrays.

    Attributes:
        class_ids: (N,) numbers of the classes; 0 is "other" and never scored.
        RT: (N, 4, 4) object to camera, the scale inside, metres.
        sizes: (N, 3) of the boxes before RT.
        handle_visible: (N,) whether the handle of a mug can be seen; all by default.

    Raises:
        ToolkitError: inconsistent shapes, or an invalid pose or size.
    """

    class_ids: Ids
    RT: Floats
    sizes: Floats
    handle_visible: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = _keep_poses(self)
        seen = np.ones(n, dtype=bool) if self.handle_visible is None else self.handle_visible
        _keep(self, "handle_visible", np.asarray(seen).astype(bool).reshape(-1), (n,))

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(N,) `handle_visible`, which is always there once built."""
        assert self.handle_visible is not None
        return self.handle_visible


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """Predictions of a method in a frame. Array-like values are converted to arrays.

    Attributes:
        class_ids: (N,) numbers of the classes.
        RT: (N, 4, 4) object to camera, the scale inside, metres.
        sizes: (N, 3) of the boxes before RT; 0 is allowed, such a box overlaps nothing.
        scores: (N,) confidences: predictions are matched and ranked by them, highest first.

    Raises:
        ToolkitError: inconsistent shapes, or an invalid pose, size or score.
    """

    class_ids: Ids
    RT: Floats
    sizes: Floats
    scores: Floats

    def __post_init__(self) -> None:
        n = _keep_poses(self)
        scores = np.asarray(self.scores, dtype=np.float64).reshape(-1)
        if not np.isfinite(scores).all():
            raise ToolkitError("must be finite", field="scores", value=scores.tolist())
        _keep(self, "scores", scores, (n,))


def _keep_poses(frame: Any) -> int:
    ids = np.asarray(frame.class_ids).reshape(-1)
    if ids.size and (not np.issubdtype(ids.dtype, np.integer) or ids.min() < 0):
        raise ToolkitError("must be whole numbers from 0", field="class_ids", value=ids.tolist())
    n = len(ids)
    _keep(frame, "class_ids", ids.astype(np.int64), (n,))
    sizes = np.asarray(frame.sizes, dtype=np.float64)
    RT = np.asarray(frame.RT, dtype=np.float64)
    _keep(frame, "sizes", sizes.reshape(0, 3) if sizes.size == 0 else sizes, (n, 3))
    _keep(frame, "RT", RT.reshape(0, 4, 4) if RT.size == 0 else RT, (n, 4, 4))
    bad = ~(np.isfinite(frame.sizes) & (frame.sizes >= 0)).all(axis=1)
    if bad.any():
        value = frame.sizes[bad][0].tolist()
        raise ToolkitError("must be finite and not negative", field="sizes", value=value)
    bad = ~_is_similarity(frame.RT)
    if bad.any():
        raise ToolkitError(
            "must be a rotation times one positive scale, and a translation",
            field=f"RT[{int(np.flatnonzero(bad)[0])}]",
            value=frame.RT[bad][0].round(4).tolist(),
            hint="give 4x4 matrices with the scale inside, metres",
        )
    return n


def _keep(frame: Any, name: str, value: NDArray[Any], shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise ToolkitError(f"must have shape {shape}", field=name, value=value.shape)
    object.__setattr__(frame, name, value)


def _is_similarity(RT: Floats) -> NDArray[np.bool_]:
    A = RT[:, :3, :3]
    with np.errstate(invalid="ignore"):
        det = np.linalg.det(A)
        scale_squared = np.cbrt(np.maximum(det, 0))[:, None, None] ** 2
        off = np.abs(A @ A.transpose(0, 2, 1) - scale_squared * np.eye(3)).max(axis=(1, 2))
        right = (det > 0) & (off <= _ROTATION_TOLERANCE * scale_squared[:, 0, 0])
    plain = (RT[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    return np.isfinite(RT).all(axis=(1, 2)) & plain & right


@dataclass(frozen=True, eq=False)
class Flat:
    """All true objects, or all predictions, of many frames.

    Attributes:
        frame: (N,) index of the frame.
        class_ids: (N,) never 0.
        RT: (N, 4, 4).
        sizes: (N, 3).
        scores: (N,) of predictions; zeros for true objects.
        visible: (N,) handles of true objects; all true for predictions.
    """

    frame: Ids
    class_ids: Ids
    RT: Floats
    sizes: Floats
    scores: Floats
    visible: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class Groups:
    """Groups of one size: predictions by falling score, and the true objects beside them.

    Attributes:
        predictions: (B, P) rows of the predictions.
        truths: (B, G) rows of the true objects.
    """

    predictions: Ids
    truths: Ids

    @property
    def pairs(self) -> tuple[Ids, Ids]:
        """(B * P * G,) rows of predictions and of true objects, of every pair."""
        shape = (*self.predictions.shape, self.truths.shape[1])
        p = np.broadcast_to(self.predictions[:, :, None], shape)
        g = np.broadcast_to(self.truths[:, None, :], shape)
        return p.ravel(), g.ravel()


def flatten(
    truths: Sequence[PoseTruth],
    predictions: Sequence[PosePrediction],
    *,
    classes: int,
    both_sides_only: bool = False,
) -> tuple[Flat, Flat]:
    """Lay frames out as tables, without objects of class 0.

    Args:
        truths: of each frame.
        predictions: of each frame, in the same order.
        classes: how many there are; larger numbers are refused.
        both_sides_only: leave out frames without any true object or without any prediction.

    Returns:
        True objects, and predictions.

    Raises:
        ToolkitError: unequal numbers of frames, or a class that is not there.

    >>> truth = PoseTruth([1, 0], np.eye(4)[None].repeat(2, 0), np.ones((2, 3)))
    >>> nothing = PosePrediction([], [], [], [])
    >>> [len(t) for t in flatten([truth], [nothing], classes=8)]
    [1, 0]
    """
    if len(truths) != len(predictions):
        counts = (len(truths), len(predictions))
        raise ToolkitError("needs as many true frames as predicted ones", value=counts)
    true = _flat(truths, [np.zeros(len(t.class_ids)) for t in truths])
    pred = _flat(predictions, [p.scores for p in predictions])
    for table, what in ((true, "true"), (pred, "predicted")):
        if len(table) and table.class_ids.max() >= classes:
            row = int(table.class_ids.argmax())
            where = f"{what} class_ids of frame {table.frame[row]}"
            raise ToolkitError("no such class", field=where, value=int(table.class_ids[row]))
    true, pred = (_rows(t, t.class_ids > 0) for t in (true, pred))
    if both_sides_only:
        both = np.intersect1d(true.frame, pred.frame)
        true, pred = (_rows(t, np.isin(t.frame, both)) for t in (true, pred))
    return true, pred


def group(true: Flat, pred: Flat) -> list[Groups]:
    """Objects of one class in one frame, where there are true and predicted ones.

    Args:
        true: true objects.
        pred: predictions. Those of one score keep their order.

    Returns:
        Groups by size.

    Raises:
        ToolkitError: never.

    >>> truth = PoseTruth([1, 2, 2], np.eye(4)[None].repeat(3, 0), np.ones((3, 3)))
    >>> found = PosePrediction([2, 2], truth.RT[:2], truth.sizes[:2], [0.3, 0.7])
    >>> group(*flatten([truth], [found], classes=8))[0].predictions.tolist()
    [[1, 0]]
    """
    largest = max((int(t.class_ids.max()) for t in (true, pred) if len(t)), default=0) + 1
    true_key, pred_key = (t.frame * largest + t.class_ids for t in (true, pred))
    true_order = np.argsort(true_key, kind="stable")
    pred_order = np.lexsort((-pred.scores, pred_key))
    keys_t, start_t, count_t = np.unique(
        true_key[true_order], return_index=True, return_counts=True
    )
    keys_p, start_p, count_p = np.unique(
        pred_key[pred_order], return_index=True, return_counts=True
    )
    _, at_p, at_t = np.intersect1d(keys_p, keys_t, assume_unique=True, return_indices=True)
    sizes = np.stack([count_p[at_p], count_t[at_t]], axis=1)
    groups = []
    for p, g in np.unique(sizes, axis=0):
        these = (sizes == (p, g)).all(axis=1)
        rows_p = pred_order[start_p[at_p[these]][:, None] + np.arange(p)]
        rows_t = true_order[start_t[at_t[these]][:, None] + np.arange(g)]
        groups.append(Groups(rows_p, rows_t))
    return groups


def _flat(frames: Sequence[PoseTruth | PosePrediction], scores: Sequence[Floats]) -> Flat:
    counts = [len(f.class_ids) for f in frames]
    seen = [f.visible if isinstance(f, PoseTruth) else np.ones(len(f.scores), bool) for f in frames]
    return Flat(
        np.repeat(np.arange(len(frames)), counts),
        np.concatenate([np.zeros(0, np.int64), *(f.class_ids for f in frames)]),
        np.concatenate([np.zeros((0, 4, 4)), *(f.RT for f in frames)]),
        np.concatenate([np.zeros((0, 3)), *(f.sizes for f in frames)]),
        np.concatenate([np.zeros(0), *scores]),
        np.concatenate([np.zeros(0, bool), *seen]),
    )


def _rows(table: Flat, keep: NDArray[np.bool_]) -> Flat:
    return Flat(
        table.frame[keep],
        table.class_ids[keep],
        table.RT[keep],
        table.sizes[keep],
        table.scores[keep],
        table.visible[keep],
    )
