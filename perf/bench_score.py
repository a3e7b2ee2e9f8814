"""Scoring rate of saved results: `python perf/bench_score.py [--frames 64]`.

Data sets in the layouts of STD and ClearGrasp are written, and beside them restored depth as
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
from benchmark.data.predictions import DepthFolder, WithSavedDepth
from benchmark.data.splits import FrameKey, open_split
from benchmark.evaluation.tasks.depth import save_depth
from benchmark.methods.protocol import Restored
from benchmark.metrics.protocols import get_protocol, score_frame
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_png
from std_toolkit.jobs.memory import keep_freed_memory

# Split, size of ground truth, size of restored depth, protocol, frames/s wanted of two cores.
CASES = (
    ("std-catknown", (224, 224), (224, 224), "strict", 300),
    ("std-catknown", (224, 224), (224, 224), "paper", 300),
    ("std-catknown", (224, 126), (224, 126), "strict", 600),
    ("std-catknown", (640, 360), (640, 360), "strict", None),
    ("std-catknown", (1280, 720), (1280, 720), "strict", 100),
    ("cleargrasp-real-known", (1280, 720), (1280, 720), "strict", 100),
    ("cleargrasp-real-known", (1280, 720), (1280, 720), "cleargrasp", 40),
)
SHOWN = 8  # frames written; the disk's cache holds them as it would hold a data set's newest


def picture(size: tuple[int, int], seed: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Ground truth of eight round objects, 0 elsewhere, and their mask."""
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


def write_std(folder: Path, index: int, true: np.ndarray, mask: np.ndarray) -> FrameKey:
    """A frame in STD's layout; depth compressed in blocks of lines, OpenCV's way."""
    scene = folder / "STD" / "STD-CatKnown" / "test_0"
    scene.mkdir(parents=True, exist_ok=True)
    height, width = true.shape
    camera = {"width": width, "height": height, "fx": 1.4 * width, "fy": 1.4 * width}
    camera |= {"cx": width / 2 - 0.5, "cy": height / 2 - 0.5}
    record = folder / "STD" / "parameters" / scene.parent.name / f"{scene.name}.json"
    record.parent.mkdir(parents=True, exist_ok=True)
    record.write_text(json.dumps(camera))
    key = FrameKey(scene.name, f"{index:04d}")
    write_exr(scene / f"{key.name}_gt_depth.exr", dict.fromkeys("RGB", true), compression="zip")
    write_png(scene / f"{key.name}_mask.png", mask)
    lines = [f"{i + 1} {1 + i % 7} mug model 0.15 {i % 4} 1 0 0 0 0 0 0.7 \n" for i in range(8)]
    (scene / f"{key.name}_meta.txt").write_text("".join(lines))
    return key


def write_cleargrasp(folder: Path, index: int, true: np.ndarray, mask: np.ndarray) -> FrameKey:
    """A frame in ClearGrasp's layout: half floats, one mask of all objects."""
    captures = folder / "real-val"
    captures.mkdir(parents=True, exist_ok=True)
    height, width = true.shape
    intrinsics = f"fx: {0.7 * width}\nfy: {0.7 * width}\ncx: {width / 2}\ncy: {height / 2}\n"
    size = f"xres: {width}\nyres: {height}\n"
    (captures / "camera_intrinsics.yaml").write_text(intrinsics + size)
    stem = f"{index:09d}"
    channels = dict.fromkeys("RGB", true.astype(np.float16))
    write_exr(captures / f"{stem}-opaque-depth-img.exr", channels, compression="zip")
    write_png(captures / f"{stem}-mask.png", np.where(mask == BACKGROUND, 0, 255).astype(np.uint8))
    return FrameKey(f"real-val-{stem}", stem)


WRITERS = {"std-catknown": write_std, "cleargrasp-real-known": write_cleargrasp}


def write_data(folder: Path, split: str, size: tuple[int, int], restored: tuple[int, int]) -> None:
    """A root with the split, and `saved/depth` with restored depth."""
    for i in range(SHOWN):
        key = WRITERS[split](folder, i, *picture(size, i))
        seen, _ = picture(restored, i)
        rng = np.random.default_rng(i)
        depth = np.where(seen > 0, seen, np.float32(0.8)) + rng.normal(0, 0.01, seen.shape)
        depth[rng.random(seen.shape) < 0.05] = 0
        save_depth(folder / "saved", split, key, Restored(depth.astype(np.float32)))


def opened(folder: Path, split: str) -> WithSavedDepth:
    return WithSavedDepth(open_split(split, folder), DepthFolder(folder / "saved" / "depth", split))


def load(source: WithSavedDepth, index: int) -> DepthFrame:
    return source.load(index % SHOWN, sensor=False)


def work(folder: Path, split: str, protocol: str, frames: int) -> int:
    """Load and score; the number of rows."""
    source = opened(folder, split)
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


def row(first: str, *cells: str) -> str:
    widths = (14, 11, 12, 9, 10, 21, 8, 22)
    return f"{first:<22}" + "".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=64)
    frames = parser.parse_args().frames
    keep_freed_memory()  # as workers of std-bench do
    titles = ("ground truth", "restored", "protocol", "load ms", "score ms", "frames/s of 2 cores")
    print(row("", *titles, "wanted", "elapsed, 2 processes"))
    for split, size, restored, protocol, wanted in CASES:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_data(folder, split, size, restored)
            source = opened(folder, split)
            whole = processor_ms(lambda: work(folder, split, protocol, frames), frames)  # noqa: B023
            only = [load(source, i) for i in range(SHOWN)]
            rules = get_protocol(protocol)
            score = processor_ms(
                lambda: [score_frame(f.depth_raw, f, rules) for f in only],  # noqa: B023
                SHOWN,
            )
            context = multiprocessing.get_context("spawn")
            with context.Pool(2, initializer=keep_freed_memory) as pool:
                pool.starmap(work, [(folder, split, protocol, 2)] * 2)
                began = time.perf_counter()
                pool.starmap(work, [(folder, split, protocol, frames)] * 2, chunksize=1)
                elapsed = 2 * frames / (time.perf_counter() - began)
        print(
            row(
                split,
                "x".join(map(str, size)),
                "x".join(map(str, restored)),
                protocol,
                f"{whole - score:.2f}",
                f"{score:.2f}",
                f"{2000 / whole:.0f}",
                str(wanted or ""),
                f"{elapsed:.0f} frames/s",
            )
        )


if __name__ == "__main__":
    main()
