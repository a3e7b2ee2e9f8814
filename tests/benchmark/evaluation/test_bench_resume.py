"""What a run that goes on keeps of the rows that it has, and what it replaces."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pandas as pd
import pytest

from benchmark.evaluation.engine import Campaign, run_all, run_task
from benchmark.evaluation.manifest import MANIFEST
from benchmark.evaluation.results import (
    ERROR,
    FAILURES,
    FRAME,
    INDEX,
    SCENE,
    TABLE,
    join_parts,
    write_part,
)
from benchmark.evaluation.task_run import TaskRun
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.artefact import begin

SERIAL = JobOptions(engine="serial", progress=False)


class ASetup(msgspec.Struct, frozen=True):
    split: str = "toy"


class AManifest(msgspec.Struct, frozen=True):
    setup: ASetup = msgspec.field(default_factory=ASetup)


def rows(frames: Sequence[int], error: str = "", figure: float = 0.0) -> list[dict[str, object]]:
    """Two rows for each frame."""
    return [
        {INDEX: i, SCENE: "s", FRAME: f"{i:04d}", ERROR: error, "subset": s, "rmse": figure}
        for i in frames
        for s in ("all", "specular")
    ]


@dataclass(frozen=True)
class ARun(TaskRun[None, None]):
    """Scores frames 0 and 1 (once more), with this outcome."""

    manifest_name, table_name = MANIFEST, TABLE
    out: Path
    error: str
    figure: float
    title = "toy"
    devices = ("cpu",)

    @property
    def folder(self) -> Path:
        return self.out

    def open(self) -> None: ...

    def make(self, device: str) -> None: ...

    def manifest(self, data: None, methods: None) -> AManifest:  # noqa: ARG002
        return AManifest()

    def items(self, data: None, done: set[int], workers: int) -> list[int]:  # noqa: ARG002
        return [0]

    def item_title(self, item: int) -> str:
        return str(item)

    def work(self, data: None, methods: None, item: int) -> int:  # noqa: ARG002
        write_part(self.folder, 0, 1, rows([0, 1], self.error, self.figure))
        return 2


def go_on(folder: Path, error: str, figure: float) -> pd.DataFrame:
    """Score frames 0 and 1 (once more), with this outcome."""
    return run_task(ARun(folder, error, figure), SERIAL)


@pytest.mark.parametrize("joined", [True, False], ids=["table", "part of the same name"])
def test_a_later_failure_does_not_replace_an_earlier_success(tmp_path: Path, joined: bool) -> None:
    if joined:
        go_on(tmp_path, "", 0.1)
    else:  # killed before its parts were joined
        begin(tmp_path / MANIFEST, AManifest(), within=["setup"], hint="")
        write_part(tmp_path, 0, 1, rows([0, 1], "", 0.1))
    table = go_on(tmp_path, "out of memory", 9.0)
    assert table[INDEX].tolist() == [0, 0, 1, 1]
    assert (table[ERROR] == "").all() and (table["rmse"] == 0.1).all()
    assert pd.read_csv(tmp_path / FAILURES).empty
    pd.testing.assert_frame_equal(join_parts(tmp_path), table)


def test_a_failure_beside_a_success_of_the_same_run_does_not_replace_it(tmp_path: Path) -> None:
    write_part(tmp_path, 0, 1, rows([0, 1], "", 0.1))
    write_part(tmp_path, 1, 2, rows([1, 2], "out of memory", 9.0))
    table = join_parts(tmp_path)
    assert table[INDEX].tolist() == [0, 0, 1, 1, 2, 2]
    assert table[ERROR].tolist() == [""] * 4 + ["out of memory"] * 2
    assert pd.read_csv(tmp_path / FAILURES)[INDEX].tolist() == [2]


@pytest.mark.parametrize(
    ("before", "after"), [("no memory", ""), ("", ""), ("no memory", "no such file")]
)
def test_of_two_equal_outcomes_the_later_counts_and_a_success_mends(
    tmp_path: Path, before: str, after: str
) -> None:
    go_on(tmp_path, before, 0.1)
    table = go_on(tmp_path, after, 0.2)
    assert len(table) == 4
    assert (table[ERROR] == after).all() and (table["rmse"] == 0.2).all()


@pytest.mark.slow
def test_two_runs_into_one_folder_both_finish(tmp_path: Path) -> None:
    """The second waits, and has nothing left to do; neither loses a method."""
    begun = threading.Event()
    scored: list[str] = []

    @dataclass(frozen=True)
    class Slow(ARun):
        name: str = ""

        @property
        def folder(self) -> Path:
            return self.out / self.name

        def work(self, data: None, methods: None, item: int) -> int:
            begun.set()
            time.sleep(0.3)
            scored.append(self.name)
            return super().work(data, methods, item)

        def items(self, data: None, done: set[int], workers: int) -> list[int]:  # noqa: ARG002
            return [] if done else [0]

        def check_data(self) -> None: ...

        def read(self) -> None: ...

    runs = [Slow(tmp_path, "", 0.1, name) for name in ("a", "b", "c")]
    reports: list[Campaign[Slow]] = []

    def run() -> None:
        reports.append(run_all(runs, SERIAL))

    threads = [threading.Thread(target=run) for _ in range(2)]
    threads[0].start()
    assert begun.wait(20)
    threads[1].start()
    for thread in threads:
        thread.join(60)
    assert sorted(scored) == ["a", "b", "c"]
    assert [len(report.finished) for report in reports] == [3, 3]
    assert [report.failed for report in reports] == [{}, {}]
