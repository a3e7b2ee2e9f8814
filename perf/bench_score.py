"""How many saved results a second are scored: `python perf/bench_score.py [--frames 64]`.

A data set in STD's layout is written at several sizes, and beside it restored depth as
`std-bench --save-depth` keeps it. Each frame is then loaded (ground truth, mask, meta file and
restored depth; colour and sensor depth are not needed) and scored. Processor time per frame is what
to trust on a busy machine: frames/s of two cores are 2 / processor time. The elapsed time of two
processes is printed beside it.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.data.frame import BACKGROUND, DepthFrame
from benchmark.data.saved import WithSavedDepth
from benchmark.data.source import FrameKey
from benchmark.data.splits import open_split
from benchmark.methods.protocol import Restored
from benchmark.protocols import get_protocol, score_frame
from benchmark.running.saving import save_depth
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png

SPLIT = "std-catknown"
# Size of ground truth, size of restored depth, protocol, frames/s wanted of two cores.
CASES = (
    ((224, 224), (224, 224), "strict", 300),
    ((224, 224), (224, 224), "paper", 300),
    ((640, 360), (224, 224), "strict", None),
    ((640, 360), (640, 360), "strict", None),
    ((640, 360), (224, 224), "paper", None),
    ((1280, 720), (1280, 720), "strict", 40),
    ((1280, 720), (1280, 720), "paper", 40),
)
SHOWN = 8  # frames written; the disk's cache holds them as it would hold a data set's newest


def picture(size: tuple[int, int], seed: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Ground truth of eight round things, 0 elsewhere, and their mask."""
    width, height = size
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    true = np.zeros((height, width), np.float32)
    mask = np.full((height, width), BACKGROUND, np.uint8)
    for i in range(8):
        centre = np.array([0.14 + 0.24 * (i % 4), 0.3 + 0.4 * (i // 4)])
        centre += rng.uniform(-0.03, 0.03, 2)
        r = np.hypot((x / width - centre[0]) * 1.6, y / height - centre[1]) / 0.15
        inside = r < 1
        true[inside] = 0.7 + 0.1 * centre[1] - 0.1 * np.sqrt(1 - r[inside] ** 2)
        mask[inside] = i + 1
    return true, mask


def write_data(folder: Path, size: tuple[int, int], restored: tuple[int, int]) -> Path:
    """A root with the data set, and `saved/depth` with restored depth; returns the latter."""
    scene = folder / "STD" / "STD-CatKnown" / "test_0"
    scene.mkdir(parents=True)
    width, height = size
    camera = {"width": width, "height": height, "fx": 1.4 * width, "fy": 1.4 * width}
    camera |= {"cx": width / 2 - 0.5, "cy": height / 2 - 0.5}
    record = folder / "STD" / "parameters" / scene.parent.name / f"{scene.name}.json"
    record.parent.mkdir(parents=True)
    record.write_text(json.dumps(camera))
    meta = "".join(
        f"{i + 1} {1 + i % 7} mug model 0.15 {i % 4} 1 0 0 0 0 0 0.7 \n" for i in range(8)
    )
    for i in range(SHOWN):
        true, mask = picture(size, i)
        write_exr(scene / f"{i:04d}_gt_depth.exr", dict.fromkeys("RGB", true))
        write_png(scene / f"{i:04d}_mask.png", mask)
        (scene / f"{i:04d}_meta.txt").write_text(meta)
        seen, _ = picture(restored, i)
        rng = np.random.default_rng(i)
        depth = np.where(seen > 0, seen, np.float32(0.8)) + rng.normal(0, 0.01, seen.shape)
        depth[rng.random(seen.shape) < 0.05] = 0
        key = FrameKey(scene.name, f"{i:04d}")
        save_depth(folder / "saved", SPLIT, key, Restored(depth.astype(np.float32)))
    return folder / "saved" / "depth"


def load(source: WithSavedDepth, index: int) -> DepthFrame:
    return source.load(index % SHOWN, sensor=False)


def work(folder: Path, protocol: str, frames: int) -> int:
    """Load and score; the number of rows."""
    source = WithSavedDepth(open_split(SPLIT, folder), folder / "saved" / "depth")
    rules = get_protocol(protocol)
    rows = 0
    for i in range(frames):
        frame = load(source, i)
        rows += len(score_frame(frame.depth_raw, frame, rules))
    return rows


def processor_ms(task: Callable[[], object], frames: int, repeats: int = 3) -> float:
    """Least processor time per frame of some runs, after one that warms up."""
    task()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        task()
        times.append(time.process_time() - began)
    return 1000 * min(times) / frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=64)
    frames = parser.parse_args().frames
    print(
        f"{'ground truth':>13}{'restored':>11}{'protocol':>10}{'load ms':>9}{'score ms':>10}"
        f"{'frames/s of 2 cores':>21}{'wanted':>8}{'elapsed, 2 processes':>22}"
    )
    for size, restored, protocol, wanted in CASES:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_data(folder, size, restored)
            source = WithSavedDepth(open_split(SPLIT, folder), folder / "saved" / "depth")
            whole = processor_ms(lambda: work(folder, protocol, frames), frames)  # noqa: B023
            only = [load(source, i) for i in range(SHOWN)]
            rules = get_protocol(protocol)
            score = processor_ms(
                lambda: [score_frame(f.depth_raw, f, rules) for f in only],  # noqa: B023
                SHOWN,
            )
            with multiprocessing.get_context("spawn").Pool(2) as pool:
                pool.starmap(work, [(folder, protocol, 2)] * 2)
                began = time.perf_counter()
                pool.starmap(work, [(folder, protocol, frames)] * 2, chunksize=1)
                elapsed = 2 * frames / (time.perf_counter() - began)
        print(
            f"{'x'.join(map(str, size)):>13}{'x'.join(map(str, restored)):>11}{protocol:>10}"
            f"{whole - score:>9.2f}{score:>10.2f}{2000 / whole:>21.0f}"
            f"{wanted or '':>8}{f'{elapsed:.0f} frames/s':>22}"
        )


if __name__ == "__main__":
    main()
