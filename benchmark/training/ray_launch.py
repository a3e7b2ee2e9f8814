"""Runs a training on this machine, or in processes of a Ray cluster by Ray Train (`cluster`)."""

import logging
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmark.training.export import bench_command
from benchmark.training.fit import fit, process_rank
from benchmark.training.options import Machine, TrainCommand, TrainOptions
from benchmark.training.plan import plan_training
from benchmark.training.run_files import BEST
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.ray_engine import ray_cluster
from std_toolkit.log import log_to_stderr, logger


def fit_on_ray(
    folder: Path, options: TrainOptions, machine: Machine, address: str | None = None
) -> Path:
    """As `fit`, in `machine.devices * machine.nodes` processes of a cluster.

    Every process plans the training by itself: the toolkit is installed, and data and `folder` are
    there under the same paths, on every node.

    Args:
        folder: of the training.
        options: the training.
        machine: how many processes, on CPUs or GPUs.
        address: of a running cluster; None starts one on this machine.

    Raises:
        ToolkitError: what `plan_training` and `fit` raise, no cluster, or one that is too small.
    """
    folder, options, count = folder.resolve(), _with_whole_paths(options), _count(machine)
    own = folder / ".std" / "ray"  # what Ray keeps of a training; all that matters is in `folder`
    jobs = JobOptions(engine="ray", workers=count, ray_address=address)
    with ray_cluster(jobs, tell=True):
        import ray
        from ray.train import FailureConfig, RunConfig, ScalingConfig
        from ray.train.torch import TorchTrainer

        gpu = _uses_gpu(machine, ray.cluster_resources(), count)
        inside = replace(
            machine, accelerator="gpu" if gpu else "cpu", devices=1, nodes=1, in_ray=True,
            progress=False,
        )  # fmt: skip
        logging.getLogger("ray.train").setLevel(logging.WARNING)
        trainer = TorchTrainer(
            _train,
            train_loop_config={"folder": folder, "options": options, "machine": inside},
            scaling_config=ScalingConfig(num_workers=count, use_gpu=gpu),
            run_config=RunConfig(
                name="training",
                storage_path=str(own),
                # Whether to try again is for the user to say: the same command goes on.
                failure_config=FailureConfig(max_failures=0),
            ),
        )
        try:
            trainer.fit()
        except Exception as error:
            raise _as_toolkit_error(error) from error
        finally:
            shutil.rmtree(own, ignore_errors=True)
    return folder / BEST


def _train(arguments: dict[str, Any]) -> None:
    """What every process does."""
    import ray.train

    rank = ray.train.get_context().get_world_rank()
    log_to_stderr(logging.INFO if rank == 0 else logging.WARNING)
    logger.propagate = False  # Ray has a handler of its own
    config, data, beginning = plan_training(arguments["options"])
    fit(arguments["folder"], config, data, arguments["machine"], beginning)


def _with_whole_paths(options: TrainOptions) -> TrainOptions:
    """Processes of the cluster run in other folders."""

    def whole(paths: Sequence[Path]) -> tuple[Path, ...]:
        return tuple(path.resolve() for path in paths)

    return replace(
        options,
        data=whole(options.data),
        validation=whole(options.validation),
        weights=options.weights and options.weights.resolve(),
        imagenet=options.imagenet and options.imagenet.resolve(),
    )


def _count(machine: Machine) -> int:
    return machine.devices * machine.nodes


def _uses_gpu(machine: Machine, there: dict[str, float], count: int) -> bool:
    gpu = machine.accelerator == "gpu" or (
        machine.accelerator == "auto" and there.get("GPU", 0) >= count
    )
    kind = "GPU" if gpu else "CPU"
    if there.get(kind, 0) < count:
        # Ray would wait for more without end.
        raise ToolkitError(
            f"the cluster has {there.get(kind, 0):.0f} {kind}s, which is less than the "
            f"{count} processes of this training need",
            field="--devices",
            value=machine.devices,
        )
    return gpu


def _as_toolkit_error(error: Exception) -> ToolkitError:
    """What went wrong in a process; Ray wraps it in errors of its own."""
    found = list(_chain(error))
    for one in found:
        if isinstance(one, ToolkitError):
            return one
    last = str(found[-1]).strip().splitlines() or [type(found[-1]).__name__]
    return ToolkitError(
        f"a process of the training failed: {last[-1]}",
        hint="the same command goes on from the last checkpoint",
    )


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error, and those that it was made of."""
    yield error
    inner = [*getattr(error, "worker_failures", {}).values()]
    inner += [getattr(error, name, None) for name in ("_base_exc", "cause", "__cause__")]
    for one in inner:
        if isinstance(one, BaseException) and one is not error:
            yield from _chain(one)


def run_training(options: TrainCommand) -> str | None:
    """Train as planned, or go on.

    Returns:
        The best weights and the command that scores them; None in the processes beside the first.

    Raises:
        ToolkitError: as `plan_training`, or the training fails.
    """
    is_first = process_rank() == 0
    if not is_first:  # the first of several processes reports for all
        logger.setLevel(logging.WARNING)
    config, data, beginning = plan_training(options)
    logger.info(
        "%d frames to train on, %d to validate; %d steps of %d frames",
        len(data.of_training),
        len(data.of_validation),
        config.steps,
        config.optimization.batch_size,
    )
    machine = options.machine.shown()
    if options.engine == "ray":
        best = fit_on_ray(options.out, options, machine, options.ray_address)
    else:
        best = fit(options.out, config, data, machine, beginning)
    if not is_first:
        return None
    settings = " ".join(f"{name}={value}" for name, value in config.settings.items())
    option = f" --set {settings}" if settings else ""
    command = bench_command(options.method)
    return f"{best}: {command} --preset {options.preset} --weights {best}{option}"
