"""Makes the example of docs/agreement.md: two simulated annotators of one synthetic recording.

    python docs/pictures/two_annotators.py WORK

Anna clicks twelve points of every object in four frames, with 1 px of noise. Ben does so too, but
clicks the glass in the first frame only, takes the handle of the mug to be on the other side, and
leaves out the soup can. What the commands print and the picture of the glass go into the guide.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from annotator.cli import main
from sensors.output.recording_writer import Truth
from sensors.synthetic import RecordingOptions, make_recording
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.labels.entry.label import set_pose
from std_toolkit.labels.entry.pnp import solve_pnp
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import Labels

CLICKS, NOISE_PX = 12, 1.0
FRAMES = (0, 8, 16, 23)
HALF_TURN = so3_exp([0.0, np.pi, 0.0])


def annotate(recording: Path, truth: Truth, root: Path, *, hurried: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = scene_from_truth(recording, root)
    scene.save_labels(Labels())
    for item in truth.objects:
        if hurried and item.name == "soup_can":
            continue
        once = hurried and item.name == "glass"
        vertices = np.asarray(load_mesh(recording / item.mesh).vertices)
        for frame in FRAMES[:1] if once else FRAMES:
            exact = truth.camera_pose(frame).inverse() @ truth.object_pose(item.name)
            camera = scene.camera(scene.frame(frame))
            points = vertices[rng.choice(len(vertices), CLICKS // 2 if once else CLICKS, False)]
            pixels = camera.project(exact @ points) + rng.normal(0, NOISE_PX, (len(points), 2))
            pose = solve_pnp(points, pixels, camera, threshold_px=6.0).T_cam_obj
            if hurried and item.name == "mug":
                pose = SE3(pose.R @ HALF_TURN, pose.t)
            set_pose(
                scene, item.name, frame, pose, method="pnp", annotator=root.name, as_view=frame > 0
            )
    propagate_labels(scene)


if __name__ == "__main__":
    work = Path(sys.argv[1])
    recorded = make_recording(work / "recording", RecordingOptions(frames=24, arc_degrees=100.0))
    annotate(work / "recording", recorded, work / "anna", hurried=False, seed=1)
    annotate(work / "recording", recorded, work / "ben", hurried=True, seed=2)
    main(["compare", str(work / "anna"), str(work / "ben"), "--out", str(work / "review")])
    main(["merge", str(work / "anna"), str(work / "ben"), "--out", str(work / "agreed")])
