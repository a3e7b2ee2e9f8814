"""Items over a Ray cluster (extra `[cluster]`)."""

import logging
import os
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.outcome import ATTEMPTS, Outcome, error_of, worker_died
from std_toolkit.options import JobOptions

_CONNECT_SECONDS = 5.0


def run_on_ray(
    call: Callable[[Any], Outcome[Any]], items: Sequence[Any], options: JobOptions
) -> Generator[tuple[int, Outcome[Any]]]:
    """See `runner.EngineRunner`. Scene folders must be on a file system that all nodes share.

    Raises:
        ToolkitError: Ray is not installed, or there is no cluster at the address.
    """
    with ray_cluster(options):
        yield from _run(call, items, options)


@contextmanager
def ray_cluster(options: JobOptions, *, tell: bool = False) -> Iterator[None]:
    """A connection to a Ray cluster; without an address, one is started on this machine.

    An existing connection of the process is kept.

    Args:
        options: address and number of workers.
        tell: show the stdout and stderr of the cluster's processes.

    Raises:
        ToolkitError: Ray is not installed, or there is no cluster at the address.
    """
    try:
        import ray
    except ImportError as error:
        raise ToolkitError(
            "Ray is not installed", hint="pip install 'std-toolkit[cluster]'"
        ) from error
    if ray.is_initialized():
        yield
        return
    _connect(options, tell)
    try:
        yield
    finally:
        ray.shutdown()


def _run(
    call: Callable[[Any], Outcome[Any]], items: Sequence[Any], options: JobOptions
) -> Generator[tuple[int, Outcome[Any]]]:
    import ray
    from ray.exceptions import RayError, RayTaskError, WorkerCrashedError

    # Ray retries tasks whose worker died; exceptions of the function itself come as outcomes.
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_call)
    if options.gpus:
        remote = remote.options(num_gpus=options.gpus)
    running: dict[Any, int] = {}
    try:
        shared = ray.put(call)
        width = options.workers or int(ray.cluster_resources().get("CPU", 1))
        queue = iter(range(len(items)))
        while True:
            # A few more than what runs, so that no node waits for its next item.
            while len(running) < 2 * width and (index := next(queue, None)) is not None:
                running[remote.remote(shared, items[index])] = index
            if not running:
                break
            done, _ = ray.wait(list(running), num_returns=1)
            for reference in done:
                index = running.pop(reference)
                try:
                    outcome = ray.get(reference)
                except WorkerCrashedError:
                    outcome = worker_died()
                except RayTaskError as error:  # before our function was reached
                    outcome = Outcome(error=_last_line(error))
                except RayError as error:
                    outcome = error_of(error)
                yield index, outcome
    finally:
        for reference in running:  # interrupted
            ray.cancel(reference, force=True)


def _connect(options: JobOptions, tell: bool) -> None:
    import ray

    address = options.ray_address
    if address is not None:
        _check_reachable(address)
    handler = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(
            address=address,
            # No local cluster is started when an address is given, here or in RAY_ADDRESS.
            num_cpus=None if address or os.environ.get("RAY_ADDRESS") else options.worker_count,
            include_dashboard=None if address else False,
            log_to_driver=tell,
            logging_level=logging.ERROR,
        )
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise ToolkitError(
            f"cannot connect to Ray: {error}", field="--ray-address", value=address
        ) from error
    finally:
        # Ray's own ends the process silently.
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def _check_reachable(address: str) -> None:
    # Ray itself tries for minutes and then ends the process without an exception.
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if address in ("auto", "local"):
        return
    try:
        if not host or not port.isdecimal():
            raise ValueError("an address is host:port")
        with socket.create_connection((host, int(port)), timeout=_CONNECT_SECONDS):
            pass
    except (OSError, ValueError, OverflowError) as error:
        raise ToolkitError(
            f"no Ray cluster answers at this address: {error}",
            field="--ray-address",
            value=address,
            hint="start one with `ray start --head` and give its host:port",
        ) from error


def _last_line(error: Exception) -> str:
    # The text is a coloured traceback from the node; its last line is the cause.
    return f"{str(error).splitlines()[-1].strip()} (is the same version installed on every node?)"


def _call(call: Callable[[Any], Outcome[Any]], item: Any) -> Outcome[Any]:
    return call(item)
