"""What a simulation leaves on disk: data sets in public layouts, toolkit scenes, recordings.

Every writer is a context manager that takes frames by `add`, in any order; what it writes appears
when all of them were added and the block ends without an error.
"""

from sensors.output.dreds import DredsWriter, dreds_scene, read_record
from sensors.output.recording_writer import RecordingWriter, simulated_recording
from sensors.output.scene_record import SceneRecord
from sensors.output.simulated_frame import SimulatedFrame, SimulatedObject, SimulatedScene
from sensors.output.toolkit_scene import ToolkitSceneWriter, read_simulation, toolkit_scene

__all__ = [
    "DredsWriter",
    "RecordingWriter",
    "SceneRecord",
    "SimulatedFrame",
    "SimulatedObject",
    "SimulatedScene",
    "ToolkitSceneWriter",
    "dreds_scene",
    "read_record",
    "read_simulation",
    "simulated_recording",
    "toolkit_scene",
]
