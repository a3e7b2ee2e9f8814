"""Frames spread over a Ray cluster: the same table as in one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.evaluation.engine import run_task
from benchmark.evaluation.results import TABLE
from std_toolkit.jobs import JobOptions
from tests.benchmark.evaluation.bench_set import a_run, write_split

pytestmark = pytest.mark.slow


def test_a_cluster_makes_the_same_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    root = write_split(tmp_path / "data", scenes=2, frames=2)
    tables = []
    for engine in ("serial", "ray"):
        run = a_run(root, tmp_path / engine, "telea")
        run_task(run, JobOptions(engine=engine, workers=2, progress=False))  # type: ignore[arg-type]
        tables.append((run.folder / TABLE).read_bytes())
    assert tables[0] == tables[1]
