"""The grasping network that comes with the toolkit, on a table that it has never seen."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.depth_choice import DepthChoice
from benchmark.evaluation.tasks.grasp import GraspRun
from benchmark.evaluation.tasks.grasp_table import ATTEMPTS


@pytest.mark.slow
def test_the_shipped_network_finds_grasps_that_hold_without_any_option(tmp_path: Path):
    """With true depth it holds 3 of 4 attempts there."""
    for module in ("torch", "mujoco", "coacd"):
        pytest.importorskip(module)
    words = ["grasp", "--planner", "graspnet", "--depth", "gt", "--rounds", "1"]
    words += ["--attempts", "4", "--seed", "0", "--no-gallery", "--workers", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    folder = GraspRun(
        depth=DepthChoice(name="gt"), planner="graspnet", rounds=1, seed=0, out=tmp_path
    ).folder
    table = pd.read_parquet(folder / ATTEMPTS)
    assert (table["outcome"] == "held").sum() >= 2
    assert table["ap"].dropna().iloc[0] > 0.02
