"""What a simulation leaves on disk: data sets in public layouts, toolkit scenes, recordings."""

from sensors.output.dreds import DredsWriter, dreds_scene, read_record
from sensors.output.frame import SimulatedFrame, SimulatedObject, SimulatedScene
from sensors.output.record import SceneRecord

__all__ = [
    "DredsWriter",
    "SceneRecord",
    "SimulatedFrame",
    "SimulatedObject",
    "SimulatedScene",
    "dreds_scene",
    "read_record",
]
