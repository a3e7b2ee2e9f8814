"""The examples run as they are, without data, and stay short; so do those of docstrings."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
WITH_DOCTESTS = [
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)
    for package in ("std_toolkit", "annotator", "benchmark", "sensors")
    for path in sorted((REPOSITORY / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60


# What each prints when it runs without data.
PRINTED = {
    "01_open_a_scene": "scene synthetic: 3 frames",
    "02_recover_camera_poses": "16 of 16 frames have a pose",
    "03_label_from_clicks": "mm from the truth",
    "04_render_ground_truth": "glass: ",
    "05_depth_metrics": "50% of its pixels have depth",
    "06_score_a_restorer": "nearest  specular+transparent",
    "07_write_your_own_restorer": "07_write_your_own_restorer.py.MedianDepth",
    "08_read_results_with_pandas": "specular+transparent",
}


def test_each_example_is_known() -> None:
    assert [path.stem for path in EXAMPLES] == list(PRINTED)


@pytest.mark.slow
@pytest.mark.parametrize("name", PRINTED)
def test_an_example_runs_without_data(name: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / f"examples/{name}.py")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert PRINTED[name] in done.stdout


def test_the_front_door_loads_no_heavy_library(tmp_path: Path) -> None:
    """The names that the examples take from `std_toolkit` cost nothing until they are used."""
    code = (
        "import sys, std_toolkit\n"
        "assert {'Scene', 'estimate_poses', 'render_ground_truth'} <= set(dir(std_toolkit))\n"
        "print(sorted({'pycolmap', 'open3d', 'torch', 'numpy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_DOCTESTS)
def test_the_examples_of_docstrings_run(name: str) -> None:
    if name.endswith("_torch") or name.startswith("benchmark.training."):
        pytest.importorskip("torch")
    module = importlib.import_module(name)
    found = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted and not found.failed
