"""Depth metrics as pure functions, for arrays of numpy and tensors of torch.

All take predicted and true metres of one shape, and optionally which pixels to compare. Pixels
without ground truth (not finite or not positive) never are. Without any pixel the answer is NaN.
Ratios are taken in the precision of the depths (float32, or float64), sums in float64.
"""

from math import prod
from typing import Any

import numpy as np

from benchmark.metrics.depth.figures import (
    FIGURES,
    Errors,
    Figure,
    Missing,
    Pixels,
    as_real,
    check_reportable,
    delta_figure,
    namespace,
    usable,
)
from benchmark.metrics.depth.tally import tally
from std_toolkit.errors import ToolkitError

_RMSE, _REL, _MAE = FIGURES[:3]


def rmse(
    pred: Any, true: Any, valid: Any | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Root of the mean squared error.

    Args:
        pred, true, valid, missing: as of `mean`.

    Returns:
        Metres, NaN where no pixel is compared.

    Raises:
        ToolkitError: as `mean`.

    >>> rmse(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]))
    0.6454972243679028
    >>> rmse(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]), missing=Missing.LEFT_OUT)
    0.7071067811865476
    """
    return mean(_RMSE, pred, true, valid, missing=missing)


def mae(
    pred: Any, true: Any, valid: Any | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Mean absolute error.

    Args:
        pred, true, valid, missing: as of `mean`.

    Returns:
        Metres, NaN where no pixel is compared.

    Raises:
        ToolkitError: as `mean`.

    >>> mae(np.array([1.0, 2.0, 0.0]), np.array([1.0, 1.0, 0.5]))
    0.5
    """
    return mean(_MAE, pred, true, valid, missing=missing)


def rel(
    pred: Any, true: Any, valid: Any | None = None, *, missing: Missing = Missing.COUNTED
) -> float:
    """Mean of absolute error / true depth.

    Args:
        pred, true, valid, missing: as of `mean`.

    Returns:
        A ratio, NaN where no pixel is compared.

    Raises:
        ToolkitError: as `mean`.

    >>> rel(np.array([3.0, 0.0]), np.array([2.0, 0.5]))
    0.75
    """
    return mean(_REL, pred, true, valid, missing=missing)


def delta(
    pred: Any,
    true: Any,
    valid: Any | None = None,
    *,
    threshold: float,
    missing: Missing = Missing.COUNTED,
) -> float:
    """Share in [0, 1] of pixels with max(pred / true, true / pred) below a threshold.

    Args:
        pred, true, valid, missing: as of `mean`.
        threshold: above 1, such as 1.05; the ratio must be smaller.

    Returns:
        The share, NaN where no pixel is compared.

    Raises:
        ToolkitError: as `mean`, or a threshold of 1 or less.

    >>> pred, true = np.array([1.04, 1.2, -1.0]), np.ones(3)
    >>> delta(pred, true, threshold=1.05), delta(pred, true, threshold=1.25)
    (0.3333333333333333, 0.6666666666666666)
    >>> delta(pred, true, threshold=1.05, missing=Missing.AS_GIVEN)  # the negative one passes
    0.6666666666666666
    """
    return mean(delta_figure(threshold), pred, true, valid, missing=missing)


def coverage(pred: Any, true: Any, valid: Any | None = None) -> float:
    """Share in [0, 1] of the compared pixels whose prediction is finite and positive.

    Args:
        pred, true, valid: as of `mean`.

    Returns:
        The share, NaN where no pixel is compared.

    Raises:
        ToolkitError: as `mean`.

    >>> coverage(np.array([1.0, 0.0, np.nan, 9.0]), np.array([1.0, 1.0, 1.0, 0.0]))
    0.3333333333333333
    """
    p, _ = _gathered(pred, true, valid, Missing.AS_GIVEN)
    return _mean_of(usable(p))


def mean(
    figure: Figure,
    pred: Any,
    true: Any,
    valid: Any | None = None,
    *,
    missing: Missing = Missing.COUNTED,
) -> float:
    """A metric over all pixels.

    Args:
        figure: which one, such as those of `FIGURES`.
        pred: predicted metres, any shape.
        true: true metres, of that shape and kind.
        valid: which pixels to compare, bool; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        The metric, NaN where no pixel is compared.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> mean(FIGURES[0], np.array([1.0, 1.5]), np.array([1.0, 1.0]))
    0.3535533905932738
    """
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        found = _mean_of(figure.of(Pixels(*_gathered(pred, true, valid, missing))))
    return found**0.5 if figure.is_root else found


