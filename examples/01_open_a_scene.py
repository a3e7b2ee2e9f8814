"""Open a scene and look at its frames. Without an argument it records a small synthetic one.

python examples/01_open_a_scene.py [SCENE]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sensors.synthetic import RecordingOptions, make_recording
from std_toolkit import ImportRequest, JobOptions, Scene, ToolkitError, import_recording


def synthetic_scene(folder: Path) -> Scene:
    """A recording of three small frames, imported as a scene."""
    recording = folder / "recording"
    options = RecordingOptions(frames=3, width=160, height=120, samples=1)
    make_recording(recording, options, jobs=JobOptions(workers=1))
    request = ImportRequest(
        source=recording / "color",
        name="synthetic",
        color=str(recording / "color"),
        depth=str(recording / "depth"),
        intrinsics=str(recording / "intrinsics.json"),
    )
    return import_recording(request, folder / "scene")


def show(scene: Scene) -> None:
    print(f"scene {scene.info.name}: {len(scene.frames)} frames")
    for frame in scene.frames:
        print(f"  frame {frame.id}: {frame.name}")


if __name__ == "__main__":
    try:
        if len(sys.argv) > 1:
            show(Scene.open(Path(sys.argv[1])))
        else:
            with TemporaryDirectory() as folder:
                show(synthetic_scene(Path(folder)))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
