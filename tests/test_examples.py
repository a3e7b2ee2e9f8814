"""The examples run as they are, without data, and stay short; so do those of docstrings."""

from __future__ import annotations

import doctest
import importlib
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
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
    "06_score_a_restorer": "specular+transparent",
    "07_write_your_own_restorer": "MedianDepth specular+transparent",
    "08_read_results_with_pandas": "specular+transparent",
    "09_scan_an_object": "scanned: ",
}


def test_each_example_is_known() -> None:
    assert [path.stem for path in EXAMPLES] == list(PRINTED)


def test_the_node_for_ros_converts_images() -> None:
    """It runs where ROS 2 is installed; here it is compiled, and its conversions are tried."""
    node = runpy.run_path(str(REPOSITORY / "examples/ros2/restore_depth_node.py"))
    depth = np.array([[0, 1500, 2], [3, 4, 65535]], ">u2")
    rows = np.zeros((2, 8), np.uint8)  # rows may be padded
    rows[:, :6] = depth.view(np.uint8)
    size = {"height": 2, "width": 3, "step": 8}
    message = SimpleNamespace(encoding="16UC1", is_bigendian=1, data=rows.tobytes(), **size)
    assert np.allclose(node["depth_of"](message), depth * 0.001)
    sent = node["fill_message"](SimpleNamespace(), depth.astype(np.float32), "header")
    assert np.array_equal(node["depth_of"](sent), depth) and sent.header == "header"
    color = np.arange(18, dtype=np.uint8).reshape(2, 3, 3)
    size["step"] = 9
    for encoding, image in (("rgb8", color), ("bgr8", color[..., ::-1])):
        message = SimpleNamespace(encoding=encoding, data=image.tobytes(), **size)
        assert np.array_equal(node["color_of"](message), color)
    with pytest.raises(ValueError, match="mono8"):
        node["color_of"](SimpleNamespace(encoding="mono8"))


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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["01_open_a_scene", "04_render_ground_truth"])
def test_an_example_prints_an_error_as_one_line(name: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / f"examples/{name}.py"), str(tmp_path / "nothing")],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert [line[:7] for line in done.stderr.splitlines()] == ["error: "]
