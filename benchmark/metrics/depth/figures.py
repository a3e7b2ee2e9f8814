"""Depth metrics: what each is at a pixel, and how it is printed. A new metric is a `Figure` here.

Each is defined once, for arrays of numpy and tensors of torch: the functions used have the same
names in both.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Column

THRESHOLDS = (1.05, 1.10, 1.25)  # of delta: the ratio between prediction and truth either way

# What a depth camera may be off and still be right: the larger of metres and of a share of the
# depth. Fixed, as the thresholds are, so that figures can be compared.
CLOSE_M, CLOSE_SHARE = 0.003, 0.01


class Missing(StrEnum):
    """How pixels count whose prediction is not finite or not positive.

    `COUNTED`: as depth 0, which is what every format here writes for "no measurement": the error
    is the whole true depth, the relative error 1, and no threshold is passed.
    `LEFT_OUT`: not at all; compare it together with coverage, since it favours methods that predict
    few pixels.
    `AS_GIVEN`: with the given number, as in released evaluations: a negative prediction then passes
    every threshold, since its ratio is below all of them.
    """

    COUNTED = "counted"
    LEFT_OUT = "left-out"
    AS_GIVEN = "as-given"


def check_reportable(missing: Missing) -> None:
    """Refuse what cannot be the main figure of a report.

    Args:
        missing: how pixels without a usable prediction are to count.

    Raises:
        ToolkitError: `LEFT_OUT`: such figures stand beside the main ones, as `..._answered`.

    >>> check_reportable(Missing.COUNTED)
    """
    if missing is Missing.LEFT_OUT:
        raise ToolkitError(
            "is no way to count pixels in a report",
            field="missing",
            value=missing.value,
            hint="the figures over answered pixels are always there, as ..._answered",
        )


def namespace(array: Any) -> Any:
    """The module whose functions take an array.

    Args:
        array: of numpy, or a tensor of torch.

    Returns:
        The module numpy or torch.

    >>> namespace(np.zeros(2)).__name__
    'numpy'
    """
    if type(array).__module__.partition(".")[0] == "torch":
        import torch

        return torch
    return np


def as_real(depth: Any) -> Any:
    """Depth as it is computed with.

    Args:
        depth: metres of any floating-point type.

    Returns:
        float64 as it is, shorter types as float32.

    >>> as_real(np.zeros(2, np.float16)).dtype
    dtype('float32')
    """
    xp = namespace(depth)
    return depth if depth.dtype == xp.float64 else xp.asarray(depth, dtype=xp.float32)


def usable(pred: Any) -> Any:
    """Whether predictions are finite and positive.

    Args:
        pred: predicted metres.

    Returns:
        bool, of that shape.

    >>> usable(np.array([1.0, 0.0, np.nan, np.inf]))
    array([ True, False, False, False])
    """
    return (pred > 0) & (pred < float("inf"))


def tolerance(true: Any) -> Any:
    """How far from the truth depth still counts as right: max(3 mm, 1 %).

    Args:
        true: true metres.

    Returns:
        Metres, float64, of that shape and kind.

    >>> tolerance(np.array([0.1, 0.5, 2.0])).tolist()
    [0.003, 0.005, 0.02]
    """
    xp = namespace(true)
    return xp.clip(CLOSE_SHARE * xp.asarray(true, dtype=xp.float64), CLOSE_M, None)


class Pixels:
    """Predictions and truth of pixels, and what several figures are made from.

    Args:
        pred: predicted metres, float32 or float64.
        true: true metres, of the same shape and kind.
    """

    def __init__(self, pred: Any, true: Any) -> None:
        self.xp, self.pred, self.true = namespace(pred), pred, true

    @cached_property
    def error(self) -> Any:
        """Absolute error, metres, float64."""
        xp = self.xp
        error = xp.asarray(self.pred, dtype=xp.float64) - self.true
        return xp.abs(error, out=error)

    @cached_property
    def ratio(self) -> Any:
        """max(pred / true, true / pred), in the precision of the depths as released evaluations
        have it."""
        ratio = self.pred / self.true
        return self.xp.maximum(ratio, self.true / self.pred, out=ratio)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A depth metric: a mean over pixels.

    Attributes:
        column: its name, and how tables show it.
        of: what the mean is taken of; bool for shares of pixels.
        is_share: whether `of` gives bool.
        is_root: whether the metric is the root of the mean.
    """

    column: Column
    of: Callable[[Pixels], Any]
    is_share: bool = False
    is_root: bool = False

    @property
    def name(self) -> str:
        """Name in tables of results and in `Errors`."""
        return self.column.name


