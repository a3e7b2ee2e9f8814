"""Speed, size and memory of a method, measured after warm-up on a frame of its split."""

import multiprocessing
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Annotated, Any, Literal, get_args

import msgspec

from benchmark.data.frame import DepthFrame
from benchmark.evaluation.batches import chosen_frames
from benchmark.evaluation.frames import FrameRun
from benchmark.evaluation.manifest import Count, hardware
from benchmark.evaluation.submission import Submission
from benchmark.methods.depth.full_size import (
    restorer_view,
    sensor_view,
    to_full_size,
    working_size,
)
from benchmark.methods.protocol import Restorer, View
from benchmark.metrics.protocols.protocol import HARD, get_protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from std_toolkit.jobs.runner import inherit, inherited
from std_toolkit.options import usable_cores

SPEED = "speed.json"

# The first calls compile, allocate and fill caches.
WARM_UP = 2

FEWEST = 3

LONGEST_S = 10.0

# What a method of the class `cpu` needs at most: seconds for a frame of a size, on some cores.
CPU_S, CPU_CORES = 1.0, 2
STANDARD = (640, 480)

SpeedClass = Literal["cpu", "gpu", "not stated"]
SPEED_CLASSES: tuple[SpeedClass, ...] = get_args(SpeedClass)
NOT_STATED: SpeedClass = "not stated"

NotNegative = Annotated[float, msgspec.Meta(ge=0)]


