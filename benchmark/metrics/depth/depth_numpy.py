"""Depth metrics of one image as pure functions, in numpy; `depth_torch` has the same for batches.

All take predicted and true metres of one shape, and optionally which pixels to compare. Pixels
without ground truth (not finite or not positive) never are. Without any pixel the answer is NaN.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.depth.tally import Errors, Missing, as_real, tally
from std_toolkit.errors import ToolkitError

Depth = NDArray[np.floating]
Mask = NDArray[np.bool_]


def rmse(
    pred: Depth, true: Depth, valid: Mask | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Root of the mean squared error, metres.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        The error, NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> rmse(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]))
    0.6454972243679028
    >>> rmse(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]), missing=Missing.LEFT_OUT)
    0.7071067811865476
    """
    p, g = _compared(pred, true, valid, missing)
    return _mean(np.square(np.subtract(p, g, dtype=np.float64))) ** 0.5


def mae(
    pred: Depth, true: Depth, valid: Mask | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Mean absolute error, metres.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        The error, NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> mae(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]))
    0.5
    """
    p, g = _compared(pred, true, valid, missing)
    return _mean(np.abs(np.subtract(p, g, dtype=np.float64)))


def rel(
    pred: Depth, true: Depth, valid: Mask | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Mean of absolute error / true depth.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        The error, NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> rel(np.array([3.0, 0.0]), np.array([2.0, 0.5]))
    0.75
    """
    p, g = _compared(pred, true, valid, missing)
    return _mean(np.abs(np.subtract(p, g, dtype=np.float64)) / g)


def delta(
    pred: Depth,
    true: Depth,
    valid: Mask | None = None,
    *,
    threshold: float,
    missing: Missing = Missing.COUNTED,
) -> float:
    """Share of pixels with max(pred / true, true / pred) below a threshold.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.
        threshold: above 1, such as 1.05; the ratio must be smaller.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        A share in [0, 1], NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together, or a threshold of 1 or less.

    >>> pred, true = np.array([1.04, 1.2, -1.0]), np.ones(3)
    >>> delta(pred, true, threshold=1.05), delta(pred, true, threshold=1.25)
    (0.3333333333333333, 0.6666666666666666)
    >>> delta(pred, true, threshold=1.05, missing=Missing.AS_GIVEN)  # the negative one passes
    0.6666666666666666
    """
    if not threshold > 1:
        raise ToolkitError("must be above 1", field="threshold", value=threshold)
    p, g = _compared(pred, true, valid, missing)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        return _mean(np.maximum(p / g, g / p) < threshold)


def coverage(pred: Depth, true: Depth, valid: Mask | None = None) -> float:
    """Share of the compared pixels whose prediction is finite and positive.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.

    Returns:
        A share in [0, 1], NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> coverage(np.array([1.0, 0.0, np.nan, 9.0]), np.array([1.0, 1.0, 1.0, 0.0]))
    0.3333333333333333
    """
    p, _ = _compared(pred, true, valid, Missing.AS_GIVEN)
    return _mean(_usable(p))


def depth_errors(
    pred: Depth, true: Depth, valid: Mask | None = None, *, missing: Missing = Missing.COUNTED
) -> Errors:
    """All the above in one pass.

    Args:
        pred: predicted metres, any shape.
        true: true metres, of that shape.
        valid: which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive: `COUNTED` or
            `AS_GIVEN`; the figures of `LEFT_OUT` are those that end in `_answered`.

    Returns:
        The errors.

    Raises:
        ToolkitError: shapes or types that do not belong together, or `LEFT_OUT`.

    >>> e = depth_errors(np.array([1.0, 0.0]), np.array([1.0, 2.0]))
    >>> e.mae, e.mae_answered, e.coverage
    (1.0, 0.0, 0.5)
    """
    p, g = _compared(pred, true, valid, Missing.AS_GIVEN)
    return tally(p, g, np.zeros(len(p), np.intp), 1, missing).of(slice(None))


def _compared(
    pred: Depth, true: Depth, valid: Mask | None, missing: Missing
) -> tuple[Depth, Depth]:
    """Prediction and truth of the pixels that count, (N,) each."""
    for name, array in (("pred", pred), ("true", true)):
        if array.dtype.kind != "f":
            raise ToolkitError("must be floating-point metres", field=name, value=array.dtype)
    check_shapes(pred.shape, true.shape, None if valid is None else valid.shape)
    there = (true > 0) & (true < np.inf)
    if valid is not None:
        there &= valid.astype(np.bool_, copy=False)
    if missing is Missing.LEFT_OUT:
        there &= _usable(pred)
    p, g = as_real(pred[there]), as_real(true[there])
    if missing is Missing.COUNTED:
        p = np.where(_usable(p), p, p.dtype.type(0))
    return p, g


def check_shapes(
    pred: tuple[int, ...], true: tuple[int, ...], valid: tuple[int, ...] | None
) -> None:
    """Refuse what numpy would broadcast.

    Args:
        pred, true, valid: shapes; `valid` may be absent.

    Raises:
        ToolkitError: they differ.

    >>> check_shapes((2, 3), (2, 3), None)
    """
    if pred != true or (valid is not None and valid != pred):
        raise ToolkitError(
            "prediction, ground truth and mask must have one shape",
            value=(pred, true) if valid is None else (pred, true, valid),
            hint="resize the prediction with resize_nearest",
        )


def _usable(pred: Depth) -> Mask:
    return (pred > 0) & (pred < np.inf)


def _mean(values: NDArray[np.generic]) -> float:
    return float(values.mean(dtype=np.float64)) if values.size else float("nan")
