"""A package of tests that costs more than its budget makes the run fail."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.timings import BUDGET_S, Timings

REPOSITORY = Path(__file__).resolve().parent.parent
BURN = """
import time

def test():
    end = time.process_time() + 2
    while time.process_time() < end:
        pass
"""


def test_every_package_has_a_budget() -> None:
    folders = {path.parent.name for path in (REPOSITORY / "tests").glob("*/conftest.py")}
    assert {"std_toolkit", *folders} - {"tests"} <= {*BUDGET_S}


def test_a_test_counts_for_its_package() -> None:
    timings = Timings()
    timings.add("tests/sensors/stereo/test_a.py::test", BUDGET_S["sensors"] + 1)
    timings.add("tests/test_examples.py::test[a/b]", 3)
    assert timings.over() == ["sensors"]
    assert dict(timings.spent_s)[""] == 3


def test_a_slow_machine_has_more_time() -> None:
    timings = Timings()
    timings.add("tests/sensors/stereo/test_a.py::test", 1.5 * BUDGET_S["sensors"])
    timings.slowness = 2.0
    assert timings.over() == []
    timings.slowness = 1.0
    timings.measure_slowness()
    assert 1.0 <= timings.slowness < 20


@pytest.mark.slow
@pytest.mark.parametrize(("budget", "status"), [(0.5, 1), (100.0, 0)])
@pytest.mark.parametrize("workers", [0, 1])
def test_a_run_over_its_budget_fails(
    tmp_path: Path, budget: float, status: int, workers: int
) -> None:
    (tmp_path / "tests" / "sensors").mkdir(parents=True)
    (tmp_path / "tests" / "sensors" / "test_burn.py").write_text(BURN)
    (tmp_path / "cheap.py").write_text(
        f"import tests.timings\ntests.timings.BUDGET_S['sensors'] = {budget}\n"
    )
    words = f"-q -W ignore -p cheap -p tests.conftest -p no:cacheprovider -n {workers} --rootdir ."
    env = {name: text for name, text in os.environ.items() if not name.startswith("PYTEST")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words.split(), "tests"],
        cwd=tmp_path,
        env=env | {"PYTHONPATH": f"{REPOSITORY}:{tmp_path}"},
        capture_output=True,
        text=True,
    )
    assert "1 passed" in done.stdout, done.stdout + done.stderr
    assert done.returncode == status, done.stdout