def depth_errors(
    pred: Any, true: Any, valid: Any | None = None, *, missing: Missing = Missing.COUNTED
) -> Errors:
    """All metrics of an image in numpy in one pass.

    Args:
        pred, true, valid: as of `mean`.
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
    p, g = _gathered(pred, true, valid, Missing.AS_GIVEN)
    return tally(p, g, np.zeros(len(p), np.intp), 1, missing).of(slice(None))


def image_errors(
    pred: Any, true: Any, valid: Any | None = None, *, missing: Missing = Missing.COUNTED
) -> dict[str, Any]:
    """All metrics of each image of a batch, on the device of the tensors.

    Nothing waits for the device; nothing carries gradients.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive: `COUNTED` or
            `AS_GIVEN`.

    Returns:
        (B,) arrays by the names of `Errors`: counts int64, all else float64, NaN for images
        without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together, or `LEFT_OUT`.

    >>> e = image_errors(np.array([[1.0, 0.0]]), np.array([[1.0, 2.0]]))
    >>> e["mae"].item(), e["mae_answered"].item(), e["coverage"].item()
    (1.0, 0.0, 0.5)
    """
    check_reportable(missing)
    pred, true, valid = checked(pred, true, valid)
    if pred.ndim < 2:
        raise ToolkitError("must be a batch (B, ...)", field="pred", value=tuple(pred.shape))
    xp = namespace(pred)
    flat = (len(pred), prod(pred.shape[1:]))
    # A batch keeps its shape, where `mean` gathers pixels: images differ in how many they have, and
    # asking a device for that number would wait for it.
    p, g = as_real(pred).reshape(flat), as_real(true).reshape(flat)
    there = (g > 0) & (g < float("inf"))
    if valid is not None:
        there = there & xp.asarray(valid.reshape(flat), dtype=xp.bool)
    answered = there & usable(p)
    counted = there if missing is Missing.AS_GIVEN else answered
    # Numbers that do no harm where a pixel does not count.
    pixels = Pixels(xp.where(counted, p, 0), xp.where(there, g, 1))
    n, n_answered = there.sum(axis=1), answered.sum(axis=1)
    found = {"n_pixels": n, "n_answered": n_answered}
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        values = [xp.asarray(f.of(pixels), dtype=xp.float64) for f in FIGURES]
        for suffix, among, count in (("", there, n), ("_answered", answered, n_answered)):
            for figure, value in zip(FIGURES, values, strict=True):
                # 0 / 0 is the NaN of an image without pixels.
                each = xp.where(among, value, 0).sum(axis=1) / count
                found[figure.name + suffix] = xp.sqrt(each) if figure.is_root else each
            if not suffix:
                found["coverage"] = n_answered / xp.asarray(n, dtype=xp.float64)
    return found


def checked(pred: Any, true: Any, valid: Any | None) -> tuple[Any, Any, Any]:
    """The arrays without gradients.

    Args:
        pred, true: depth.
        valid: which pixels to compare, or None.

    Returns:
        The three, of one kind.

    Raises:
        ToolkitError: shapes that differ, or depth that is not floating-point.

    >>> checked(np.ones((2, 3)), np.ones((2, 3)), None)[0].shape
    (2, 3)
    """
    xp = namespace(pred)
    for name, array in (("pred", pred), ("true", true)):
        is_real = array.dtype.kind == "f" if xp is np else array.is_floating_point()
        if not is_real:
            raise ToolkitError("must be floating-point metres", field=name, value=str(array.dtype))
    shapes = [tuple(a.shape) for a in (pred, true, valid) if a is not None]
    if len(set(shapes)) > 1:
        raise ToolkitError(
            "prediction, ground truth and mask must have one shape",
            value=tuple(shapes),
            hint="resize the prediction with resize_nearest",
        )
    return (pred, true, valid) if xp is np else (pred.detach(), true.detach(), valid)


def _gathered(pred: Any, true: Any, valid: Any | None, missing: Missing) -> tuple[Any, Any]:
    """Prediction and truth of the pixels that count, (N,) each."""
    pred, true, valid = checked(pred, true, valid)
    xp = namespace(pred)
    there = (true > 0) & (true < float("inf"))
    if valid is not None:
        there = there & xp.asarray(valid, dtype=xp.bool)
    if missing is Missing.LEFT_OUT:
        there = there & usable(pred)
    p, g = as_real(pred[there]), as_real(true[there])
    return (xp.where(usable(p), p, 0), g) if missing is Missing.COUNTED else (p, g)


def _mean_of(values: Any) -> float:
    """Mean in float64, NaN of nothing."""
    if not len(values):
        return float("nan")
    xp = namespace(values)
    return float(xp.asarray(values, dtype=xp.float64).mean())
