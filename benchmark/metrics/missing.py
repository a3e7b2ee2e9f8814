"""What a pixel without a usable prediction does to an error."""

from __future__ import annotations

from enum import StrEnum

from std_toolkit.errors import ToolkitError

THRESHOLDS = (1.05, 1.10, 1.25)  # of delta: the ratio between prediction and truth either way


class Missing(StrEnum):
    """How pixels count whose prediction is not finite or not positive.

    `COUNTED`: as depth 0, which is what every format here writes for "no measurement": the error
    is the whole true depth, the relative error 1, and no threshold is passed.
    `LEFT_OUT`: not at all; read beside coverage, or a method wins by answering little.
    `AS_GIVEN`: with the number that stands there, as released evaluations do: a negative
    prediction then passes every threshold, since its ratio is below all of them.
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
