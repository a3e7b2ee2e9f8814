"""The smallest scale with everything in it: simulator, packs, three networks, scores, page.

`make test` has it without the simulator, in test_recipe_run.py, and the simulator without it.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest

from benchmark.cli.train import main
from benchmark.recipes.recipe_page import CSV, PAGE
from benchmark.recipes.recipe_table import MEASURED
from std_toolkit.io.documents import read_document
from std_toolkit.jobs import JobOptions

SIMULATOR = ("mitsuba", "mujoco", "coacd", "manifold3d")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        any(find_spec(package) is None for package in SIMULATOR),
        reason="the simulator's extra is not installed",
    ),
]
HERE = ["--accelerator", "cpu", "--readers", "0"]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The main comparison at the scale `tiny`; its sets serve all tests here."""
    folder = tmp_path_factory.mktemp("recipe_simulated") / "out"
    assert main(["recipe", "main-comparison", "--scale", "tiny", "--out", str(folder), *HERE]) == 0
    return folder


@pytest.mark.long
def test_the_main_comparison_runs_from_nothing_to_its_page(out: Path) -> None:
    rows = pd.read_csv(out / "tiny" / "main-comparison" / CSV)
    measured = rows[rows["kind"] == MEASURED]
    assert set(measured["variant"]) == {"raw", "nearest", "NLSPN", "LIDF", "SwinDRNet"}
    assert set(measured["test"]) == {"dreds-catknown-test"}
    assert set(measured["data"]) == {"simulated by std-sim: 1 scene of 2 views"}
    assert measured["rmse"].between(0.001, 2).all()
    page = (out / "tiny" / "main-comparison" / PAGE).read_text()
    assert page.count("not available") >= 3
    assert page.count("data:image/webp") >= 5


@pytest.mark.long
def test_sim_to_real_takes_a_set_that_is_there(out: Path, tmp_path: Path) -> None:
    data = out / "tiny" / "data"
    line = ["recipe", "sim-to-real", "--scale", "tiny", "--out", str(tmp_path / "o"), *HERE]
    given = ["--train-data", str(data / "train"), "--test-data", str(data / "test")]
    assert main([*line, *given]) == 0
    assert not (tmp_path / "o" / "tiny" / "data").exists()
    rows = pd.read_csv(tmp_path / "o" / "tiny" / "sim-to-real" / CSV)
    measured = rows[rows["kind"] == MEASURED]
    assert measured["variant"].nunique() == 3
    assert measured["data"].str.startswith("from ").all()


def test_cut_packs_are_what_the_simulator_would_render(tiny_dreds: Path, tmp_path: Path) -> None:
    """`std-train pack --raw cut` of simulated depth, and `std-sim --depth cut` packed as it is."""
    from benchmark.training.options import PackOptions
    from benchmark.training.pack import pack_split
    from benchmark.training.packed_frames import PackedFrames
    from sensors.simulation.simulated_set import SET_FILE, SetRecord, simulate_set

    options = read_document(tiny_dreds / SET_FILE, SetRecord).options
    rendered = tmp_path / "rendered"
    cut = msgspec.structs.replace(options, depth="cut")
    jobs = JobOptions(engine="serial", progress=False)
    simulate_set(rendered, cut, [0], jobs=jobs).raise_if_failed()
    split = "dreds-catknown-train"
    for folder, root, raw in (("a", tiny_dreds, "cut"), ("b", rendered, "sensor")):
        pack_split(tmp_path / folder, split, root, PackOptions(size=(64, 64), raw=raw), jobs)
    one, other = PackedFrames([tmp_path / "a"]), PackedFrames([tmp_path / "b"])
    assert len(one) == len(other) == 2
    for i in range(2):
        a, b = one.record(i), other.record(i)
        for name in ("color", "raw", "true", "mask", "materials"):
            assert np.array_equal(a[name], b[name]), name
        assert 0 < (a["raw"] == 0).mean() < 1
