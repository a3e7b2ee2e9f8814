"""Render depth, masks, NOCS and normals of a labelled scene, and read them.

python examples/04_render_ground_truth.py [SCENE]
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
from std_toolkit import (
    JobOptions,
    Scene,
    ToolkitError,
    read_ground_truth,
    render_ground_truth,
    rendered_frames,
)


def synthetic_scene(folder: Path) -> Scene:
    """A labelled scene of two small frames."""
    options = RecordingOptions(frames=2, width=160, height=120, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    return scene_from_truth(folder / "recording", folder / "scene")


def render(scene: Scene) -> None:
    with scene.lock():
        render_ground_truth(scene).raise_if_failed()
    for frame_id in rendered_frames(scene):
        truth = read_ground_truth(scene, frame_id)
        known = truth.depth > 0  # metres; 0 is no object
        print(f"frame {scene.frame(frame_id).name}: {known.mean():.0%} of the pixels show objects")
        print(f"  depth {truth.depth[known].min():.3f} to {truth.depth[known].max():.3f} m")
        for item in truth.info.objects:
            name = next(o.name for o in scene.objects.objects if o.id == item.object)
            print(f"  {name}: {item.visible_fraction:.0%} visible")


if __name__ == "__main__":
    try:
        if len(sys.argv) > 1:
            render(Scene.open(Path(sys.argv[1])))
        else:
            with TemporaryDirectory() as folder:
                render(synthetic_scene(Path(folder)))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
