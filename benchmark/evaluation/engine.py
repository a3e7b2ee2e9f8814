"""The run engine: every task has its `TaskRun`; workers, resume and failures exist once, here.

A run is a folder. Its manifest is written first, its table grows by parts, and whatever is
interrupted, killed or spread over machines, the table is the same in the end.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import pandas as pd

from benchmark.evaluation.manifest import begin
from benchmark.evaluation.results import good_frames, join_parts, report_failures
from benchmark.methods.registry import MethodOptions, shipped_file
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import hold_lock, sweep_temporaries
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.scene.document import digest_file

# A worker that takes the place of a dead one waits until the system has freed its lock.
_PATIENCE_S = 30.0

# Frames that go through a method together, by their number in the split.
Batch = tuple[int, ...]

# Pieces per worker: enough that no worker waits long for the slowest at the end.
_PIECES_PER_WORKER = 16

_LONGEST_PIECE = 64

# A killed worker loses what it has not written; a method slower than this writes every batch.
_FLUSH_S = 2.0


def check_device(name: str) -> None:
    """See that a device exists, whether or not the method will use it.

    Raises:
        ToolkitError: no device is called so, or this machine does not have it.
    """
    if name != "cpu":  # torch is not needed to know that it is there
        from benchmark.methods.network import torch_device

        torch_device(name)


@cache
def claim_device(devices: tuple[str, ...], folder: Path) -> str:
    """The device of this process until it ends; no two processes of a run get the same.

    A lock on a file per device decides, which a dead process frees by dying. One device alone is
    not locked: the run then has as many workers on it as the user asked for.

    Args:
        devices: torch devices.
        folder: where the lock files lie, one folder per run.

    Raises:
        ToolkitError: all are taken.
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
    return True  # left open on purpose: the lock lives as long as the process


class UnusableMethod(ToolkitError):
    """A method that cannot be made with these options, whatever the data."""


@contextmanager
def as_unusable_method(devices: Sequence[str]) -> Iterator[None]:
    """What goes wrong while methods are made on these devices is an `UnusableMethod`.

    Raises:
        UnusableMethod: a device that there is not, or what a method says of its options.
    """
    try:
        for device in devices:
            check_device(device)
        yield
    except ToolkitError as error:
        raise UnusableMethod(
            error.problem, path=error.path, field=error.field, value=error.value, hint=error.hint
        ) from error


def weights_digest(name: str, method: object, options: MethodOptions) -> str:
    """SHA-256 of the file of weights that a method uses, a user's or one that comes along; empty
    where there is none.

    Args:
        name: of the method.
        method: the method itself; None where there is none, as of raw depth.
        options: what it was made with.
    """
    if method is None:
        return ""
    # A method of somebody's own may use the file without telling.
    weights = getattr(method, "weights", None) or options.weights
    if weights is None and (shipped := shipped_file(name, options.preset)).is_file():
        weights = shipped
    return digest_file(weights) if isinstance(weights, Path) else ""


D = TypeVar("D")
M = TypeVar("M")


