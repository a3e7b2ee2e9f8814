"""Speed, size and memory of a method, measured after warm-up on a frame of its split."""

import multiprocessing
import os
import resource
import statistics
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Annotated, Any

import msgspec

from benchmark.evaluation.frames import FrameRun, chosen_frames
from benchmark.evaluation.manifest import Count, hardware
from benchmark.methods.protocol import Restorer, View
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from std_toolkit.settings import in_force, use_only

SPEED = "speed.json"

# The first calls compile, allocate and fill caches.
WARM_UP = 2

FEWEST = 3

LONGEST_S = 10.0


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
    load: float | None = None


# Pixels of a frame, seconds and cores by which a method belongs to the class `cpu`.
CLASS_PIXELS, CLASS_S, CLASS_CORES = 640 * 480, 1.0, 2
CPU, GPU, NOT_STATED = "cpu", "gpu", "not stated"


def speed_class(speed: Speed | None, device: str) -> str:
    """Return the class in which a method is ranked.

    Args:
        speed: None if it was not measured.
        device: that it ran on, `cpu` or `cuda`.

    Returns:
        `cpu`: at most 1 s of 2 cores for a frame of 640x480, from the processor time; that of
        larger views is reduced by their pixels, that of smaller ones is taken as it is. `gpu`: runs
        on one, or is slower. `not stated`: not known.
    """
    if device == "cuda":
        return GPU
    if speed is None or speed.processor_s is None:
        return NOT_STATED
    share = min(1.0, CLASS_PIXELS / max(1, speed.width * speed.height))
    return CPU if speed.processor_s * share <= CLASS_S * CLASS_CORES else GPU


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
        begin, worked = time.perf_counter(), time.process_time()
        # The outputs are NumPy arrays, so a GPU has finished when the call returns.
        restorer.restore(views)
        seconds.append(time.perf_counter() - begin)
        processor.append(time.process_time() - worked)
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
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        1, mp_context=context, initializer=use_only, initargs=(in_force(),)
    ) as pool:
        try:
            return pool.submit(_speed_here, run, protocol).result()
        except BrokenProcessPool as error:
            raise ToolkitError(
                "the process that times the method died (killed, or out of memory)",
                value=run.title,
                hint="--no-speed leaves the timing out",
            ) from error


def _speed_here(run: FrameRun[Restorer], protocol: str) -> Speed:
    from benchmark.methods.depth.full_size import restorer_view
    from benchmark.metrics.protocols.protocol import get_protocol

    source, restorer = run.open(), run.make(run.devices[0])
    frame = source.load(chosen_frames(len(source), 1)[0])
    view = restorer_view(frame, restorer, get_protocol(protocol).view_size)
    where = hardware()
    on_gpu = run.devices[0].startswith("cuda")
    return measure_speed(restorer, [view], hardware=where["gpus" if on_gpu else "processor"])
