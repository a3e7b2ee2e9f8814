"""Cost of a simulated frame: `python perf/simulate.py [--views 30] [--seed 0]`.

One scene of the built-in objects is simulated from many views, as std-sim makes it: objects drawn
and settled, infrared pair, colour, denoising, exact maps, matching, alignment, files in the DREDS
layout. Twice: on one thread, which tells processor seconds by step (start-up apart), and on all
cores with the finishing of a view beside the rendering of the next, which tells seconds by the
clock. What a set of 130,000 images costs follows from the first on CPUs, where scenes go to
one-thread workers, and from the second on a GPU where Mitsuba runs on one.

Settling is measured with the convex parts of all shapes computed again, and with cached parts: the
cost of a shape occurs once, for any number of scenes. Processor seconds are reliable on a busy
machine.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sensors.output.dreds import dreds_scene
from sensors.render.variant import choose_variant
from sensors.simulation.options import SimulationOptions
from sensors.simulation.simulator import Simulator, Stopwatch

IMAGES = 130_000
# Shapes that such a set is made of: 250 training shapes in each of eight categories.
SHAPES = 2000


def processor_seconds() -> float:
    """Of this process, all its threads, and its finished children."""
    t = os.times()
    return t.user + t.system + t.children_user + t.children_system


class Measured:
    """Processor seconds and seconds by the clock of a block."""

    processor = clock = 0.0

    @contextmanager
    def block(self) -> Iterator[None]:
        began = processor_seconds(), time.perf_counter()
        yield
        self.processor += processor_seconds() - began[0]
        self.clock += time.perf_counter() - began[1]


def simulate(simulator: Simulator, seed: int, out: Path) -> tuple[Measured, int]:
    """Simulate one scene; returns its cost and its number of objects."""
    cost = Measured()
    with cost.block():
        world = simulator.world(seed, f"{seed:05d}")
        with dreds_scene(out, world.record, split="train") as writer:
            for frame in simulator.frames(world):
                with simulator.stopwatch.part("write"):
                    writer.add(frame)
    return cost, len(world.record.objects)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quality", default="draft")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--one-thread", action="store_true", help="leave the second run out")
    args = parser.parse_args()
    options = SimulationOptions(
        views=args.views, width=args.width, height=args.height, quality=args.quality
    )
    cores = len(os.sched_getaffinity(0))
    variant = choose_variant()
    on_gpu = variant.startswith("cuda")
    views = options.views
    print(f"{variant}, {views} views of one scene, {args.width}x{args.height}, {args.quality}")

    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        start = Measured()
        with start.block():
            single = Simulator(options, parts_cache=top / "parts", threads=1)
            single.stopwatch = Stopwatch(clock=processor_seconds)
        cost, objects = simulate(single, args.seed, top / "one")
        steps = dict(single.stopwatch.seconds)
        again = Stopwatch(clock=processor_seconds)
        single.stopwatch = again
        single.world(args.seed, "again")
        kept = again.seconds["settle"]
        anew = steps["settle"] - kept
        per_frame = (cost.processor - anew) / views

        print(f"\none thread, {objects} objects; start-up {start.processor:.1f} s once a process")
        print(f"{'step':14s} {'processor s a frame':>20s} {'share':>7s}")
        for step, seconds in steps.items():
            seconds = kept if step == "settle" else seconds
            print(f"{step:14s} {seconds / views:20.3f} {seconds / views / per_frame:7.1%}")
        rest = per_frame - (sum(steps.values()) - anew) / views
        print(f"{'rest':14s} {rest:20.3f} {rest / per_frame:7.1%}")
        print(f"{'all':14s} {per_frame:20.3f}   ({cost.clock / views:.2f} s by the clock here)")
        print(
            f"convex parts made anew: {anew:.1f} s a scene, {anew / objects:.2f} s a shape, "
            f"{anew / views:.2f} s a frame; all with them {cost.processor / views:.2f} s"
        )

        wide = Measured()
        if not args.one_thread or on_gpu:
            every = Simulator(options, parts_cache=top / "parts")
            wide, _ = simulate(every, args.seed, top / "all")
            busy = wide.processor / wide.clock / cores
            print(
                f"\n{cores} threads, {'and a GPU, ' if on_gpu else ''}one scene at a time: "
                f"{wide.clock / views:.2f} s by the clock a frame, "
                f"{wide.processor / views:.2f} s of processor, cores {busy:.0%} busy"
            )

    shapes = SHAPES * anew / objects / 3600
    hours = IMAGES * per_frame / 3600 + shapes
    print(f"\n{IMAGES:,} images: {hours:.0f} core hours, {shapes:.1f} of them for {SHAPES} shapes:")
    for count in (2, 64):
        print(f"  {count:2d} cores: {hours / count:6.1f} h ({hours / count / 24:.1f} days)")
    if on_gpu and wide.clock:
        clock = wide.clock / views
        print(f"  one GPU: {IMAGES * clock / 3600:.1f} h at {1 / clock:.2f} frames/s")
    else:
        print("  one GPU: not measured, Mitsuba runs on none here")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
