"""Reading packed frames for training against the raw data set: `python perf/train_data.py`.

Frames of DREDS (colour 1280x720, maps 640x360) at 224x224, in batches of 32. Processor time of one
thread per frame, the least of several rounds, because the machine may be busy; the files are in
the page cache. The goal is 400 frames a second on 2 cores: 5 ms of processor time per frame.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import cv2
import torch
from bench_data import FRAMES, write_set
from torch.utils.data import DataLoader

from benchmark.data.splits import open_split
from benchmark.data.torch_dataset import DepthDataset
from benchmark.training.frame_order import BatchOrder, Steps
from benchmark.training.options import PackOptions
from benchmark.training.pack import pack_split
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import network_inputs, target_of
from std_toolkit.jobs import JobOptions

SPLIT, SIZE, BATCH, ROUNDS = "dreds-catknown-test", (224, 224), 32, 5
GOAL_MS = 5.0  # two cores, 400 frames a second


def least_ms(work: Callable[[], object], frames: int) -> float:
    """Processor time of a frame."""
    work()
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        work()
        times.append(1000 * (time.process_time() - began) / frames)
    return min(times)


def row(title: str, ms: float, note: str = "") -> None:
    print(f"{title:52s} {ms:8.2f} ms {1000 / ms:8.0f} frames/s and core   {note}")


def in_processes(frames: PackedFrames, count: int) -> None:
    """All that a DataLoader with one reader costs, reader and receiver, its start taken off."""
    took = {}
    for steps in (20, 220):
        order = BatchOrder(len(frames), BATCH, seed=0)
        sampler = Steps(order, lambda: 0, steps=steps, end=steps)
        loader = DataLoader(frames, sampler=sampler, batch_size=None, num_workers=count)
        before = getrusage(RUSAGE_CHILDREN)
        own, wall = time.process_time(), time.perf_counter()
        for batch in loader:
            network_inputs(batch)
            target_of(batch)
        del loader
        after = getrusage(RUSAGE_CHILDREN)
        children = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        took[steps] = (children + time.process_time() - own, time.perf_counter() - wall)
    frames_read = 200 * BATCH
    processor = 1000 * (took[220][0] - took[20][0]) / frames_read
    wall = 1000 * (took[220][1] - took[20][1]) / frames_read
    cores = len(os.sched_getaffinity(0))
    row(
        f"packed, {count} reader(s), to tensors of the network",
        processor,
        f"by the clock {1000 / wall:.0f} frames/s on {cores} cores",
    )


def main() -> None:
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        write_set(top, "dreds")
        source = open_split(SPLIT, top)
        # As many as make a batch: links to the few that were drawn.
        first = top / "DREDS-CatKnown" / "test" / "00000"
        for scene in range(1, 2 * BATCH // FRAMES + 1):
            (first.parent / f"{scene:05d}").symlink_to(first)
        source = open_split(SPLIT, top)
        raw = DepthDataset(source, SIZE, color="cubic")
        slow = least_ms(lambda: [raw[i] for i in range(FRAMES)], FRAMES)
        row("PNG and EXR as they are", slow)
        for depth in ("float32", "float16"):
            pack = top / depth
            began = time.process_time()
            pack_split(
                pack,
                SPLIT,
                top,
                PackOptions(size=SIZE, depth=depth),  # type: ignore[arg-type]
                JobOptions(engine="serial"),
            )
            packing = 1000 * (time.process_time() - began) / len(source)
            size = sum(p.stat().st_size for p in pack.glob("*.npy")) / len(source)
            row(f"packing, {depth}", packing, f"{size / 1e3:.0f} kB a frame")
            frames = PackedFrames([pack])
            chosen = list(range(BATCH))
            fast = least_ms(partial(frames.__getitem__, chosen), BATCH)
            outcome = "reached" if fast <= GOAL_MS else "NOT reached"
            row(f"packed, {depth}", fast, f"{slow / fast:.0f} times as fast; goal {outcome}")
        in_processes(PackedFrames([top / "float32"]), 1)
        in_processes(PackedFrames([top / "float32"]), 2)


if __name__ == "__main__":
    main()
