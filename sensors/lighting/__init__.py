"""Light of the simulator: environment maps from a folder or made here, strengths, floors."""

from sensors.lighting.draw import LightingDraw, draw_lighting
from sensors.lighting.environment import EnvironmentMap, read_environment
from sensors.lighting.floor import FloorDraw, draw_floor
from sensors.lighting.folder import EnvironmentFolder, Split, split_of
from sensors.lighting.sources import EnvironmentSource, StudioSource, environment_source
from sensors.lighting.studio import studio_map

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
