"""Two simulated people with a noisy hand label the same synthetic recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from annotator.compare import compare_labels, merge_labels, write_scene
from sensors.output.recording_writer import read_truth
from sensors.synthetic import RecordingOptions, label_errors, make_recording
from sensors.synthetic.truth import scene_from_truth
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.jobs import JobOptions
from std_toolkit.labels.entry.label import set_pose
from std_toolkit.labels.entry.pnp import solve_pnp
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.scene import Labels, Scene

pytestmark = pytest.mark.slow
NOISE_PX = 1.0
CLICKS = 12
PEOPLE = ("anna", "ben")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "recording"
    # Small images of a wide arc: what is compared are poses, clicked in pixels of a large one.
    make_recording(
        folder,
        RecordingOptions(frames=4, arc_degrees=100.0, width=640, height=480, samples=1),
        jobs=JobOptions(progress=False),
    )
    return folder


@pytest.fixture(scope="module")
def scenes(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Scene]:
    folder = tmp_path_factory.mktemp("annotators")
    return [annotate(recording, folder / who, seed) for seed, who in enumerate(PEOPLE)]


def annotate(recording: Path, root: Path, seed: int) -> Scene:
    """Clicks with 1 px noise in all four frames, PnP in each, one pose per object from them."""
    rng = np.random.default_rng([7, seed])
    truth = read_truth(recording)
    scene = scene_from_truth(recording, root)
    scene.save_labels(Labels())
    for item in truth.objects:
        vertices = np.asarray(load_mesh(recording / item.mesh).vertices)
        for frame in range(len(truth.frames)):
            exact = truth.camera_pose(frame).inverse() @ truth.object_pose(item.name)
            camera = scene.camera(scene.frame(frame))
            clicked = vertices[rng.choice(len(vertices), CLICKS, replace=False)]
            pixels = camera.project(exact @ clicked) + rng.normal(0, NOISE_PX, (CLICKS, 2))
            pose = solve_pnp(clicked, pixels, camera, threshold_px=6.0).T_cam_obj
            set_pose(
                scene, item.name, frame, pose, method="pnp", annotator=root.name, as_view=frame > 0
            )
    propagate_labels(scene)
    return Scene.open(root)


def test_two_careful_annotators_agree_to_three_millimetres(scenes: list[Scene]) -> None:
    comparison = compare_labels(*scenes)
    assert len(comparison.objects) == 6
    assert comparison.median_mm <= 3.0
    print(comparison.table.to_string())


def test_what_is_off_by_more_than_five_millimetres_is_flagged(
    scenes: list[Scene], tmp_path: Path, recording: Path
) -> None:
    careless = annotate(recording, tmp_path / "careless", 1)
    label = careless.labels.of(careless.objects.object_named("glass").id)
    assert label is not None
    T = SE3.from_matrix(label.T_cam_obj)
    # One frame only, 12 mm too far away: 0.2 px on the outline of a glass.
    set_pose(careless, "glass", 0, SE3(T.R, T.t * (1 + 0.012 / np.linalg.norm(T.t))))
    propagate_labels(careless)
    comparison = compare_labels(scenes[0], careless)
    flagged = comparison.disagreements[0]
    assert flagged.name == "glass"
    assert 1000 * flagged.worst_m > 5
    assert "along the viewing ray (B is farther)" in flagged.mostly
    assert comparison.median_mm <= 3.0


def test_the_mean_is_nearer_to_the_truth_than_the_two(
    scenes: list[Scene], recording: Path, tmp_path: Path
) -> None:
    merged = write_scene(merge_labels(scenes), tmp_path / "merged")
    assert len(merged.labels.labels) == 6
    alone = [label_errors(s, recording).percentile_mm(50) for s in scenes]
    together = label_errors(merged, recording).percentile_mm(50)
    print(f"median error: {alone[0]:.2f} and {alone[1]:.2f} mm alone, {together:.2f} mm together")
    assert together < max(alone)
    assert together <= 3.0