class Speed(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cost of a method.

    Attributes:
        frames_per_s: frames per second for batches of `batch_size`, from the median time of a
            batch after warm-up, without reading and scoring.
        batch_size: frames restored together.
        width, height: size of the views, pixels.
        repeats: number of timed batches.
        parameters: number of network parameters; None without a network.
        gmacs: 1e9 multiply-accumulate operations per frame, without element-wise operations; None
            without a network, or if they cannot be counted.
        peak_memory_mib: peak memory, MiB: on a GPU that allocated by torch, otherwise the resident
            memory of the process, with libraries and data.
        hardware: processor or GPU.
        processor_s: processor time per frame over all cores, which other programs hardly change;
            None in results of earlier versions.
        standard_s: seconds for a frame of 640x480 as `std-restore` gives it, on 2 cores, the
            shortest of a few calls; None on a GPU, with fewer cores, and in results of earlier
            versions.
        load: other work on the machine: the mean number of running programs of the last minute,
            before the measurement; None where the system does not tell.
    """

    frames_per_s: NotNegative
    batch_size: Count
    width: Count
    height: Count
    repeats: Count
    parameters: Count | None
    gmacs: NotNegative | None
    peak_memory_mib: NotNegative
    hardware: str
    processor_s: float | None = None
    standard_s: NotNegative | None = None
    load: float | None = None


def measure_speed(
    restorer: Restorer, views: Sequence[View], *, hardware: str, repeats: int = 15
) -> Speed:
    """Time a method on a batch of views: `repeats` times, fewer for slow methods."""
    device = _gpu(restorer)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    for _ in range(WARM_UP):
        restorer.restore(views)
    if device is not None:
        import torch

        torch.cuda.reset_peak_memory_stats(device)
    seconds: list[float] = []
    processor: list[float] = []
    end = time.perf_counter() + LONGEST_S
    while len(seconds) < repeats and (len(seconds) < FEWEST or time.perf_counter() < end):
        begin, worked = time.perf_counter(), _worked()
        # The outputs are NumPy arrays, so a GPU has finished when the call returns.
        restorer.restore(views)
        seconds.append(time.perf_counter() - begin)
        processor.append(_worked() - worked)
    height, width = views[0].depth.shape
    return Speed(
        frames_per_s=len(views) / statistics.median(seconds),
        batch_size=len(views),
        width=width,
        height=height,
        repeats=len(seconds),
        parameters=getattr(restorer, "parameter_count", None),
        gmacs=_gmacs(restorer, views[0]),
        peak_memory_mib=_peak_memory(device),
        hardware=hardware,
        processor_s=statistics.median(processor) / len(views),
        load=load,
    )


def standard_seconds(restorer: Restorer, frame: DepthFrame) -> float:
    """Return the seconds that a frame of 640x480 takes, its enlargement included.

    The shortest of a few calls: other programs only make it longer.
    """
    return min(clock for clock, _ in standard_calls(restorer, frame))


def standard_calls(
    restorer: Restorer, frame: DepthFrame, *, most: int = FEWEST + 1, longest_s: float = LONGEST_S
) -> list[tuple[float, float]]:
    """Time calls with a frame of 640x480, its enlargement included.

    Args:
        restorer: the method.
        frame: any frame.
        most: number of calls.
        longest_s: no call begins later, but the first.

    Returns:
        Seconds by the clock and of processor time over all cores, of each call.
    """
    mask = frame.mask_of(*HARD) if restorer.needs_mask else None
    whole = sensor_view(frame.color, frame.depth_raw, frame.camera, STANDARD, mask=mask)
    size = working_size(restorer, STANDARD)
    calls: list[tuple[float, float]] = []
    end = time.perf_counter() + longest_s
    while len(calls) < most and (not calls or time.perf_counter() < end):
        begin, worked = time.perf_counter(), _worked()
        view = sensor_view(whole.color, whole.depth, whole.camera, size, mask=whole.mask)
        answer = restorer.restore([view])[0]
        if size is not None:
            to_full_size(whole.depth, answer, whole.color)
        calls.append((time.perf_counter() - begin, _worked() - worked))
    return calls


def speed_class(speed: Speed | None, device: str, said: Submission | None = None) -> SpeedClass:
    """Return the class in which a method is ranked.

    Args:
        speed: as measured; None if it was not.
        device: `cpu` or `cuda`, where it was measured.
        said: what the author of predictions says of them.

    Returns:
        `cpu` for at most 1 s a frame of 640x480 on 2 cores; `gpu` for methods that were slower, or
        ran on a GPU; else `not stated`.

    >>> stated = Submission(device="cpu", cores=4, seconds_per_frame=0.4, width=640, height=480)
    >>> speed_class(None, "cpu", stated), speed_class(None, "cpu")
    ('cpu', 'not stated')
    """
    if speed is not None:
        if device != "cpu":
            return "gpu"
        if speed.standard_s is None:
            return "not stated"
        return "cpu" if speed.standard_s <= CPU_S else "gpu"
    if said is None or not said.device:
        return "not stated"
    if said.device == "gpu":
        return "gpu"
    known = said.seconds_per_frame, said.cores, said.width, said.height
    if None in known or said.width * said.height < STANDARD[0] * STANDARD[1]:  # type: ignore[operator]
        return "not stated"
    # On two cores it takes at most as many times longer as there are more.
    seconds = said.seconds_per_frame * max(1.0, said.cores / CPU_CORES)  # type: ignore[operator]
    return "cpu" if seconds <= CPU_S else "gpu"


def _worked() -> float:
    """Processor time of this process and of the programs that it called, seconds."""
    return time.process_time() + sum(os.times()[2:4])


def _gpu(restorer: Restorer) -> Any:
    device = getattr(restorer, "device", None)
    return device if device is not None and device.type == "cuda" else None


def _gmacs(restorer: Restorer, view: View) -> float | None:
    macs = getattr(restorer, "macs", None)
    return None if macs is None else macs(view) / 1e9


def _peak_memory(device: Any) -> float:
    if device is not None:
        import torch

        return torch.cuda.max_memory_allocated(device) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def write_speed(run: FrameRun[Restorer], protocol: str) -> None:
    """Time the method of a run and save the result, unless it exists.

    Raises:
        ToolkitError: see `speed_of`.
    """
    if not (run.folder / SPEED).exists():
        write_document(run.folder / SPEED, speed_of(run, protocol))


def speed_of(run: FrameRun[Restorer], protocol: str) -> Speed:
    """Time the method on a frame of the run, in a separate process, to measure its memory.

    Raises:
        ToolkitError: no frame can be read, or the method fails on it.
    """
    speed: Speed = _apart(run, _speed_here, run, protocol)
    if run.devices[0] == "cpu" and usable_cores() >= CPU_CORES:
        seconds = _apart(run, _standard_here, run)
        speed = msgspec.structs.replace(speed, standard_s=seconds)
    return speed


def _apart(run: FrameRun[Restorer], call: Callable[..., Any], *args: Any) -> Any:
    """The result of a call in a process of its own."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        1, mp_context=context, initializer=inherit, initargs=inherited()
    ) as pool:
        try:
            return pool.submit(call, *args).result()
        except BrokenProcessPool as error:
            raise ToolkitError(
                "the process that times the method died (killed, or out of memory)",
                value=run.title,
                hint="--no-speed leaves the timing out",
            ) from error


def _standard_here(run: FrameRun[Restorer]) -> float:
    # Before anything starts threads, which are as many as there are cores.
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CPU_CORES])
    os.environ["NUMBA_NUM_THREADS"] = str(CPU_CORES)
    source, restorer = run.open(), run.make(run.devices[0])
    return standard_seconds(restorer, source.load(chosen_frames(len(source), 1)[0]))


def _speed_here(run: FrameRun[Restorer], protocol: str) -> Speed:
    source, restorer = run.open(), run.make(run.devices[0])
    frame = run.load(source, chosen_frames(len(source), 1)[0])
    view = restorer_view(frame, restorer, get_protocol(protocol).view_size)
    where = hardware()
    on_gpu = run.devices[0].startswith("cuda")
    return measure_speed(restorer, [view], hardware=where["gpus" if on_gpu else "processor"])
