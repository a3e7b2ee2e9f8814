"""Modules are found under their names of version 0.1, too, and are the same modules."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from std_toolkit.plugins import RENAMED
from tests.dreds_on_disk import write_std_scene

REPOSITORY = Path(__file__).resolve().parents[2]
PLUG_IN = """
from benchmark.methods.protocol import Restored
from benchmark.methods.settings import MethodOptions
from benchmark.pose_methods.protocol import Estimated


class Same:
    input_size = None
    needs_mask = False

    def __init__(self, options: MethodOptions) -> None:
        pass

    def restore(self, views):
        return [Restored(view.depth) for view in views]
"""
# What the guides imported from modules that have another name now.
NAMES = {
    "benchmark.data.selection": ("selection_of",),
    "benchmark.data.source": ("iterate",),
    "benchmark.grasping": ("PANDA", "Grasps"),
    "benchmark.grasping.collision": ("Cloud", "hits_mesh", "hits_plane"),
    "benchmark.grasping.force_closure": ("GraspedMesh",),
    "benchmark.methods.cleargrasp.global_optimization": ("normals_to_opencv", "optimize_depth"),
    "benchmark.methods.settings": ("MethodOptions", "configured"),
    "benchmark.pose_methods.fitting": ("FitSettings", "fit_pose"),
    "benchmark.pose_methods.protocol": ("Estimated",),
    "benchmark.pose_running.results": ("read_pose_results",),
    "benchmark.pose_running.scoring": ("score_run",),
    "benchmark.protocols": ("get_protocol", "score_frame", "score_sensor"),
    "benchmark.protocols.summary": ("summarise",),
    "benchmark.running.results": ("read_results",),
    "std_toolkit.checks.step": ("run_check",),
    "std_toolkit.geometry.depth": ("unproject_depth",),
    "std_toolkit.labels.refine.auto": ("refine_objects",),
    "std_toolkit.labels.refine.solver": ("refine_poses",),
    "std_toolkit.poses.scale": ("ScaleContext", "ScaleSource"),
    "std_toolkit.poses.step": ("estimate_poses",),
}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("old", sorted(set(RENAMED) - {"std_toolkit.poses.scale"}))
def test_an_old_name_gives_the_very_module(old: str) -> None:
    assert importlib.import_module(old) is importlib.import_module(RENAMED[old])


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("old", NAMES)
def test_the_names_that_guides_import_are_there(old: str) -> None:
    module = importlib.import_module(old)
    assert [name for name in NAMES[old] if not hasattr(module, name)] == []


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_modules_below_a_renamed_package_load_once() -> None:
    old = importlib.import_module("benchmark.grasping.gripper")
    assert old is importlib.import_module("benchmark.metrics.grasp.gripper")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("benchmark.grasping.nothing")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("benchmark.running.nothing")


def test_an_old_name_warns_where_it_is_imported(tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text("import std_toolkit.poses.step\n")
    done = subprocess.run(
        [sys.executable, "-W", "always::DeprecationWarning", "old.py"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(REPOSITORY), "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "old.py:1: DeprecationWarning: std_toolkit.poses.step is now" in done.stderr


@pytest.mark.slow
def test_a_plug_in_for_the_first_version_is_scored(tmp_path: Path) -> None:
    (tmp_path / "my_methods.py").write_text(PLUG_IN, encoding="utf-8")
    write_std_scene(tmp_path / "ROOT/STD-CatKnown/test_0", frames=1)
    command = (
        "--method my_methods:Same --data ROOT --split std-catknown --out results "
        "--no-speed --engine serial"
    )
    done = subprocess.run(
        [sys.executable, "-m", "benchmark.cli.bench", *command.split()],
        cwd=tmp_path,
        env={"PYTHONPATH": f".:{REPOSITORY}", "PATH": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
