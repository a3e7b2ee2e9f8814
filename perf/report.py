"""Time and size of the page of many runs: `python perf/report.py [--runs 200] [--scenes 20]`.

`std-bench` scores one method, with pictures, on frames of 640x360 in STD's layout. Its run is
copied under other names, its errors multiplied by a random factor for each method and scene. Then
`std-report` is run; its processor time, its largest memory and the size of its page are printed, or
with `--site` those of `std-report site` and its largest page.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import msgspec
import numpy as np
from bench_score import picture, write_std

from benchmark.evaluation.manifest import MANIFEST, Manifest
from benchmark.evaluation.results import TABLE, read_table
from benchmark.metrics.depth.figures import NAMES
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.io.exr import write_exr
from std_toolkit.io.images import write_color

SIZE = (640, 360)
LIMIT_S, LIMIT_MB = 60, 20


def write_data(root: Path, scenes: int, frames: int) -> None:
    """Scenes with colour of noise, and sensor depth with noise and holes."""
    for scene in reversed(range(scenes)):
        for i in range(frames):
            seed = scene * frames + i
            true, mask = picture(SIZE, seed)
            key = write_std(root, i, true, mask)
            rng = np.random.default_rng(seed)
            folder = root / "STD" / "STD-CatKnown" / key.scene
            colour = rng.integers(0, 256, (*true.shape, 3)).astype(np.uint8)
            write_color(folder / f"{key.name}_color.png", cv2.GaussianBlur(colour, (0, 0), 3))
            depth = np.where(true > 0, true, 0.8) + rng.normal(0, 0.01, true.shape)
            depth[cv2.GaussianBlur(rng.random(true.shape), (0, 0), 5) < 0.48] = 0
            channels = dict.fromkeys("RGB", depth.astype(np.float32))
            write_exr(folder / f"{key.name}_depth_415.exr", channels, compression="zip")
        parameters = root / "STD" / "parameters" / "STD-CatKnown"
        if scene:
            folder.rename(folder.with_name(f"test_{scene}"))
            record = (parameters / "test_0.json").read_bytes()
            (parameters / f"test_{scene}.json").write_bytes(record)


def copy_run(run: Path, to: Path, label: str, seed: int) -> None:
    """The run as that of another method."""
    shutil.copytree(run, to, ignore=shutil.ignore_patterns("parts"))
    manifest = read_document(run / MANIFEST, Manifest)
    write_document(to / MANIFEST, msgspec.structs.replace(manifest, label=label))
    table, rng = read_table(run / TABLE), np.random.default_rng(seed)
    names = table["scene"].unique()
    factors = np.exp(rng.normal(rng.normal(0, 0.3), 0.2, len(names)))
    scenes = dict(zip(names, factors, strict=True))
    for name in NAMES:
        table[name] *= table["scene"].map(scenes)
    table.to_parquet(to / TABLE, index=False, write_page_checksum=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--frames", type=int, default=4, help="of each scene (4)")
    parser.add_argument("--site", action="store_true", help="the site instead of the page")
    parser.add_argument("--keep", type=Path, help="folder for data and results")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        top = args.keep or Path(folder)
        results = top / f"results-{args.runs}-{args.scenes}"
        if not results.exists():
            write_data(top / "data", args.scenes, args.frames)
            bench = ["depth", "--method", "raw", "--data", str(top / "data" / "STD")]
            bench += ["--split", "std-catknown", "--engine", "serial", "--out", str(top / "one")]
            words = [sys.executable, "-m", "benchmark.cli.bench", *bench]
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
            run = next((top / "one").rglob(MANIFEST)).parent
            for i in range(args.runs):
                copy_run(run, results / f"m{i}", f"method {i}", i)
        words = [sys.executable, "-m", "benchmark.cli.report"]
        site = top / "site"
        words += ["site", str(results), "--out", str(site)] if args.site else [str(results)]
        began = time.monotonic()
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        if os.waitstatus_to_exitcode(status):
            return 1
        cpu = usage.ru_utime + usage.ru_stime
        pages = site.rglob("*.html") if args.site else [results / "report.html"]
        page_mb = max(page.stat().st_size for page in pages) / 1e6
        print("runs  scenes  processor s  wall s  memory MB  page MB")
        print(
            f"{args.runs:4d}  {args.scenes:6d}  {cpu:11.1f}  {time.monotonic() - began:6.1f}  "
            f"{usage.ru_maxrss * 1024 / 1e6:9.0f}  {page_mb:7.1f}"
        )
        return int(cpu > LIMIT_S or page_mb > LIMIT_MB)


if __name__ == "__main__":
    sys.exit(main())
