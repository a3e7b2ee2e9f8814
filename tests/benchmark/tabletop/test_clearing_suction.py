"""Suction on simple bodies: what seals is lifted, what is too heavy slips; the planner; a run."""

import json
import pickle

import numpy as np
import pandas as pd
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.tasks.grasp import GraspRun
from benchmark.evaluation.tasks.grasp_results import plan_cells, read_grasp_run
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS
from benchmark.methods.grasp.flat_patches import FlatPatches
from benchmark.methods.protocol import GraspView
from benchmark.methods.registry import MethodOptions
from benchmark.metrics.grasp.gripper import PANDA
from benchmark.metrics.grasp.suction import SuctionCup
from benchmark.tabletop.grasp import execute
from benchmark.tabletop.sense import ExactCamera, camera_pose
from benchmark.tabletop.suction import SuctionTrial
from benchmark.tabletop.trial import LIFT_M
from std_toolkit.errors import ToolkitError
from tests.benchmark.tabletop.clearing_cases import CAMERA, box, from_above, standing

pytest.importorskip("mujoco")
CUP = SuctionCup()
CUBE = box((0.05, 0.05, 0.05), "cube")
TOP = (0.0, 0.0, 0.05)


def _try(tip, mass=0.15, cup=CUP, thing=CUBE):
    grasp = from_above(tip, width=cup.max_width)
    return execute([thing], [standing(thing)], grasp, masses_kg=[mass], gripper=cup)


def test_a_sealed_cube_is_lifted():
    done = _try(TOP)
    assert (done.outcome, done.held, done.touched) == ("held", (0,), (0,))
    assert [s.name for s in done.stages] == ["pre-grasp", "sealed", "lifted"]
    assert done.poses[0].t[2] == pytest.approx(0.025 + LIFT_M, abs=0.005)


@pytest.mark.parametrize(
    ("tip", "outcome"),
    [
        ((0, 0, 0.04), "held"),  # planned too deep: it stops where it touches
        ((0, 0, 0.06), "held"),  # too high: it looks for the surface
        ((0.02, 0, 0.05), "no-seal"),  # over the edge
        ((0, 0.15, 0.05), "no-contact"),
        ((0, 0.15, 0.0), "blocked-by-table"),
        ((0, 0, -0.06), "start-hits-object"),
    ],
)
def test_outcomes(tip, outcome):
    done = _try(tip)
    assert done.outcome == outcome
    assert bool(done.held) == (outcome == "held")


def test_the_load_on_the_lip_is_the_weight():
    trial = SuctionTrial([CUBE], [standing(CUBE)], from_above((0.01, 0, 0.05)), [0.15], CUP)
    assert trial.run().outcome == "held"
    force, torque = trial.load()
    np.testing.assert_allclose(force, [-0.15 * 9.81, 0, 0], atol=1e-3)
    assert np.abs(torque).max() == pytest.approx(0.01 * 0.15 * 9.81, abs=1e-4)


def test_what_is_heavier_than_the_vacuum_slips():
    limit = CUP.suction / 9.81
    assert _try(TOP, mass=0.7 * limit).outcome == "held"
    assert _try(TOP, mass=1.05 * limit).outcome == "slipped"
    # A large cup holds it.
    assert _try(TOP, mass=1.05 * limit, cup=SuctionCup(radius=0.015)).outcome == "held"


def test_the_planner_finds_the_middle_of_the_flat_top():
    view = ExactCamera(CAMERA, camera_pose()).observe([CUBE], [standing(CUBE)])
    T = camera_pose()
    seen = GraspView(
        np.zeros((*view.depth.shape, 3), np.uint8), view.depth, CAMERA,
        T_cam_table=T.inverse().matrix(),
    )  # fmt: skip
    grasps = FlatPatches().plan(seen).transformed(T)
    best = grasps[0]
    assert np.abs(best.tips[0] - TOP).max() < 0.008
    assert best.approaches[0] @ [0, 0, -1] > 0.999
    # No place is nearer to an edge of the top, or of a side, than the lip is wide.
    inside = np.abs(grasps.tips - [0, 0, 0.025]) < 0.025 - 0.5 * CUP.radius
    assert (inside.sum(axis=1) >= 2).all()
    # Where there is no depth nothing is planned.
    holes = GraspView(seen.color, 0 * view.depth, CAMERA, T_cam_table=seen.T_cam_table)
    assert len(FlatPatches().plan(holes)) == 0
    with pytest.raises(ToolkitError, match="cup_radius"):
        FlatPatches(MethodOptions(settings={"cup_radius": "1"}))


