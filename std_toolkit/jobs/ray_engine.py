"""Items over a Ray cluster (extra `[cluster]`)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.runner import JobOptions, Outcome


def run_on_ray(
    call: Callable[[Any], Outcome[Any]], items: Sequence[Any], options: JobOptions
) -> Iterator[tuple[int, Outcome[Any]]]:
    """See `runner.EngineRunner`. Scene folders must lie on a file system that all nodes share.

    Raises:
        ToolkitError: Ray is not installed, or there is no cluster at the address.
    """
    try:
        import ray
        from ray.exceptions import RayError
    except ImportError as error:
        raise ToolkitError(
            "Ray is not installed", hint="pip install 'std-toolkit[cluster]'"
        ) from error

    started_here = not ray.is_initialized()
    if started_here:
        try:
            ray.init(
                address=options.ray_address,
                num_cpus=None if options.ray_address else options.worker_count,
                include_dashboard=False if options.ray_address is None else None,
                log_to_driver=False,
                logging_level=logging.WARNING,
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ToolkitError(
                f"cannot connect to Ray: {error}", field="--ray-address", value=options.ray_address
            ) from error
    # Ray retries tasks whose worker died; exceptions of the function itself come as outcomes.
    remote = ray.remote(num_cpus=1, max_retries=2)(_call)
    shared = ray.put(call)
    try:
        queue = iter(enumerate(items))
        running: dict[Any, int] = {}
        while True:
            while len(running) < 2 * options.worker_count and (entry := next(queue, None)):
                running[remote.remote(shared, entry[1])] = entry[0]
            if not running:
                break
            done, _ = ray.wait(list(running), num_returns=1)
            for reference in done:
                index = running.pop(reference)
                try:
                    yield index, ray.get(reference)
                except RayError as error:
                    yield index, Outcome(error=f"Ray: {' '.join(str(error).split())[:300]}")
    finally:
        if started_here:
            ray.shutdown()


def _call(call: Callable[[Any], Outcome[Any]], item: Any) -> Outcome[Any]:
    return call(item)
