"""An export of the toolkit, scored; and the same numbers from bop_toolkit where it is installed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmark.metrics.bop import (
    BopEstimate,
    ModelDistances,
    open_bop,
    pinhole,
    score_bop,
    score_bop_detection,
)
from std_toolkit.exporters import export_scene
from std_toolkit.geometry import SE3, so3_exp
from tests.std_toolkit.exporters.scene_factory import SERIAL, WORLD_POSES, make_scene

GUIDE = Path(__file__).resolve().parents[4] / "docs" / "bop.md"
BRICK, CAN = 1, 2


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two bricks, with a half turn as discrete symmetry, and a can, as exported."""
    folder = tmp_path_factory.mktemp("scene")
    second = SE3(so3_exp(np.array([0.9, -0.4, 0.2])), np.array([0.13, -0.04, 0.66]))
    poses = {1: WORLD_POSES[1], 4: WORLD_POSES[4], 9: second}
    scene = make_scene(folder / "scene", world_poses=poses, frames=2)
    export_scene(scene, "bop", folder / "bricks", jobs=SERIAL)
    return folder / "bricks"


def filed(root: Path) -> list[BopEstimate]:
    """The true poses, as a method would file them."""
    gt = json.loads((root / "test/000001/scene_gt.json").read_text())
    return [
        BopEstimate(
            1,
            int(image),
            row["obj_id"],
            0.5 + 0.1 * k,
            SE3(np.reshape(row["cam_R_m2c"], (3, 3)), np.array(row["cam_t_m2c"]) / 1000),
        )
        for image, rows in gt.items()
        for k, row in enumerate(rows)
    ]


def half_turn(root: Path) -> SE3:
    """Of the brick, in the frame of its exported model."""
    info = json.loads((root / "models" / "models_info.json").read_text())[str(BRICK)]
    M = np.reshape(info["symmetries_discrete"][0], (4, 4))
    return SE3(M[:3, :3], M[:3, 3] / 1000)


@pytest.mark.slow
def test_two_instances_and_a_discrete_symmetry(root: Path) -> None:
    dataset, estimates = open_bop(root), filed(root)
    counts = {(t.im_id, t.obj_id): t.inst_count for t in dataset.targets}
    assert counts == {(0, BRICK): 2, (0, CAN): 1, (2, BRICK): 2, (2, CAN): 1}
    turned = [
        BopEstimate(e.scene_id, e.im_id, e.obj_id, 1 - e.score, e.T_cam_obj @ half_turn(root))
        if e.obj_id == BRICK
        else e
        for e in reversed(estimates)
    ]
    for found in (estimates, turned):
        scores = score_bop(dataset, found)
        assert scores.mssd == scores.mspd == 1 and scores.targets == 6
        assert score_bop_detection(dataset, found).map == 1
    # The same brick twice: one of the two instances is missed, and the surplus one is wrong.
    same = [e for e in estimates if e.obj_id == CAN]
    same += [e for e in estimates if e.obj_id == BRICK and e.score > 0.6]
    same += [BopEstimate(1, e.im_id, BRICK, 0.1, e.T_cam_obj) for e in same[2:]]
    scores = score_bop(dataset, same, errors=("mssd", "mspd"))
    assert scores.mssd == scores.mspd == pytest.approx(4 / 6)
    assert score_bop_detection(dataset, same).objects[BRICK][0] == pytest.approx(51 / 101)


def snippet() -> str:
    """What the guide says registers a data set with bop_toolkit."""
    (code,) = re.findall(r"```python title=\"sitecustomize.py\"\n(.*?)```", GUIDE.read_text(), re.S)
    return str(code)


def test_the_guide_has_a_snippet() -> None:
    compile(snippet(), str(GUIDE), "exec")


@pytest.mark.slow
def test_bop_toolkit_reads_it_and_agrees(root: Path) -> None:
    pytest.importorskip("bop_toolkit_lib", reason="bop_toolkit is not installed")
    from bop_toolkit_lib import dataset_params, inout, misc, pose_error

    code = re.sub(r"(?m)^NAME = .*$", 'NAME = "bricks"', snippet())
    code = re.sub(r"(?m)^SIZE = .*$", "SIZE = (160, 120)", code)
    code = re.sub(r"(?m)^OBJECTS = .*$", f"OBJECTS = [{BRICK}, {CAN}]", code)
    exec(compile(code, str(GUIDE), "exec"), {})
    split = dataset_params.get_split_params(str(root.parent), "bricks", "test")
    models = dataset_params.get_model_params(str(root.parent), "bricks", "eval")
    gt = inout.load_scene_gt(split["scene_gt_tpath"].format(scene_id=1))
    camera = inout.load_scene_camera(split["scene_camera_tpath"].format(scene_id=1))
    infos = inout.load_json(models["models_info_path"], keys_to_int=True)
    dataset, rng = open_bop(root, symmetry_steps=315), np.random.default_rng(0)
    for image, rows in gt.items():
        for row in rows:
            R = row["cam_R_m2c"] @ so3_exp(rng.normal(0, 0.2, 3))
            t = row["cam_t_m2c"] + rng.normal(0, 8, (3, 1))
            number = row["obj_id"]
            points = inout.load_ply(models["model_tpath"].format(obj_id=number))["pts"]
            symmetries = misc.get_symmetry_transformations(infos[number], 0.01)
            pose = row["cam_R_m2c"], row["cam_t_m2c"], points, symmetries
            model: ModelDistances = dataset.model(number).distances
            ours = [SE3(R, t.ravel() / 1000)], [SE3(pose[0], pose[1].ravel() / 1000)]
            theirs = pose_error.mssd(R, t, *pose)
            assert 1000 * model.mssd(*ours)[0, 0] == pytest.approx(theirs, rel=1e-6)
            theirs = pose_error.mspd(R, t, *pose[:2], camera[image]["cam_K"], *pose[2:])
            project = pinhole(dataset.image(1, image).camera)
            assert model.mspd(*ours, project)[0, 0] == pytest.approx(theirs, rel=1e-6)
