"""Recover camera poses in metres. Without an argument it records a small synthetic scene first.

python examples/02_recover_camera_poses.py [SCENE]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sensors.synthetic import RecordingOptions, make_recording
from std_toolkit import (
    ImportRequest,
    PoseOptions,
    Scene,
    ToolkitError,
    estimate_poses,
    failed_gates,
    import_recording,
)


def synthetic_scene(folder: Path) -> Scene:
    """Images and depth of a camera that moves around a table, imported as a scene."""
    recording = folder / "recording"
    make_recording(recording, RecordingOptions(frames=16, arc_degrees=50, width=320, height=240))
    request = ImportRequest(
        source=recording / "color",
        name="synthetic",
        color=str(recording / "color"),
        depth=str(recording / "depth"),
        intrinsics=str(recording / "intrinsics.json"),
    )
    return import_recording(request, folder / "scene")


def recover(scene: Scene) -> None:
    poses = estimate_poses(scene, PoseOptions(scale="auto"))
    print(f"{len(scene.registered_frames())} of {len(scene.frames)} frames have a pose")
    if poses.scale is not None:
        print(f"metres from {poses.scale.chosen}")
    for gate in failed_gates(poses):
        print("failed gate:", gate)
    for frame in scene.frames[:3]:
        T_world_cam = scene.T_world_cam(frame.id)
        if T_world_cam is not None:
            print(f"  {frame.name}: camera at {T_world_cam.t.round(3)} m")


if __name__ == "__main__":
    try:
        if len(sys.argv) > 1:
            recover(Scene.open(Path(sys.argv[1])))
        else:
            with TemporaryDirectory() as folder:
                recover(synthetic_scene(Path(folder)))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
