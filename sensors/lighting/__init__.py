"""Light of the simulator: environment maps from a folder or made here, strengths, floors."""

from sensors.lighting.environment import (
    EnvironmentFolder,
    EnvironmentMap,
    Split,
    read_environment,
    split_of,
)
from sensors.lighting.environment_sources import (
    EnvironmentSource,
    StudioSource,
    environment_source,
    studio_map,
)
from sensors.lighting.light_draw import FloorDraw, LightingDraw, draw_floor, draw_lighting

__all__ = [
    "EnvironmentFolder",
    "EnvironmentMap",
    "EnvironmentSource",
    "FloorDraw",
    "LightingDraw",
    "Split",
    "StudioSource",
    "draw_floor",
    "draw_lighting",
    "environment_source",
    "read_environment",
    "split_of",
    "studio_map",
]
