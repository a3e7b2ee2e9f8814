"""A refined scale reaches everything that is in metres, and the pipeline takes it for done."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.artefact import Artefact, record_path
from std_toolkit.labels.entry.label import add_model, add_object, set_pose
from std_toolkit.labels.propagate import propagate_labels
from std_toolkit.poses.publish import SPARSE, publish_model, rescaled_poses, work_folder
from std_toolkit.scene import Scene
from std_toolkit.scene.model import ScaleEstimate, ScaleReport

FACTOR = 0.98
ESTIMATES = [
    ScaleEstimate(source=s, factor=f, spread=0.01, standard_error=0.001, count=9)
    for s, f in (("depth", 1.0), ("objects", FACTOR))
]
# What is stored here does not agree with the estimates.
REPORT = ScaleReport(unit="metre", chosen="objects", estimates=ESTIMATES, disagreement=0.0)


@pytest.fixture
def reconstructed(scene):
    """The scene with a published COLMAP model and the record of the step that made it."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_points3D = 20
    model = pycolmap.synthesize_dataset(options)
    with work_folder(scene.root) as work:
        written = publish_model(scene.root, model, work)
    outputs = [scene.root / "poses.json", *written]
    Artefact(scene.root, "poses", {}).write(outputs)
    return scene


def test_cameras_and_points_are_scaled_alike(reconstructed):
    before = pycolmap.Reconstruction(reconstructed.root / SPARSE)
    centre = reconstructed.T_world_cam(1).t
    with rescaled_poses(reconstructed, FACTOR, REPORT):
        pass
    after = pycolmap.Reconstruction(reconstructed.root / SPARSE)
    scene = Scene.open(reconstructed.root)
    assert np.allclose(scene.T_world_cam(1).t, FACTOR * centre)
    for key, point in before.points3D.items():
        assert np.allclose(after.points3D[key].xyz, FACTOR * point.xyz)
    for key, image in before.images.items():
        assert np.allclose(
            after.images[key].projection_center(), FACTOR * image.projection_center()
        )
    saved = scene.poses.scale
    assert (saved.chosen, saved.estimates[-1].source) == ("objects", "objects")
    assert saved.disagreement == pytest.approx(1 / FACTOR - 1)
    assert [e.deviation for e in saved.estimates] == [e.sigma for e in ESTIMATES]


def test_the_step_that_made_the_poses_stays_done(reconstructed):
    with rescaled_poses(reconstructed, FACTOR, REPORT):
        assert not Artefact(reconstructed.root, "poses", {}).is_kept()
    assert Artefact(reconstructed.root, "poses", {}).is_kept()


def test_a_record_of_another_form_is_left_alone(reconstructed):
    path = record_path(reconstructed.root, "check")
    path.write_text('{"step": "check", "digest": "12", "parameters": {}}')
    with rescaled_poses(reconstructed, FACTOR, REPORT):
        pass
    assert path.read_text().startswith('{"step"')


def test_a_run_that_dies_in_between_recovers_the_poses_again(reconstructed):
    with pytest.raises(KeyboardInterrupt), rescaled_poses(reconstructed, FACTOR, REPORT):
        raise KeyboardInterrupt
    assert not Artefact(reconstructed.root, "poses", {}).is_kept()


def test_poses_of_unknown_unit_carry_no_labels(scene, box_path):
    import msgspec

    add_model(scene, box_path)
    add_object(scene, "box", model="box")
    set_pose(scene, "box", 0, scene.T_world_cam(0))
    unknown = ScaleReport(unit="unknown", chosen="none")
    scene.save_poses(msgspec.structs.replace(scene.poses, scale=unknown))
    with pytest.raises(ToolkitError, match="unit of these camera poses is unknown"):
        propagate_labels(scene)
