"""One bad item never ends a run, and nothing depends on which engine did the work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import job_items
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions, run_jobs

SERIAL = JobOptions(engine="serial", progress=False)
LOCAL = JobOptions(engine="local", workers=2, progress=False)
engines = pytest.mark.parametrize("options", [SERIAL, LOCAL], ids=["serial", "local"])


@engines
def test_results_come_in_item_order(options: JobOptions) -> None:
    report = run_jobs(job_items.slow_first, range(6), name="order", options=options)
    assert list(report.results) == [str(i) for i in range(6)]
    assert list(report.results.values()) == list(range(6))
    assert not report.failed
    report.raise_if_failed()


@engines
def test_what_is_kept_of_results_is_in_the_report(options: JobOptions) -> None:
    asked = []

    def half(result: int) -> int:
        asked.append(result)
        return -result

    report = run_jobs(job_items.odd_raises, range(5), name="kept", options=options, keep=half)
    assert report.results == {"0": 0, "2": -2, "4": -4}
    assert sorted(asked) == [0, 2, 4]
    assert list(report.failed) == ["1", "3"]


def test_all_cores_serve_where_the_system_has_no_affinity(monkeypatch) -> None:
    """As on macOS and Windows."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    assert JobOptions().worker_count == os.cpu_count()
    report = run_jobs(job_items.square, range(2), name="x", options=JobOptions(progress=False))
    assert list(report.results.values()) == [0, 1]


@engines
def test_no_items_are_no_work(options: JobOptions) -> None:
    report = run_jobs(job_items.square, [], name="nothing", options=options)
    assert not report.results
    assert not report.failed


@engines
def test_a_raising_item_is_listed_and_the_others_are_done(options: JobOptions) -> None:
    report = run_jobs(job_items.odd_raises, range(5), name="odd", options=options)
    assert report.results == {"0": 0, "2": 2, "4": 4}
    assert report.failed == {"1": "numbers: odd (got 1)", "3": "numbers: odd (got 3)"}
    with pytest.raises(ToolkitError, match=r"odd: 2 of 5 failed: 1: numbers: odd"):
        report.raise_if_failed()


@engines
def test_a_foreign_exception_becomes_one_line(options: JobOptions) -> None:
    report = run_jobs(job_items.raise_foreign, range(2), name="foreign", options=options)
    assert report.failed == dict.fromkeys("01", "RuntimeError: two lines of it")


@engines
def test_an_item_that_exits_fails_alone(options: JobOptions) -> None:
    report = run_jobs(job_items.call_exit, range(3), name="exit", options=options)
    assert list(report.results) == ["0", "2"]
    assert report.failed == {"1": "SystemExit: 0"}


def test_a_result_that_cannot_be_sent_fails_its_item_alone() -> None:
    report = run_jobs(job_items.return_unpicklable, range(3), name="send", options=LOCAL)
    assert list(report.results) == ["0", "2"]
    assert "pickle" in report.failed["1"].lower()


@engines
def test_two_items_of_one_name_are_refused(options: JobOptions) -> None:
    with pytest.raises(ToolkitError, match="same name"):
        run_jobs(job_items.square, [1, 2, 1], name="twice", options=options)


def test_options_are_checked() -> None:
    with pytest.raises(ToolkitError, match="workers: must be at least 1"):
        JobOptions(workers=0)
    with pytest.raises(ToolkitError, match="one of local, serial, ray"):
        JobOptions(engine="slurm")  # type: ignore[arg-type]


def test_work_runs_in_as_many_processes_as_asked_for() -> None:
    ids = run_jobs(job_items.process_id, range(8), name="ids", options=LOCAL).results.values()
    assert os.getpid() not in ids
    assert len(set(ids)) == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's memory")
def test_a_worker_reuses_the_memory_of_images() -> None:
    """Six images of 8 MiB are made, dropped and made again: 15,000 faults in a fresh process."""
    options = JobOptions(engine="local", workers=1, progress=False)
    report = run_jobs(job_items.faults_of_images, [1, 2], name="faults", options=options)
    assert max(report.results.values()) < 4096


def test_one_worker_is_a_process_of_its_own_too() -> None:
    options = JobOptions(engine="local", workers=1, progress=False)
    ids = run_jobs(job_items.process_id, range(2), name="ids", options=options).results.values()
    assert os.getpid() not in ids
    assert len(set(ids)) == 1


def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    jobs = [(i, tmp_path) for i in range(12)]
    report = run_jobs(
        job_items.killed_once, jobs, name="killed", key=lambda j: str(j[0]), options=LOCAL
    )
    assert (tmp_path / "was_killed").exists()
    assert list(report.results.values()) == list(range(12))
    assert not report.failed


@pytest.mark.slow
def test_an_item_that_always_kills_its_worker_is_reported_and_the_others_are_done() -> None:
    report = run_jobs(job_items.three_aborts, range(12), name="aborts", options=LOCAL)
    assert list(report.results.values()) == [i for i in range(12) if i != 3]
    assert list(report.failed) == ["3"]
    assert "died 3 times" in report.failed["3"]


