"""`std-bench grasp`: refused input, resumed and parallel runs, the report."""

import json

import numpy as np
import pandas as pd
import pytest
import trimesh

from benchmark.cli.bench import main
from benchmark.cli.report import main as report
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.tasks.grasp import GraspRun
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS

GRASP = ["grasp", "--depth", "gt"]


@pytest.mark.parametrize(
    ("words", "told", "status"),
    [
        (["--planner", "nobody"], "no such planner", 1),
        (["--rounds", "0"], "at least 1", 2),
        (["--seed", "-1"], "at least 0", 2),
        (["--camera", "blurred"], "expected one of quick, simulated", 2),
        (["--split", "std-catknown"], "not an option of std-bench grasp", 2),
        (["--planner", "antipodal", "antipodal"], "twice", 2),
        (["--planner", "oracle", "--weights", "swindrnet=x.safetensors"], "weights", 1),
        (["--iou", "aabb"], "not an option of std-bench grasp", 2),
        (["--meshes", "nowhere"], "folder of assets is not there", 1),
        (["--meshes-unit", "mm"], "belongs to --meshes", 2),
        (["--planner", "antipodal", "oracle", "--label", "mine"], "names one method", 2),
        (["--move", "slow"], "expected one of guarded, straight", 2),
    ],
)
def test_wrong_input_is_one_line(tmp_path, capsys, words, told, status):
    assert main([*GRASP, "--out", str(tmp_path / "out"), *words]) == status
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("error")]
    assert len(lines) == 1
    assert told in lines[0]
    assert not (tmp_path / "out").exists()


def test_a_setting_that_a_planner_does_not_have_keeps_nothing_else(tmp_path, capsys):
    words = ["--planner", "antipodal", "--set", "antipodal.nonsense=1", "--out", str(tmp_path)]
    assert main([*GRASP, *words]) == 1
    assert "nonsense" in capsys.readouterr().err


@pytest.mark.slow
def test_resumed_and_parallel_runs_give_the_same_bytes(tmp_path, capsys):
    pytest.importorskip("mujoco")
    pytest.importorskip("coacd")
    words = [*GRASP, "--planner", "oracle", "--attempts", "1", "--seed", "3"]
    split, whole = tmp_path / "split", tmp_path / "whole"
    for rounds in ("1", "2"):
        assert main([*words, "--rounds", rounds, "--out", str(split), "--engine", "serial"]) == 0
    assert "2 rounds" in capsys.readouterr().err
    assert main([*words, "--rounds", "2", "--out", str(whole), "--workers", "2"]) == 0
    folders = [
        GraspRun(depth=DepthChoice(name="gt"), planner="oracle", rounds=2, seed=3, out=out).folder
        for out in (split, whole)
    ]
    first, second = (f.joinpath(ATTEMPTS).read_bytes() for f in folders)
    assert first == second
    table = pd.read_parquet(folders[0] / ATTEMPTS)
    assert sorted(table["index"].unique()) == [0, 1]
    strips = sorted(p.name for p in (folders[1] / "strips").iterdir())
    assert strips == ["round-0000-attempt-00.png", "round-0001-attempt-00.png"]
    # Another seed does not go into the same folder, and another number of attempts is refused.
    assert main([*words[:-3], "2", "--seed", "3", "--rounds", "2", "--out", str(whole)]) == 1
    assert "attempts" in capsys.readouterr().err
    assert np.isfinite(table.loc[table["executed"], "tip_x"]).all()
    # And std-report makes tables and a page of it.
    assert report([str(whole), "--out", str(tmp_path / "report")]) == 0
    page = (tmp_path / "report" / "report.html").read_text()
    assert "Table clearing" in page and "38.78" in page and "image/webp" in page
    board = pd.read_csv(tmp_path / "report" / "grasping.csv")
    objects = table[table["kind"] == "object"]
    assert board["objects"].tolist() == [len(objects)]
    assert board["grasped"].tolist() == [int((objects["fate"] == "grasped").sum())]


@pytest.mark.slow
def test_own_meshes_stand_on_the_tables(tmp_path, capsys):
    """Boxes of known size in two categories; the planner has a name of its own."""
    pytest.importorskip("mujoco")
    pytest.importorskip("coacd")
    meshes = tmp_path / "blocks"
    for category, size in (("long", (30, 30, 90)), ("flat", (60, 60, 25))):
        (meshes / category).mkdir(parents=True)
        trimesh.creation.box(size).export(meshes / category / "block.ply")
    words = [*GRASP, "--planner", "oracle", "--attempts", "1", "--rounds", "1", "--no-gallery"]
    words += ["--meshes", str(meshes), "--meshes-unit", "mm", "--label", "best", "--json"]
    assert main([*words, "--out", str(tmp_path / "out"), "--engine", "serial"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["camera"], row["planner"]) == ("quick, blocks", "best")
    folder = tmp_path / "out" / "grasp" / "quick-seed0-blocks" / "best" / "gt"
    table = pd.read_parquet(folder / ATTEMPTS)
    things = table[table["kind"] == "object"]
    assert set(things["category"]) <= {"long", "flat"} and len(things) in (4, 5)
    sizes = {
        "long": np.linalg.norm([0.03, 0.03, 0.09]),
        "flat": np.linalg.norm([0.06, 0.06, 0.025]),
    }
    np.testing.assert_allclose(things["diagonal_m"], [sizes[c] for c in things["category"]])
