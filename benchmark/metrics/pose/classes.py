"""Classes of objects and what of their pose cannot be seen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError

DREDS_CLASSES = ("other", "bottle", "bowl", "camera", "can", "car", "mug", "aeroplane")


@dataclass(frozen=True, kw_only=True)
class PoseClasses:
    """Names and symmetries of classes.

    Attributes:
        names: by number; 0 is what belongs to no class and is never scored.
        round_about_y: look the same after any turn about y.
        upside_down: of those, the ones that also look the same with top and bottom exchanged.
        round_without_handle: look the same after any turn about y while the handle is hidden.

    Raises:
        ToolkitError: names given twice, or symmetries of classes that are not there.
    """

    names: tuple[str, ...] = DREDS_CLASSES
    round_about_y: frozenset[str] = frozenset({"bottle", "bowl", "can"})
    upside_down: frozenset[str] = frozenset()
    round_without_handle: frozenset[str] = frozenset({"mug"})

    def __post_init__(self) -> None:
        if len(self.names) < 2 or len(set(self.names)) < len(self.names):
            raise ToolkitError("needs distinct names, number 0 being none", value=self.names)
        for field in ("round_about_y", "upside_down", "round_without_handle"):
            unknown = getattr(self, field) - set(self.names)
            if unknown:
                raise ToolkitError("no such class", field=field, value=sorted(unknown))
        if not self.upside_down <= self.round_about_y:
            value = sorted(self.upside_down - self.round_about_y)
            raise ToolkitError("must be round about y too", field="upside_down", value=value)

    def are(self, class_ids: NDArray[np.int64], names: Iterable[str]) -> NDArray[np.bool_]:
        """Which numbers are of classes with these names.

        >>> PoseClasses().are(np.array([1, 3]), {"bottle", "can"}).tolist()
        [True, False]
        """
        wanted = set(names)
        return np.array([name in wanted for name in self.names])[class_ids]
