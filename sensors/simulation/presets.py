"""Named sets of options."""

from __future__ import annotations

from dataclasses import dataclass

from sensors.simulation.options import SimulationOptions
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Options and the number of scenes; what the command line tells comes before either."""

    scenes: int
    options: SimulationOptions


PRESETS = {
    # The public data set: 30 views a scene, labels of 640x360 beside colour of 1280x720.
    "dreds": Preset(scenes=100, options=SimulationOptions(color_factor=2, quality="better")),
    "draft": Preset(scenes=10, options=SimulationOptions()),
    # For tests and for trying a benchmark.
    "tiny": Preset(
        scenes=4, options=SimulationOptions(views=4, width=320, height=180, quality="rough")
    ),
}


def preset(name: str) -> Preset:
    """The preset called `name`.

    Raises:
        ToolkitError: there is none.
    """
    if name not in PRESETS:
        raise ToolkitError(
            "unknown preset", field="preset", value=name, hint=f"one of {', '.join(PRESETS)}"
        )
    return PRESETS[name]
