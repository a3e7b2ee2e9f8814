"""How many light paths an image gets."""

from __future__ import annotations

from dataclasses import dataclass

from sensors.render.protocol import (
    DRAFT_COLOR,
    DRAFT_INFRARED,
    FINE_INFRARED,
    RenderOptions,
)
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class Quality:
    """Of the two kinds of images."""

    infrared: RenderOptions
    color: RenderOptions


QUALITIES = {
    "rough": Quality(
        infrared=RenderOptions(samples=8, chunk=2), color=RenderOptions(samples=12, chunk=0)
    ),
    "draft": Quality(infrared=DRAFT_INFRARED, color=DRAFT_COLOR),
    "better": Quality(
        infrared=RenderOptions(samples=32, chunk=8), color=RenderOptions(samples=64, chunk=0)
    ),
    "fine": Quality(infrared=FINE_INFRARED, color=RenderOptions(samples=256, chunk=0)),
}


def quality_of(name: str) -> Quality:
    """The quality called `name`.

    Raises:
        ToolkitError: there is none.
    """
    if name not in QUALITIES:
        raise ToolkitError(
            "unknown quality", field="quality", value=name, hint=f"one of {', '.join(QUALITIES)}"
        )
    return QUALITIES[name]
