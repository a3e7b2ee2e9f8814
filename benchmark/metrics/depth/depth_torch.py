"""Depth metrics of batches of images in torch, one number per image, on the tensors' device.

The figures are those of `benchmark.metrics.depth.depth_numpy`: ratios in the precision of the
depths, sums in float64. Nothing here waits for the device; nothing carries gradients.
"""

from __future__ import annotations

import torch
from torch import Tensor

from benchmark.metrics.depth.depth_numpy import check_shapes
from benchmark.metrics.depth.tally import NAMES, THRESHOLDS, Missing, check_reportable
from std_toolkit.errors import ToolkitError


def rmse(
    pred: Tensor, true: Tensor, valid: Tensor | None = None, *, missing: Missing = Missing.COUNTED
) -> Tensor:
    """Root of the mean squared error of each image, metres.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        (B,) float64, NaN for images without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> rmse(torch.tensor([[1.0, 2.0]]), torch.tensor([[1.0, 1.0]])).tolist()
    [0.7071067811865476]
    """
    p, g, there = _compared(pred, true, valid, missing)
    return _mean(_error(p, g).square(), there).sqrt()


def mae(
    pred: Tensor, true: Tensor, valid: Tensor | None = None, *, missing: Missing = Missing.COUNTED
) -> Tensor:
    """Mean absolute error of each image, metres.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        (B,) float64, NaN for images without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> mae(torch.tensor([[1.0, 2.0], [0.0, 2.0]]), torch.ones(2, 2)).tolist()
    [0.5, 1.0]
    """
    p, g, there = _compared(pred, true, valid, missing)
    return _mean(_error(p, g), there)


def rel(
    pred: Tensor, true: Tensor, valid: Tensor | None = None, *, missing: Missing = Missing.COUNTED
) -> Tensor:
    """Mean of absolute error / true depth of each image.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        (B,) float64, NaN for images without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> rel(torch.tensor([[3.0, 0.0]]), torch.tensor([[2.0, 0.5]])).tolist()
    [0.75]
    """
    p, g, there = _compared(pred, true, valid, missing)
    return _mean(_error(p, g) / g, there)


def delta(
    pred: Tensor,
    true: Tensor,
    valid: Tensor | None = None,
    *,
    threshold: float,
    missing: Missing = Missing.COUNTED,
) -> Tensor:
    """Share of each image's pixels with max(pred / true, true / pred) below a threshold.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        threshold: above 1, such as 1.05; the ratio must be smaller.
        missing: how pixels count whose prediction is not finite or not positive.

    Returns:
        (B,) float64 shares in [0, 1], NaN for images without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together, or a threshold of 1 or less.

    >>> delta(torch.tensor([[1.04, 1.2, -1.0, 1.0]]), torch.ones(1, 4), threshold=1.05).tolist()
    [0.5]
    """
    if not threshold > 1:
        raise ToolkitError("must be above 1", field="threshold", value=threshold)
    p, g, there = _compared(pred, true, valid, missing)
    return _mean(torch.maximum(p / g, g / p) < threshold, there)


def coverage(pred: Tensor, true: Tensor, valid: Tensor | None = None) -> Tensor:
    """Share of each image's compared pixels whose prediction is finite and positive.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.

    Returns:
        (B,) float64 shares in [0, 1], NaN for images without any pixel to compare.

    Raises:
        ToolkitError: shapes or types that do not belong together.

    >>> coverage(torch.tensor([[1.0, 0.0]]), torch.ones(1, 2)).tolist()
    [0.5]
    """
    p, _, there = _compared(pred, true, valid, Missing.AS_GIVEN)
    return _mean(_usable(p), there)


def depth_errors(
    pred: Tensor, true: Tensor, valid: Tensor | None = None, *, missing: Missing = Missing.COUNTED
) -> dict[str, Tensor]:
    """All the above, and the same over the answered pixels alone.

    Args:
        pred: (B, ...) predicted metres.
        true: (B, ...) true metres.
        valid: (B, ...) bool, which pixels to compare; all by default.
        missing: how pixels count whose prediction is not finite or not positive: `COUNTED` or
            `AS_GIVEN`.

    Returns:
        (B,) tensors by the names of `Errors`: counts int64, all else float64.

    Raises:
        ToolkitError: shapes or types that do not belong together, or `LEFT_OUT`.

    >>> e = depth_errors(torch.tensor([[1.0, 0.0]]), torch.tensor([[1.0, 2.0]]))
    >>> e["mae"].item(), e["mae_answered"].item(), e["coverage"].item()
    (1.0, 0.0, 0.5)
    """
    check_reportable(missing)
    p, g, there = _compared(pred, true, valid, Missing.AS_GIVEN)
    usable = there & _usable(p)
    if missing is not Missing.AS_GIVEN:
        p = torch.where(usable, p, 0)
    worst, error = torch.maximum(p / g, g / p), _error(p, g)
    figures = (error.square(), error / g, error, *(worst < limit for limit in THRESHOLDS))
    n, n_answered = there.sum(dim=1), usable.sum(dim=1)
    found = {"n_pixels": n, "n_answered": n_answered}
    for suffix, among in (("", there), ("_answered", usable)):
        for name, figure in zip(NAMES, figures, strict=True):
            mean = _mean(figure, among)
            found[name + suffix] = mean.sqrt() if name == "rmse" else mean
        if not suffix:
            found["coverage"] = n_answered / n.double()
    return found


def _compared(
    pred: Tensor, true: Tensor, valid: Tensor | None, missing: Missing
) -> tuple[Tensor, Tensor, Tensor]:
    """Prediction, truth and whether the pixel counts, (B, N) each; numbers that do no harm there.

    A batch keeps its shape, where numpy gathers the pixels: images differ in how many they have,
    and asking a device for that number would wait for it.
    """
    for name, tensor in (("pred", pred), ("true", true)):
        if not tensor.is_floating_point():
            raise ToolkitError("must be floating-point metres", field=name, value=str(tensor.dtype))
    check_shapes(
        tuple(pred.shape), tuple(true.shape), None if valid is None else tuple(valid.shape)
    )
    if pred.ndim < 2:
        raise ToolkitError("must be a batch (B, ...)", field="pred", value=tuple(pred.shape))
    p, g = (_real(t.detach()).flatten(1) for t in (pred, true))
    there = (g > 0) & (g < torch.inf)
    if valid is not None:
        there = there & valid.flatten(1).bool()
    if missing is Missing.LEFT_OUT:
        there = there & _usable(p)
    counted = there & _usable(p) if missing is Missing.COUNTED else there
    return torch.where(counted, p, 0), torch.where(there, g, 1), there


def _real(depth: Tensor) -> Tensor:
    return depth if depth.dtype == torch.float64 else depth.float()


def _usable(pred: Tensor) -> Tensor:
    return (pred > 0) & (pred < torch.inf)


def _error(pred: Tensor, true: Tensor) -> Tensor:
    return (pred.double() - true.double()).abs()


def _mean(values: Tensor, there: Tensor) -> Tensor:
    """(B,) float64 means over `there`; 0 / 0 is the NaN of an image without pixels."""
    return torch.where(there, values.double(), 0).sum(dim=1) / there.sum(dim=1).double()
