"""Memory of a run over 30,000 frames: resident size of the scoring process during the run.

    python perf/bench_memory.py [--frames 30000]

The frames of 64x36 pixels are generated on demand, so that only the memory of the run can grow.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from benchmark.data.frame import DepthFrame, Instance, Material
from benchmark.data.splits import FrameKey, Split
from benchmark.evaluation.engine import run_task
from benchmark.evaluation.tasks.depth import Run
from benchmark.methods.registry import MethodOptions
from std_toolkit.geometry.camera import Camera
from std_toolkit.jobs import JobOptions

FRAMES = int(os.environ.get("BENCH_MEMORY_FRAMES", "30000"))
CAMERA = Camera(64, 36, 60.0, 60.0, 31.5, 17.5)


class MadeUp:
    """A split of generated frames that are not kept."""

    name = "made-up"

    def __len__(self) -> int:
        return FRAMES

    def keys(self) -> list[FrameKey]:
        return [FrameKey(f"{i // 900:05d}", f"{i % 900:04d}") for i in range(FRAMES)]

    def load(self, index: int, *, sensor: bool = True, nocs: bool = False) -> DepthFrame:  # noqa: ARG002 - nothing is read
        rng = np.random.default_rng(index)
        true = rng.uniform(0.5, 0.7, (36, 64)).astype(np.float32)
        mask = np.where(true > 0.6, 255, 1).astype(np.uint8)
        key = f"{index // 900:05d}", f"{index % 900:04d}"
        color = np.zeros((36, 64, 3), np.uint8)
        return DepthFrame(
            *key, color, true, true, mask, CAMERA, (Instance(1, 6, Material.SPECULAR),)
        )


SPLIT = Split("made-up", "", "", lambda root: MadeUp())  # noqa: ARG005 - made of nothing


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    seen: list[tuple[int, float]] = []

    class Watched(Run):
        def rows(self, data, methods, frames):
            first = frames[0][0]["index"]
            if first % (FRAMES // 10) < 8:
                seen.append((first, resident_mib()))
            return super().rows(data, methods, frames)

    with tempfile.TemporaryDirectory() as folder:
        run = Watched(
            split="__main__:SPLIT",
            root=Path(folder),
            method="raw",
            options=MethodOptions(),
            protocol="strict",
            label="raw",
            out=Path(folder) / "out",
        )
        table = run_task(run, JobOptions(engine="serial"))
        size = sum(p.stat().st_size for p in run.folder.rglob("*.parquet")) / 2**20
        print(f"{'frames':>8}{'resident MiB':>14}")
        for index, mib in seen:
            print(f"{index:8d}{mib:14.0f}")
        print(f"joined: {resident_mib():.0f} MiB; {len(table)} rows, {size:.0f} MiB on disk")


if __name__ == "__main__":
    main()
