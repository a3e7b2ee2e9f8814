"""Labelled scenes as tables, and what tells whether a user's files are those of a run."""

import json

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.tasks.grasp import _files_digest
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS
from benchmark.tabletop.scene_tables import open_scene_tables
from benchmark.tabletop.sense import ExactCamera, camera_pose
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, rotation_angle, so3_exp
from std_toolkit.scene import CameraModel, CameraPoses, FramePose, Label, Labels, Object
from std_toolkit.scene.model import ObjectTable, SceneInfo
from std_toolkit.scene.scene import Scene
from tests.benchmark.tabletop.clearing_cases import CAMERA, box, standing
from tests.scene_on_disk import write_frames, write_models

pytest.importorskip("mujoco")
BOXES = {"tall": box((0.04, 0.05, 0.09), "tall"), "low": box((0.06, 0.05, 0.04), "low")}
# The world of a recording is not that of the table, and labels are a little off.
T_WORLD_TABLE = SE3(so3_exp([0.5, -1.1, 0.8]), np.array([0.4, -0.2, 1.3]))
ON_TABLE = {
    "tall": standing(BOXES["tall"], x=-0.11, y=0.02),
    "low": SE3(so3_exp([0, 0, 0.4]), standing(BOXES["low"], x=0.07, y=-0.04).t),
}
MIDDLE = np.array([-0.02, -0.01, 0.0])


def write_labelled(root, *, float_m=0.002, far=0.0):
    """Two boxes on a table, seen by one camera with exact depth."""
    T_table_cam = camera_pose()
    view = ExactCamera(CAMERA, T_table_cam).observe(list(BOXES.values()), list(ON_TABLE.values()))
    frames = write_frames(root, [np.full((*view.depth.shape, 3), 99, np.uint8)], [view.depth])
    meshes = {name: thing.asset.scaled(thing.diagonal_m) for name, thing in BOXES.items()}
    kinds = dict(zip(BOXES, ("transparent", "diffuse"), strict=True))
    objects = [
        Object(id=k, name=f"{name}_1", model=name, material=kinds[name])
        for k, name in enumerate(BOXES, 1)
    ]
    info = SceneInfo(name=root.name, cameras={"color": CameraModel.of(CAMERA)}, depth_scale=0.001)
    table = ObjectTable(models=write_models(root, meshes), objects=objects)
    scene = Scene.create(root, info, frames, table)
    T_world_cam = T_WORLD_TABLE @ T_table_cam
    pose = FramePose(frame=0, status="registered", T_world_cam=T_world_cam.flat())
    scene.save_poses(CameraPoses(frames=[pose], source="test"))
    labels = []
    for k, T in enumerate(ON_TABLE.values(), 1):
        T_world_obj = T_WORLD_TABLE @ SE3(T.R, T.t + np.array([far * (k == 1), 0, float_m]))
        T_cam_obj = T_world_cam.inverse() @ T_world_obj
        labels.append(
            Label(object=k, frame=0, T_cam_obj=T_cam_obj.flat(), T_world_obj=T_world_obj.flat())
        )
    scene.save_labels(Labels(labels=labels))
    return scene


def test_objects_stand_as_in_the_scene(tmp_path):
    write_labelled(tmp_path / "desk")
    arrangement = open_scene_tables(tmp_path).arrange(0, 7)
    assert [o.material.material_class for o in arrangement.objects] == ["transparent", "diffuse"]
    for o, T, true in zip(arrangement.objects, arrangement.poses, ON_TABLE.values(), strict=True):
        assert o.body.diagonal_m == pytest.approx(BOXES[o.body.asset.id].diagonal_m, rel=1e-5)
        # It is seen as in the recording: the axes are those of the table that was recorded.
        np.testing.assert_allclose(T.t, true.t - MIDDLE, atol=0.004)
        assert np.rad2deg(rotation_angle(T.R.T @ true.R)) < 2.5


def test_scenes_that_cannot_be_tables_are_refused(tmp_path, capsys):
    write_labelled(tmp_path / "wide" / "scene", far=1.1)
    with pytest.raises(ToolkitError, match="beyond the table's edge"):
        open_scene_tables(tmp_path / "wide").arrange(0, 7)
    scene = write_labelled(tmp_path / "desk" / "scene")
    scene.save_labels(Labels())
    with pytest.raises(ToolkitError, match="no object of the scene has a pose"):
        open_scene_tables(tmp_path / "desk").arrange(0, 7)
    for words, told, status in (
        (["--scenes", str(tmp_path / "nowhere")], "cannot read the folder", 1),
        (["--scenes", str(tmp_path / "desk"), "--rounds", "2"], "one table for each of 1", 1),
        (["--scenes", str(tmp_path), "--meshes", str(tmp_path)], "--meshes or of --scenes", 2),
    ):
        assert main(["grasp", *words, "--out", str(tmp_path / "out")]) == status
        errors = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error")]
        assert len(errors) == 1 and told in errors[0]


def test_hashes_depend_on_contents(tmp_path):
    """A mesh or a label that changed, in a file of the same name and size, is another table."""
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    found = set()
    for text in ("v 0 0 1", "v 0 0 2", "v 0 0 1"):
        (meshes / "a.obj").write_text(text)
        found.add(_files_digest(meshes))
    assert len(found) == 2
    tables = []
    for float_m in (0.002, 0.003):
        root = tmp_path / str(float_m) / "desk"
        write_labelled(root, float_m=float_m)
        tables.append(open_scene_tables(root.parent))
    assert tables[0].digest() != tables[1].digest()


@pytest.mark.slow
def test_a_scene_is_cleared(tmp_path, capsys):
    write_labelled(tmp_path / "scenes" / "desk")
    words = ["grasp", "--scenes", str(tmp_path / "scenes"), "--depth", "gt", "--json"]
    words += ["--attempts", "1", "--no-gallery", "--engine", "serial"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["camera"] == "quick, scenes" and row["objects"] == 2 and row["rounds"] == 1
    folder = tmp_path / "out" / "grasp" / "quick-seed0-scenes" / "antipodal" / "gt"
    table = pd.read_parquet(folder / ATTEMPTS)
    assert set(table["asset"]) == {"tall", "low", ""}
    assert (table["outcome"] == "held").sum() == 1