class TaskRun(Generic[D, M]):
    """A run: methods M on data D, one folder of results.

    A subclass is a frozen dataclass, so that worker processes can have it.

    Attributes:
        manifest_name, table_name: files of a run.
        unit: what its pieces of work are called, in the plural.
        beside: files of a run that older versions wrote without a manifest.
        network_shares_cpu: whether several workers may run a network on the CPU at a time.
        devices: torch devices, of which each worker takes one.
    """

    manifest_name: ClassVar[str]
    table_name: ClassVar[str]
    unit: ClassVar[str] = "pieces of work"
    beside: ClassVar[tuple[str, ...]] = ()
    network_shares_cpu: ClassVar[bool] = False
    devices: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Where its files lie."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """For people."""
        raise NotImplementedError

    @property
    def method_title(self) -> str:
        """What its methods are called; runs of the same are left out where these are unusable."""
        return self.title

    @property
    def data_key(self) -> object:
        """Of runs with the same key one is checked before anything runs."""
        return self.title

    def check_data(self) -> None:
        """See that the data are there.

        Raises:
            ToolkitError: they are not.
        """
        self.open()

    def open(self) -> D:
        """The data.

        Raises:
            ToolkitError: they are not there.
        """
        raise NotImplementedError

    def check(self, data: D) -> None:
        """See that it can be done, before its methods are made.

        Raises:
            ToolkitError: it cannot.
        """

    def make(self, device: str) -> M:
        """The methods.

        Raises:
            ToolkitError: they cannot be made.
        """
        raise NotImplementedError

    def parts(self, methods: M) -> tuple[object, ...]:
        """Each of the methods, of which any may have a network."""
        return (methods,)

    def begin_worker(self) -> None:
        """Prepare a process for work."""

    def manifest(self, data: D, methods: M) -> Any:
        """What the run is, see `benchmark.evaluation.manifest.begin`."""
        raise NotImplementedError

    def items(self, data: D, done: set[int], workers: int) -> Sequence[Any]:
        """The work that is left, given the numbers of what is finished."""
        raise NotImplementedError

    def item_title(self, item: Any) -> str:
        """A piece of work, for people."""
        raise NotImplementedError

    def work(self, data: D, methods: M, item: Any) -> int:
        """Do a piece of work and write its rows by `write_part`; returns how many frames."""
        raise NotImplementedError

    def after(self) -> None:
        """Make what a finished run has beside its table.

        Raises:
            ToolkitError: a file cannot be written.
        """

    def read(self) -> Any:
        """Its results.

        Raises:
            ToolkitError: a file is missing or damaged.
        """
        raise NotImplementedError


R = TypeVar("R", bound=TaskRun[Any, Any])


@dataclass(frozen=True)
class Task:
    """Something that is scored.

    Attributes:
        plan: the runs that a user means, in the order that they are to run in.
        table: results for a terminal, given what the user asked.
        records: the figures of the table, for JSON.
    """

    plan: Callable[[Any], Sequence[TaskRun[Any, Any]]]
    table: Callable[[Sequence[Any], Any], str]
    records: Callable[[Sequence[Any], Any], Sequence[Any]]


def run_task(run: TaskRun[Any, Any], jobs: JobOptions | None = None) -> pd.DataFrame:
    """Do what has not been done yet of a run, while nobody else writes to it.

    Work is numbered by its place in the data: whatever is interrupted, killed or spread over
    machines, the table is the same in the end.

    Returns:
        The run's table; frames that failed have a text in `error`.

    Raises:
        UnusableMethod: the methods cannot be made.
        ToolkitError: data cannot be used, work failed, another run was begun in this folder, or
            somebody writes to it; what was finished is kept.
    """
    jobs = jobs or JobOptions()
    data = run.open()
    run.check(data)
    # Once and at once, and not first in every worker: a wrong option is told in one line.
    with as_unusable_method(run.devices):
        methods = run.make(run.devices[0])
    manifest = run.manifest(data, methods)
    has_network = any(hasattr(part, "network") for part in run.parts(methods))
    shared = run.devices[0] == "cpu" and run.network_shares_cpu
    if jobs.workers is None and has_network and not shared:
        # A network uses all of a device; a second process would only double its memory.
        jobs = replace(jobs, workers=len(run.devices))
    del methods
    folder, table = run.folder, run.table_name
    folder.mkdir(parents=True, exist_ok=True)
    with hold_lock(folder, "lock", doing="writing to"):
        begin(folder, manifest, run.manifest_name, run.beside)
        sweep_temporaries(folder)
        # Joined before anything is added: the parts of this run may have the names of earlier ones.
        work = run.items(data, good_frames(join_parts(folder, table)), jobs.worker_count)
        report = run_jobs(Worker(run), work, name=run.title, key=run.item_title, options=jobs)
        whole = join_parts(folder, table)
    if report.failed:
        # The log has a line for each; here the first one, since they tend to be of one kind.
        where, why = next(iter(report.failed.items()))
        raise ToolkitError(
            f"{len(report.failed)} of {len(work)} {run.unit} failed; {where}: {why}",
            path=folder,
            hint="what was finished is kept; the same command goes on",
        )
    return whole


class Worker:
    """Does work in a worker process, which keeps data and methods from item to item."""

    def __init__(self, run: TaskRun[Any, Any]) -> None:
        self.run = run

    def __call__(self, item: Any) -> int:
        return self.run.work(*_equipment(self.run), item)


_kept: dict[str, tuple[Any, Any]] = {}


def _equipment(run: TaskRun[D, M]) -> tuple[D, M]:
    """Data and methods of this process; those of an earlier run make room."""
    key = repr(run)
    if key not in _kept:
        _kept.clear()
        device = claim_device(run.devices, run.folder / ".devices")
        _kept[key] = (run.open(), run.make(device))
        run.begin_worker()
    return _kept[key]


@dataclass
class Campaign(Generic[R]):
    """What became of the runs.

    Attributes:
        finished: the runs that have a table.
        failed: an error line for each of the others.
        failed_frames: frames without a score, over all runs.
    """

    finished: list[R] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    failed_frames: int = 0


def run_all(runs: Sequence[R], jobs: JobOptions | None = None) -> Campaign[R]:
    """Do all runs, see `run_task`; one that cannot run does not keep others from it.

    Raises:
        ToolkitError: data are not there; nothing has run then.
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
