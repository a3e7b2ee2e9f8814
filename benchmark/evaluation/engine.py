"""The run engine: workers, resume and failures for the `TaskRun` of every task.

A run is a folder. Its manifest is written first; its table is written in parts. The final table is
the same if the run is interrupted, killed or spread over machines.
"""

import fcntl
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd

from benchmark.evaluation.renewal import renew
from benchmark.evaluation.results import good_frames, join_parts, report_failures
from benchmark.evaluation.task_run import TaskRun
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.locks import hold_lock
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import begin, check_begun

# The replacement of a dead worker waits until the system has released the lock.
_PATIENCE_S = 30.0


def check_device(name: str) -> None:
    """Check that a device exists, whether or not the method uses it.

    Raises:
        ToolkitError: the name is not a device, or this machine does not have it.
    """
    if name != "cpu":  # do not import torch for the CPU
        from benchmark.methods.network import torch_device

        torch_device(name)


@cache
def claim_device(devices: tuple[str, ...], folder: Path) -> str:
    """Return the device of this process; no two processes of a run get the same device.

    The process locks one file per device until it exits. A single device is not locked: the run
    then uses it with the requested number of workers.

    Args:
        devices: torch devices.
        folder: folder of the lock files, one per run.

    Raises:
        ToolkitError: all devices are in use.
    """
    if len(devices) == 1:
        return devices[0]
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + _PATIENCE_S
    while time.monotonic() < end:
        for device in devices:
            if _hold(folder / f"device-{device.replace(':', '-')}.lock"):
                return device
        time.sleep(0.1)
    raise ToolkitError(
        "more worker processes than devices",
        field="--device",
        value=" ".join(devices),
        hint="--workers is the number of devices, or less",
    )


def _hold(path: Path) -> bool:
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return False
    return True  # left open on purpose: the lock is held until the process exits


class UnusableMethod(ToolkitError):
    """A method that cannot be created with these options, independent of the data."""


@contextmanager
def as_unusable_method(devices: Sequence[str]) -> Iterator[None]:
    """Check devices, and turn errors while methods are created into `UnusableMethod`.

    Raises:
        UnusableMethod: a device does not exist, or a method rejects its options.
    """
    try:
        for device in devices:
            check_device(device)
        yield
    except ToolkitError as error:
        raise UnusableMethod(**vars(error)) from error


R = TypeVar("R", bound=TaskRun[Any, Any])


def run_task(run: TaskRun[Any, Any], jobs: JobOptions | None = None) -> pd.DataFrame:
    """Process the remaining work items of a run, with its folder locked.

    If another process works on the run, this one waits for it, and processes what it left.

    Work items are numbered by their position in the data. The final table is therefore the same if
    the run is interrupted, killed or spread over machines.

    Returns:
        The run's table; frames that failed have a text in `error`.

    Raises:
        UnusableMethod: the methods cannot be created.
        ToolkitError: data cannot be used, a work item failed, or the folder has a different run.
            Finished work is kept.
    """
    jobs = jobs or JobOptions()
    _kept.clear()  # the files may have changed since this process read them
    data = run.open()
    run.check(data)
    # Created here once before the workers start, so that a wrong option is reported once.
    with as_unusable_method(run.devices):
        methods = run.make(run.devices[0])
    manifest = run.manifest(data, methods)
    has_network = any(hasattr(part, "network") for part in run.parts(methods))
    shared = run.devices[0] == "cpu" and run.network_shares_cpu
    if jobs.workers is None and has_network and not shared:
        # A network uses the whole device; a second process would only double the memory.
        jobs = replace(jobs, workers=len(run.devices))
    del methods
    folder, table = run.folder, run.table_name
    hint = f"choose another {'--label or ' if hasattr(manifest, 'label') else ''}--out"
    check_begun(folder / run.manifest_name, hint=hint, beside=run.beside)
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder, "lock", doing="writing to", wait=True):
        renewal = renew(run, data)
        begin(
            folder / run.manifest_name,
            manifest,
            within=["setup"],
            what="these results were",
            hint=hint,
            beside=run.beside,
        )
        sweep_temporaries(folder)
        # Joined before parts are added: they may have the names of earlier ones.
        right = renewal.apply(run, data, join_parts(folder, table))
        work = run.items(data, good_frames(right), jobs.worker_count)
        report = run_jobs(Worker(run), work, name=run.title, key=run.item_title, options=jobs)
        whole = join_parts(folder, table)
    if report.failed:
        # The log has a line for each failure. They tend to have one cause: report the first.
        where, why = next(iter(report.failed.items()))
        raise ToolkitError(
            f"{len(report.failed)} of {len(work)} {run.unit} failed; {where}: {why}",
            path=folder,
            hint="what was finished is kept; the same command goes on",
        )
    return whole


class Worker:
    """Processes items in a worker process, which keeps data and methods between items."""

    def __init__(self, run: TaskRun[Any, Any]) -> None:
        self.run = run

    def __call__(self, item: Any) -> int:
        return self.run.work(*_equipment(self.run), item)


_kept: dict[str, tuple[Any, Any]] = {}


def _equipment(run: TaskRun[Any, Any]) -> tuple[Any, Any]:
    """Data and methods of this process; those of an earlier run are released."""
    key = repr(run)
    if key not in _kept:
        _kept.clear()
        device = claim_device(run.devices, run.folder / ".devices")
        _kept[key] = (run.open(), run.make(device))
        run.begin_worker()
    return _kept[key]


@dataclass
class Campaign(Generic[R]):
    """Outcome of `run_all`.

    Attributes:
        finished: the runs that have a table.
        failed: an error line for each of the others, by title.
        failed_frames: frames without a score, over all runs.
    """

    finished: list[R] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    failed_frames: int = 0


def run_all(runs: Sequence[R], jobs: JobOptions | None = None) -> Campaign[R]:
    """Execute all runs, see `run_task`; if a run fails, the others still run.

    Raises:
        ToolkitError: data are missing; raised before any run starts.
    """
    for run in {run.data_key: run for run in runs}.values():
        run.check_data()
    report: Campaign[R] = Campaign()
    for run in runs:
        if run.method_title in report.failed:
            continue
        try:
            table = run_task(run, jobs)
            report.failed_frames += report_failures(table, run.title, run.folder)
            run.after()
        except UnusableMethod as error:
            report.failed[run.method_title] = str(error)
        except ToolkitError as error:
            report.failed[run.title] = str(error)
        else:
            report.finished.append(run)
    return report
