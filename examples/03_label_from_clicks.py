"""Label an object from points clicked on its mesh and in an image, then propagate the label.

python examples/03_label_from_clicks.py
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
from std_toolkit import JobOptions, ToolkitError, propagate_labels, set_pose, solve_pnp


def main(folder: Path) -> None:
    options = RecordingOptions(frames=3, width=320, height=240, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(workers=1))
    scene = scene_from_truth(folder / "recording", folder / "scene")
    name, frame = scene.objects.objects[0].name, 0
    true_pose = scene.T_cam_obj(frame, scene.objects.object_named(name).id)
    assert true_pose is not None

    # What a person clicks: eight points on the mesh (metres, mesh frame), and where the image
    # shows them (pixels, half a pixel off).
    mesh = scene.mesh(scene.objects.object_named(name).model)
    rng = np.random.default_rng(0)
    points = mesh.vertices[rng.choice(len(mesh.vertices), 8, replace=False)]
    camera = scene.camera(scene.frame(frame))
    pixels = camera.project(true_pose @ points) + rng.normal(0, 0.5, (8, 2))

    found = solve_pnp(points, pixels, camera)
    with scene.lock():
        set_pose(scene, name, frame, found.T_cam_obj, method="pnp", annotator="example")
    propagate_labels(scene)
    off = np.linalg.norm(found.T_cam_obj.t - true_pose.t)
    print(f"{name}: {1000 * off:.1f} mm from the truth")
    for other in scene.frames:
        T_cam_obj = scene.T_cam_obj(other.id, scene.objects.object_named(name).id)
        if T_cam_obj is not None:
            print(f"  {other.name}: at {T_cam_obj.t.round(3)} m in the camera's frame")


if __name__ == "__main__":
    try:
        with TemporaryDirectory() as temporary:
            main(Path(temporary))
    except ToolkitError as error:
        sys.exit(f"error: {error}")
