"""A run of a benchmark task: what the engine asks of every task."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from benchmark.data.provenance import Provenance
from benchmark.data.splits import FrameKey, Inputs

D = TypeVar("D")
M = TypeVar("M")


class TaskRun(Generic[D, M]):
    """A run: methods M on data D, one folder of results.

    A subclass is a frozen dataclass, so that it can be sent to worker processes.

    Attributes:
        manifest_name, table_name: file names of a run.
        unit: name of its work items, in the plural.
        beside: files of a run that older versions wrote without a manifest.
        derived: files made of the table, which go when its rows do.
        network_shares_cpu: whether several workers may run a network on the CPU at a time.
        devices: torch devices; each worker uses one.
        out: folder of results, which several runs share.
    """

    manifest_name: ClassVar[str]
    table_name: ClassVar[str]
    unit: ClassVar[str] = "pieces of work"
    beside: ClassVar[tuple[str, ...]] = ()
    derived: ClassVar[tuple[str, ...]] = ()
    network_shares_cpu: ClassVar[bool] = False
    devices: tuple[str, ...]
    out: Path

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        raise NotImplementedError

    @property
    def title(self) -> str:
        """Title in messages."""
        raise NotImplementedError

    @property
    def method_title(self) -> str:
        """Title of its methods; if they are unusable, runs with the same title are skipped."""
        return self.title

    @property
    def data_key(self) -> object:
        """Key of its data; before anything runs, one run per key is checked."""
        return self.title

    def check_data(self) -> None:
        """Check that the data exist.

        Raises:
            ToolkitError: the data are missing.
        """
        self.open()

    def open(self) -> D:
        """Open the data.

        Raises:
            ToolkitError: the data are missing.
        """
        raise NotImplementedError

    def check(self, data: D) -> None:
        """Check that the run is possible, before its methods are created.

        Raises:
            ToolkitError: the run is not possible.
        """

    def make(self, device: str) -> M:
        """Create the methods.

        Raises:
            ToolkitError: the methods cannot be created.
        """
        raise NotImplementedError

    def parts(self, methods: M) -> tuple[object, ...]:
        """Return each of the methods; any of them may have a network."""
        return (methods,)

    def begin_worker(self) -> None:
        """Prepare a worker process."""

    def manifest(self, data: D, methods: M) -> Any:
        """Return the manifest of the run, see `benchmark.evaluation.manifest`."""
        raise NotImplementedError

    def inputs(self, data: D) -> Iterable[tuple[int, FrameKey, Inputs]]:  # noqa: ARG002
        """Return what the run reads: index and name of a frame, and its files by content."""
        return ()

    def frames_there(self, data: D) -> int:
        """Return the number of frames of the data set, of which the run may take a part."""
        return len(data)  # type: ignore[arg-type]

    def provenance(self, data: D) -> Provenance:  # noqa: ARG002
        """Return where the data come from."""
        return Provenance()

    def items(self, data: D, done: set[int], workers: int) -> Sequence[Any]:
        """Return the remaining work items, given the indices of the finished ones."""
        raise NotImplementedError

    def item_title(self, item: Any) -> str:
        """Return the title of a work item in messages."""
        raise NotImplementedError

    def work(self, data: D, methods: M, item: Any) -> int:
        """Process a work item, write its rows with `write_part`, and return its frame count."""
        raise NotImplementedError

    def after(self) -> None:
        """Write the files of a finished run other than its table.

        Raises:
            ToolkitError: a file cannot be written.
        """

    def read(self) -> Any:
        """Read the results.

        Raises:
            ToolkitError: a file is missing or damaged.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Task:
    """A benchmark task.

    Attributes:
        plan: returns the runs of a configuration, in execution order.
        table: formats results for a terminal, given the configuration.
        records: returns the figures of the table, for JSON.
    """

    plan: Callable[[Any], Sequence[TaskRun[Any, Any]]]
    table: Callable[[Sequence[Any], Any], str]
    records: Callable[[Sequence[Any], Any], Sequence[Any]]
