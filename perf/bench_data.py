"""Reading frames to score, per frame and core: `python perf/bench_data.py`.

Each row is compared with a baseline without this package: cv2.imread, the OpenEXR package with all
channels, no checks. Processor time on one thread, the least of several rounds, because the machine
may be busy.
"""

from __future__ import annotations

import os
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

import cv2
import numpy as np
import OpenEXR

from benchmark.data.splits import DepthSource, open_split
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color, write_png

FRAMES, ROUNDS = 6, 5
SCENES, PER_SCENE = 30, 1000
META = "".join(f"{i} {i % 8} 02876657 thing 0.2 {i % 4} 1 0 0 0 0 0 1 \n" for i in range(1, 8))


def picture(width: int, height: int) -> np.ndarray:
    """Smooth, with the noise of a sensor."""
    rng = np.random.default_rng(0)
    smooth = cv2.resize(rng.integers(0, 256, (18, 32, 3), dtype=np.uint8), (width, height))
    return np.clip(smooth + rng.normal(0, 3, smooth.shape), 0, 255).astype(np.uint8)


def depth_maps(width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact depth of seven balls over a slanted table, that of a sensor, and ids."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width] / height
    exact = 0.8 - 0.2 * y
    ids = np.full((height, width), 255, np.uint8)
    for i in range(1, 8):
        gap = 0.012 - (x - 0.22 * i) ** 2 - (y - 0.3 - 0.4 * (i % 2)) ** 2
        exact = np.where(gap > 0, 0.55 - 0.3 * np.sqrt(np.maximum(gap, 0)), exact)
        ids[gap > 0] = i
    raw = exact + rng.normal(0, 0.001, exact.shape)
    raw[rng.random(raw.shape) < 0.05] = -0.001
    return exact.astype(np.float32), raw.astype(np.float32), ids


def write_equal(path: Path, values: np.ndarray) -> None:
    write_exr(path, dict.fromkeys("RGB", values), compression="zip")


def write_set(top: Path, kind: str) -> None:
    exact, raw, ids = depth_maps(640, 360)
    full = depth_maps(1280, 720)
    color = picture(1280, 720)
    for i in range(FRAMES):
        if kind == "dreds":
            base = top / f"DREDS-CatKnown/test/00000/{i:04d}"
            write_equal(base.with_name(f"{base.name}_simDepthImage.exr"), raw)
            write_equal(base.with_name(f"{base.name}_depth_120.exr"), exact)
            write_equal(base.with_name(f"{base.name}_mask.exr"), ids / np.float32(255))
        elif kind == "std":
            base = top / f"STD-CatKnown/test_8/{i:04d}"
            write_equal(base.with_name(f"{base.name}_depth_415.exr"), full[1])
            on_objects = np.where(ids < 255, exact, np.float32(0))
            write_equal(base.with_name(f"{base.name}_gt_depth.exr"), on_objects)
            write_png(base.with_name(f"{base.name}_mask.png"), ids)
        else:
            base = top / f"real-val/d435/{i:09d}"
            write_color(base.with_name(f"{base.name}-transparent-rgb-img.jpg"), color)
            for name, values in (("transparent", full[1]), ("opaque", full[0])):
                half = np.maximum(values, 0).astype(np.float16)
                write_equal(base.with_name(f"{base.name}-{name}-depth-img.exr"), half)
            mask = np.where(full[2] < 255, 255, 0).astype(np.uint8)
            write_png(base.with_name(f"{base.name}-mask.png"), mask)
            intrinsics = "fx: 921\nfy: 921\ncx: 642\ncy: 359\n"
            (base.parent / "camera_intrinsics.yaml").write_text(intrinsics)
            continue
        write_color(base.with_name(f"{base.name}_color.png"), color)
        base.with_name(f"{base.name}_meta.txt").write_text(META)


def plain_exr(path: Path) -> np.ndarray:
    with OpenEXR.File(str(path)) as file:
        return file.channels()["RGB"].pixels[..., 0].astype(np.float32)


def plain(folder: Path, stem: str, suffixes: tuple[str, ...]) -> None:
    for suffix in suffixes:
        path = folder / f"{stem}{suffix}"
        if suffix.endswith(".exr"):
            np.clip(plain_exr(path), 0, None)
        else:
            cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def least_ms(work: Callable[[int], object]) -> float:
    """Processor time of a frame."""
    work(0)
    times = []
    for _ in range(ROUNDS):
        began = time.process_time()
        for i in range(FRAMES):
            work(i)
        times.append(1000 * (time.process_time() - began) / FRAMES)
    return min(times)


def row(title: str, source: DepthSource, suffixes: tuple[str, ...], *, sensor: bool) -> None:
    index = source.index  # type: ignore[attr-defined]
    places = [index.at(i) for i in range(FRAMES)]
    ours = least_ms(lambda i: source.load(i, sensor=sensor))
    naive = least_ms(lambda i: plain(Path(places[i][0].path), places[i][1], suffixes))
    print(
        f"{title:50s} {ours:7.1f} ms {1000 / ours:6.0f} frames/s   plain {naive:6.1f} ms"
        f"   {naive / ours:4.2f} of the speed"
    )


def reading(top: Path) -> None:
    sets = (
        ("dreds", "dreds-catknown-test", "DREDS: colour 1280x720, maps 640x360",
         ("_depth_120.exr", "_mask.exr"), ("_color.png", "_simDepthImage.exr")),
        ("std", "std-catknown", "STD: colour and raw 1280x720, truth 640x360",
         ("_gt_depth.exr", "_mask.png"), ("_color.png", "_depth_415.exr")),
        ("cleargrasp", "cleargrasp-real-known", "ClearGrasp: all 1280x720, half floats",
         ("-opaque-depth-img.exr", "-mask.png"),
         ("-transparent-rgb-img.jpg", "-transparent-depth-img.exr")),
    )  # fmt: skip
    for kind, split, title, truth, sensor in sets:
        write_set(top, kind)
        source = open_split(split, top)
        row(title, source, (*truth, *sensor), sensor=True)
        row("  truth and mask only (scoring saved results)", source, truth, sensor=False)


def listing(top: Path) -> None:
    """30,000 frames in 30 scenes, all of them links to one."""
    first = top / "many/STD-CatKnown/scene_0"
    first.mkdir(parents=True)
    names = ("_color.png", "_depth_415.exr", "_gt_depth.exr", "_mask.png", "_meta.txt")
    for i in range(PER_SCENE):
        for name in names:
            (first / f"{i:04d}{name}").touch()
    for k in range(1, SCENES):
        (top / f"many/STD-CatKnown/scene_{k}").symlink_to(first)
    began = time.process_time()
    source = open_split("std-catknown", top / "many")
    took = time.process_time() - began
    tracemalloc.start()
    held = open_split("std-catknown", top / "many")
    size = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    print(
        f"listing {len(source)} frames: {took:.2f} s, {size / 1e6:.1f} MB held ({len(held)} frames)"
    )


def tensors(top: Path) -> None:
    try:
        from torch.utils.data import DataLoader

        from benchmark.data.torch_dataset import DepthDataset
    except ImportError:
        print("no torch: no tensors")
        return
    data = DepthDataset(open_split("dreds-catknown-test", top), (224, 224), color="cubic")
    ms = least_ms(lambda i: data[i])
    print(
        f"{'DREDS as tensors of 224x224, colour cubic':50s} {ms:7.1f} ms {1000 / ms:6.0f} frames/s"
    )
    workers = os.cpu_count() or 1
    numbers = [i % FRAMES for i in range(400)]
    loader = DataLoader(data, batch_size=8, num_workers=workers, sampler=numbers)
    before = getrusage(RUSAGE_CHILDREN)
    made = sum(len(b["key"]) for b in loader)
    after = getrusage(RUSAGE_CHILDREN)
    took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(
        f"  in {workers} workers of a DataLoader, their start included: "
        f"{1000 * took / made:.1f} ms of processor time"
    )


def main() -> None:
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        reading(Path(folder))
        tensors(Path(folder))
        listing(Path(folder))


if __name__ == "__main__":
    main()