def _metres(name: str) -> Column:
    return Column(
        name=name, heading=name.upper(), unit="mm", factor=1e3, published_digits=0,
        lower_is_better=True,
    )  # fmt: skip


def delta_figure(threshold: float) -> Figure:
    """Share of pixels with max(pred / true, true / pred) below a threshold.

    Args:
        threshold: above 1, such as 1.05.

    Returns:
        The metric.

    Raises:
        ToolkitError: a threshold of 1 or less.

    >>> delta_figure(1.05).name
    'd105'
    """
    if not threshold > 1:
        raise ToolkitError("must be above 1", field="threshold", value=threshold)
    column = Column(
        name=f"d{100 * threshold:.0f}", heading=f"δ{threshold:.2f}", unit="%", factor=100, digits=2,
        lower_is_better=False,
    )  # fmt: skip
    return Figure(
        column=column,
        of=lambda pixels: pixels.ratio < threshold,
        is_share=True,
    )


FIGURES = (
    Figure(
        column=_metres("rmse"),
        of=lambda pixels: pixels.error * pixels.error,
        is_root=True,
    ),
    Figure(
        column=Column(
            name="rel", heading="REL", digits=4, published_digits=3, lower_is_better=True
        ),
        of=lambda pixels: pixels.error / pixels.true,
    ),
    Figure(column=_metres("mae"), of=lambda pixels: pixels.error),
    *map(delta_figure, THRESHOLDS),
    Figure(
        column=Column(
            name="within",
            heading="within 3 mm or 1 %",
            unit="%",
            factor=100,
            digits=2,
            lower_is_better=False,
        ),
        of=lambda pixels: pixels.error <= tolerance(pixels.true),
        is_share=True,
    ),
)

NAMES = tuple(figure.name for figure in FIGURES)

COVERAGE = Column(
    name="coverage", heading="answered", unit="%", factor=100, digits=2, lower_is_better=False
)


def shown_columns(*, aligned: bool = False) -> tuple[Column, ...]:
    """Return the columns of all figures and coverage, as tables show them.

    Args:
        aligned: as papers on depth up to scale and shift print them: centimetres, and the relative
            error in percent.

    Returns:
        The columns, coverage last.

    >>> [(c.heading, c.unit) for c in shown_columns(aligned=True)][:2]
    [('RMSE', 'cm'), ('REL', '%')]
    """
    columns = [*(figure.column for figure in FIGURES), COVERAGE]
    if aligned:
        cm, percent = {"unit": "cm", "factor": 1e2, "digits": 2}, {"unit": "%", "factor": 1e2}
        other = {"rmse": cm, "mae": cm, "rel": percent | {"digits": 2}}
        columns = [replace(c, **other.get(c.name, {})) for c in columns]  # type: ignore[arg-type]
    return tuple(columns)


@dataclass(frozen=True)
class Errors:
    """Depth errors of one set of pixels; NaN where it has none.

    Attributes:
        n_pixels: compared pixels; n_answered: those whose prediction is finite and positive.
        rmse, mae: metres; rel: mean of error / true depth; d105, d110, d125: share of pixels whose
            ratio to the truth is below 1.05, 1.10, 1.25; within: of those with an error of at most
            max(3 mm, 1 %); all with missing pixels as asked for.
        coverage: n_answered / n_pixels.
        rmse_answered ... within_answered: the same over the answered pixels alone.
    """

    n_pixels: int
    n_answered: int
    rmse: float
    rel: float
    mae: float
    d105: float
    d110: float
    d125: float
    within: float
    coverage: float
    rmse_answered: float
    rel_answered: float
    mae_answered: float
    d105_answered: float
    d110_answered: float
    d125_answered: float
    within_answered: float

    def as_dict(self) -> dict[str, int | float]:
        """Values by name, in the order above."""
        return {field.name: getattr(self, field.name) for field in fields(self)}