def test_the_planner_keeps_the_whole_lip_on_a_bar():
    """A cup of 20 mm on a bar of 28 mm may be 4 mm beside its middle; a pixel is 1 mm wide."""
    bar, T, camera = box((0.028, 0.1, 0.05)), camera_pose(), CAMERA.resized(848, 480)
    depth = ExactCamera(camera, T).observe([bar], [standing(bar)]).depth
    color = np.zeros((*depth.shape, 3), np.uint8)
    seen = GraspView(color, depth, camera, T_cam_table=T.inverse().matrix())
    tips = FlatPatches().plan(seen).transformed(T).tips
    top = tips[tips[:, 2] > 0.045]
    assert len(top) > 5
    assert np.abs(top[:, 0]).max() < 0.0065


@pytest.mark.parametrize(
    ("words", "told", "status"),
    [
        (["--planner", "antipodal"], "the planner is for a jaw, the gripper is a suction", 1),
        (["--planner", "oracle"], "plans for the jaw alone", 1),
        (["--cup-radius", "0.2"], "cup-radius", 2),
        (["--move", "straight"], "a move of the jaw", 2),
    ],
)
def test_wrong_input_is_one_line(tmp_path, capsys, words, told, status):
    command = ["grasp", "--gripper", "suction", "--out", str(tmp_path / "out")]
    assert main([*command, *words]) == status
    errors = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error")]
    assert len(errors) == 1 and told in errors[0]
    assert main([*command[:1], *command[3:], "--cup-radius", "0.01"]) == 2
    assert "belongs to --gripper suction" in capsys.readouterr().err


def test_the_folder_is_the_same_in_another_process(tmp_path):
    depth, out = DepthChoice(name="gt"), tmp_path
    for gripper, name in ((PANDA, "quick-seed0"), (CUP, "quick-seed0-suction-10mm")):
        run = GraspRun(depth=depth, planner="antipodal", rounds=1, seed=0, out=out, gripper=gripper)
        assert pickle.loads(pickle.dumps(run)).folder == run.folder
        assert run.folder == out / "grasp" / name / "antipodal" / "gt"


@pytest.mark.slow
def test_a_table_is_cleared_by_suction(tmp_path, capsys):
    pytest.importorskip("coacd")
    meshes = tmp_path / "blocks"
    (meshes / "block").mkdir(parents=True)
    trimesh.creation.box((0.05, 0.05, 0.04)).export(meshes / "block" / "block.ply")
    words = ["grasp", "--gripper", "suction", "--depth", "gt", "--rounds", "1", "--attempts", "2"]
    words += ["--meshes", str(meshes), "--meshes-unit", "m", "--engine", "serial", "--json"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["camera"] == "quick, blocks, suction-10mm" and row["planner"] == "flat-patches"
    folder = tmp_path / "out/grasp/quick-seed0-blocks-suction-10mm/flat-patches/gt"
    table = pd.read_parquet(folder / ATTEMPTS)
    tried = table[table["kind"] == "attempt"]
    assert (tried["outcome"] == "held").all() and len(tried) == 2
    # GraspNet's precision is that of a jaw: a dash.
    assert table["ap"].isna().all()
    result = read_grasp_run(folder)
    assert plan_cells(result)[-3:] == ["-", "-", "-"] and plan_cells(result)[2] == "1"
    assert len(list((folder / "strips").iterdir())) == 2
