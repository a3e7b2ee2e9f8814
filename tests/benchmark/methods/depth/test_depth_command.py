"""Depth restorers that are programs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli.bench import main
from benchmark.evaluation.results import TABLE
from benchmark.methods.protocol import View
from benchmark.methods.registry import MethodOptions, make_restorer
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from tests.benchmark.evaluation.bench_set import SPLIT, write_split

# Reads the list as any library would, and fills holes with 0.7 m.
PROGRAM = """
import csv, sys, numpy as np, cv2
from pathlib import Path
with open(sys.argv[-1], newline="") as file:
    for row in csv.DictReader(file):
        color = cv2.imread(row["color"])
        raw = cv2.imread(row["raw"], -1) * float(row["raw_unit_m"])
        assert color.shape[:2] == raw.shape == (int(row["height"]), int(row["width"]))
        assert float(row["fx"]) > 0
        Path(row["out"]).parent.mkdir(parents=True, exist_ok=True)
        np.save(row["out"], np.where(raw > 0, raw, 0.7).astype(np.float32))
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("program") / "fill.py"
    path.write_text(PROGRAM)
    return path


def views(count: int = 2) -> list[View]:
    rng = np.random.default_rng(2)
    camera = Camera(16, 12, 20.0, 21.0, 8.0, 6.0)
    found = []
    for _ in range(count):
        depth = rng.uniform(0.4, 0.9, (12, 16)).astype(np.float32)
        depth[:4] = 0
        found.append(View(rng.integers(0, 256, (12, 16, 3), dtype=np.uint8), depth, camera))
    return found


def test_a_program_restores_a_batch(program: Path) -> None:
    method = make_restorer(f"command:{sys.executable} {program}")
    given = views()
    for view, found in zip(given, method.restore(given), strict=True):
        np.testing.assert_allclose(found.depth[4:], view.depth[4:], atol=5.1e-5)
        assert (found.depth[:4] == np.float32(0.7)).all()
    assert method.restore([]) == []
    named = make_restorer(f"command:{sys.executable} {program} --frames {{list}}")
    assert named.words[-1] == "{list}"


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("raise SystemExit('no GPU here')", "status 1: no GPU here"),
        ("pass", r"wrote no depth of a frame .*000000\.npy"),
        ("import time; time.sleep(60)", "took longer than 1 s"),
        (PROGRAM.replace("0.7)", "0.7)[:5]"), "size of colour"),
    ],
)
def test_a_program_that_fails(code: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.py"
    path.write_text(code)
    timeout = "1" if "sleep" in code else "60"
    options = MethodOptions(settings={"timeout_s": timeout})
    method = make_restorer(f"command:{sys.executable} {path}", options)
    with pytest.raises(ToolkitError) as caught:
        method.restore(views())

    assert re.search(told, str(caught.value)), str(caught.value)


@pytest.mark.parametrize("name", ["command:", "command:'open"])
def test_no_command(name: str) -> None:
    with pytest.raises(ToolkitError, match=r"program|not a command"):
        make_restorer(name)


def test_in_the_benchmark(program: Path, tmp_path: Path) -> None:
    root = write_split(tmp_path / "data", scenes=1, frames=2)
    name = f"command:{sys.executable} {program}"
    words = ["depth", "--data", str(root), "--split", SPLIT, "--out", str(tmp_path / "out")]
    words += ["--engine", "serial", "--no-gallery", "--no-speed", "--set", "timeout_s=60"]
    assert main([*words, "--method", name, "--label", "filled"]) == 0
    table = pd.read_parquet(tmp_path / "out" / SPLIT / "filled" / "strict" / TABLE)
    assert (table["error"] == "").all()
    assert (table.loc[table["n_pixels"] > 0, "coverage"] == 1).all()
