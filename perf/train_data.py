"""Reading packed frames for training against the raw data set: `python perf/train_data.py`.

Also what augmentation costs: that of the shipped weights, then with the augmentations of depth and
colour in which colour alone tells where glass is, too, and each of these alone, at 224x126 in
batches of 16.

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
from benchmark.training.config import Optimization, TrainConfig
from benchmark.training.frame_order import BatchOrder, Steps
from benchmark.training.module import RestorerTraining
from benchmark.training.options import PackOptions
from benchmark.training.pack import pack_split
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.step import model_input, network_inputs, target_of
from std_toolkit.jobs import JobOptions

SPLIT, SIZE, BATCH, ROUNDS = "dreds-catknown-test", (224, 224), 32, 5
WIDE, AUGMENTED, BATCHES = (224, 126), 16, 4  # size, frames and batches of augmentation
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


# Shares that an augmented training has today, and what makes colour the only witness.
TODAY = {"copy_paste": 0.2, "geometry": True, "colors": True, "object_dropout": 0.35}
MORE = {"clear_gone": 0.35, "clear_behind": 0.35, "holes": 0.7, "wrong_color": 0.1}


def augmentation(frames: PackedFrames) -> None:
    """Times of augmented batches, those of alternatives by turns."""
    batch = frames[list(range(AUGMENTED))]
    inputs = model_input(batch)
    chosen = {
        "as of the shipped weights": TODAY,
        "with all of depth and colour, too": TODAY | MORE,
        **{f"{name} alone": {"colors": False, name: share} for name, share in MORE.items()},
        "glass gone and seen through": {k: MORE[k] for k in ("clear_gone", "clear_behind")},
    }
    config = {"method": "swindrnet", "preset": "compact", "optimization": Optimization()}
    config |= {"steps": 1, "validate_every": 1, "checkpoint_every": 1}
    config |= {"training": "", "validation": ""}
    made = {
        title: RestorerTraining(
            TrainConfig(**config | {"colors": False} | shares),  # type: ignore[arg-type]
            torch.nn.Identity(),
            None,  # type: ignore[arg-type]
            None,
            str,
        )
        for title, shares in chosen.items()
    }
    times: dict[str, list[float]] = {title: [] for title in made}
    for repeat in range(ROUNDS + 1):
        for title, module in made.items():
            torch.manual_seed(repeat)
            began = time.process_time()
            for _ in range(BATCHES):
                module.augmented(inputs)
            times[title].append(1000 * (time.process_time() - began) / BATCHES / AUGMENTED)
    # The first round warms up. Of the same draws the least time, because the machine may be busy.
    least = {title: sum(sorted(t[1:])[:3]) / 3 for title, t in times.items()}
    today = least["as of the shipped weights"]
    for title, ms in least.items():
        row(f"augmentation, {title}", ms, f"{ms / today:.2f} times")


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
        wide = top / "wide"
        pack_split(
            wide, SPLIT, top, PackOptions(size=WIDE, color="area"), JobOptions(engine="serial")
        )
        augmentation(PackedFrames([wide]))
        in_processes(PackedFrames([top / "float32"]), 1)
        in_processes(PackedFrames([top / "float32"]), 2)


if __name__ == "__main__":
    main()
