"""Options of comparisons of labels, without expensive imports."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Annotated

import msgspec

from std_toolkit.errors import ToolkitError, check_options


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of the comparison of labels."""

    threshold_mm: Annotated[float, msgspec.Meta(gt=0)] = 5.0
    """largest MSSD at which two labels agree, in the annotated frame and in the median over all
    common frames"""
    as_annotated: bool = False
    """take the poses as set by hand, before any refinement over several frames"""

    def __post_init__(self) -> None:
        check_options(self)
        if not isfinite(self.threshold_mm):
            raise ToolkitError("must be finite", field="threshold_mm", value=self.threshold_mm)
