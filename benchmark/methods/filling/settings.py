"""The settings that all filling methods share, and how a setting's range is checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class FillSettings:
    """What every filling method can be told.

    Attributes:
        mask: `holes` fills pixels without a measurement; `objects` first drops the measurements
            inside the view's mask, because the sensor's depth of transparent and specular objects
            is often wrong and not missing.
        grow_px: by how many pixels `objects` widens the mask before it drops; measurements beside
            such an object are often wrong too.
        speckle_px: connected patches of fewer measured pixels than this stay, but nothing is
            filled from them: a wild measurement in the middle of a hole would fill half of it.

    Raises:
        ToolkitError: a value outside its range.
    """

    mask: Literal["holes", "objects"] = "holes"
    grow_px: int = 0
    speckle_px: int = 0

    def __post_init__(self) -> None:
        check_range("grow_px", self.grow_px, 0, 200)
        check_range("speckle_px", self.speckle_px, 0, 1_000_000)


def check_range(name: str, value: float, least: float, most: float) -> None:
    """Refuses a setting that is not a number from `least` to `most`.

    Raises:
        ToolkitError: it is outside, or NaN.
    """
    if not least <= value <= most:
        raise ToolkitError(f"must be from {least:g} to {most:g}", field=name, value=value)