@pytest.mark.slow
@pytest.mark.parametrize("fn", [job_items.end_quietly, job_items.killed_while_sending])
def test_an_item_whose_process_ends_unexpectedly_fails_alone(fn: Callable[[int], object]) -> None:
    """Status 0 is no success, and half of a result does not block those of the others."""
    report = run_jobs(fn, range(4), name="ends", options=LOCAL)
    assert list(report.results) == ["0", "2", "3"]
    assert "died 3 times" in report.failed["1"]


class CountedItems(Sequence[int]):
    """A long list that is made while it is read, and knows how far it was read."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.taken = 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        if index >= self.count:
            raise IndexError
        self.taken = max(self.taken, index)
        return index


def test_items_are_taken_only_when_a_worker_is_free() -> None:
    from std_toolkit.jobs.runner import _Guarded, run_locally

    items = CountedItems(1_000_000)
    stream: Iterator = run_locally(_Guarded(job_items.square), items, LOCAL)
    for _ in range(20):
        next(stream)
    assert items.taken < 30
    stream.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("signals", [1, 3])
def test_ctrl_c_stops_at_once_and_leaves_no_process(tmp_path: Path, signals: int) -> None:
    """Ctrl-C reaches the whole process group, workers included."""
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import job_items\n"
        "from pathlib import Path\n"
        "from std_toolkit.jobs import JobOptions, run_jobs\n"
        "if __name__ == '__main__':\n"
        "    jobs = [(i, Path(sys.argv[2])) for i in range(4)]\n"
        "    run_jobs(job_items.sleep_long, jobs, name='long', key=lambda j: str(j[0]),\n"
        "             options=JobOptions(workers=2, progress=False))\n"
    )
    (tmp_path / "script.py").write_text(script)
    here = str(Path(__file__).parent)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py"), here, str(tmp_path)],
        start_new_session=True,
        # A test run in the background of a shell inherits an ignored Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        stderr=subprocess.PIPE,
        text=True,
    )
    workers = _wait_for_workers(tmp_path, 2)
    began = time.monotonic()
    for _ in range(signals):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.01)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - began < 5
    assert process.returncode != 0
    assert "KeyboardInterrupt" in errors
    _assert_gone(workers)


def test_workers_of_a_killed_run_end_with_it(tmp_path: Path) -> None:
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import job_items\n"
        "from pathlib import Path\n"
        "from std_toolkit.jobs import JobOptions, run_jobs\n"
        "if __name__ == '__main__':\n"
        "    jobs = [(i, Path(sys.argv[2])) for i in range(4)]\n"
        "    run_jobs(job_items.sleep_long, jobs, name='long', key=lambda j: str(j[0]),\n"
        "             options=JobOptions(workers=2, progress=False))\n"
    )
    (tmp_path / "script.py").write_text(script)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py"), str(Path(__file__).parent), str(tmp_path)]
    )
    workers = _wait_for_workers(tmp_path, 2)
    process.kill()
    process.wait(timeout=10)
    _assert_gone(workers)


def test_a_run_can_be_interrupted_from_within_the_loop() -> None:
    """As when Ctrl-C arrives while the progress bar is drawn."""
    before = threading.active_count()
    from std_toolkit.jobs.runner import _Guarded, run_locally

    stream = run_locally(_Guarded(job_items.process_id), range(100), LOCAL)
    worker = next(stream)[1].result
    stream.close()
    _assert_gone([worker])
    assert threading.active_count() <= before + 1


def _wait_for_workers(folder: Path, count: int) -> list[int]:
    for _ in range(600):
        started = list(folder.glob("started_*"))
        if len(started) >= count:
            return [int(p.name.split("_")[2]) for p in started]
        time.sleep(0.05)
    raise AssertionError("the workers did not start")


def _assert_gone(processes: list[int]) -> None:
    for _ in range(100):
        left = [p for p in processes if _alive(p)]
        if not left:
            return
        time.sleep(0.05)
    raise AssertionError(f"processes {left} are still there")


def _alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_lines_tell_the_time_left_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from std_toolkit.jobs import runner

    monkeypatch.setattr(runner, "_LINE_S", 0.0)
    monkeypatch.setattr(runner.logger, "propagate", True)
    with caplog.at_level("INFO", logger=runner.logger.name):
        run_jobs(len, ["a", "bc"], name="count", options=JobOptions(workers=1))
    lines = [r.getMessage() for r in caplog.records if "left" in r.getMessage()]
    assert lines[-1].startswith("count: ") and "2 of 2, about 0 s left" in lines[-1]


def test_an_interrupt_that_a_library_reports_as_an_error_is_no_failed_item() -> None:
    """drjit raises a RuntimeError if a callback of its loop is interrupted."""

    def item(number: int) -> int:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise RuntimeError(f"loop {number}") from interrupt

    with pytest.raises(KeyboardInterrupt):
        run_jobs(item, [1, 2], name="items", options=SERIAL)
