"""Speed and memory of `std-restore`, reading and writing included.

    python perf/restore.py [--frames 60] [--workers 2]
    python perf/restore.py --by-default
    python perf/restore.py --memory 10000

Made-up frames of 640x360 (colour and depth as PNG) are restored by the compact SwinDRNet alone;
`--by-default`: of 640x480, as `std-restore` does by default. The
time of a frame is the difference between a run of all frames and a run of a tenth of them, which
takes off the start. On a machine that is busy with other work, elapsed time says little. Processor
time is measured with `--engine serial` and one thread; `of 2 cores` is what two free cores do,
2 / (processor time of a frame), because the workers share nothing but the disk.

With `--memory N`, eight frames of 320x180 are repeated N times (hard links), and the memory of the
program and its workers (proportional set size) is printed along the way.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

REPOSITORY = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(REPOSITORY))

from benchmark.restoring.onnx_export import made_up_views  # noqa: E402
from std_toolkit.io.images import write_color, write_depth_png16  # noqa: E402

CAMERA, SMALL, VGA = (640, 360), (320, 180), (640, 480)
KINDS = 8


def make_frames(folder: Path, count: int, size: tuple[int, int]) -> None:
    """A folder of frames; every eighth is a hard link to the same images."""
    rng = np.random.default_rng(0)
    for index in range(count):
        color, depth = folder / f"color/{index:06d}.png", folder / f"depth/{index:06d}.png"
        if index < KINDS:
            view = made_up_views(size)[0]
            # Smooth, as images of cameras are; noise alone would not compress.
            image = cv2.GaussianBlur(np.roll(view.color, 20 * index, 1), (0, 0), 1.5)
            write_color(color, np.asarray(image, np.uint8))
            noise = rng.normal(0, 1e-3, view.depth.shape)
            write_depth_png16(depth, np.where(view.depth > 0, view.depth + noise, 0), scale=1e-3)
        else:
            for path in (color, depth):
                os.link(path.with_name(f"{index % KINDS:06d}.png"), path)


def words(folder: Path, out: Path, size: tuple[int, int], *jobs: str) -> list[str]:
    k = f"{size[0]},{size[0]},{(size[0] - 1) / 2},{(size[1] - 1) / 2}"
    return [
        *(sys.executable, "-m", "benchmark.cli.restore", str(folder), "--out", str(out)),
        *("--intrinsics", k, "--depth-scale", "0.001", "--quiet", *jobs),
    ]


def run(command: list[str]) -> tuple[float, float]:
    """Elapsed and processor time of a program with its children."""
    before, since = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    one = os.environ | ({"OMP_NUM_THREADS": "1"} if "serial" in command else {})
    subprocess.run(command, cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL, env=one)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - since, used


def speed(frames: int, workers: int, by_default: bool) -> None:
    size, where = CAMERA, ("--where", "everywhere")
    if by_default:
        size, where = VGA, ()
    print(f"{'start [s]':>10} {'frames/s':>9} {'CPU [ms]':>9} {'of 2 cores':>11}")
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        few = max(workers, frames // 10)
        make_frames(root / "all", frames, size)
        make_frames(root / "few", few, size)
        found = {}
        for engine in (("--workers", str(workers)), ("--engine", "serial")):
            times = [
                run(words(root / n, root / f"{n}-{engine[1]}", size, *engine, *where))
                for n in ("few", "all")
            ]
            each = [(b - a) / (frames - few) for a, b in zip(*times, strict=True)]
            found[engine[1]] = each, times[0][0] - few * each[0]
        (elapsed, _), start = found[str(workers)]
        (_, processor), _ = found["serial"]
        print(f"{start:10.1f} {1 / elapsed:9.1f} {1e3 * processor:9.1f} {2 / processor:11.1f}")
        if not by_default:
            steps(root / "all", root / "steps")


def steps(folder: Path, out: Path) -> None:
    """Print the processor time of each step of a frame, one thread."""
    from benchmark.methods.depth.full_size import sensor_view, to_full_size
    from benchmark.restoring.outputs import RestoreSetup, paths_of, write_frame
    from benchmark.restoring.recordings import open_recordings
    from benchmark.restoring.restorer import RestoredFrame, Restorer
    from std_toolkit.importers.options import ImageOptions

    os.environ["OMP_NUM_THREADS"] = "1"
    cv2.setNumThreads(1)
    k = f"640,640,{(CAMERA[0] - 1) / 2},{(CAMERA[1] - 1) / 2}"
    recording = open_recordings([folder], ImageOptions(intrinsics=k, depth_scale=1e-3), out)[0]
    restorer = Restorer.load(where="everywhere")
    setup = RestoreSetup(
        method="swindrnet", preset="compact", settings={}, weights_sha256="",
        size=[*(restorer.method.input_size or ())], backend="onnx", depth_format="same",
        points=False, pictures=False,
    )  # fmt: skip
    least: dict[str, float] = {}
    for index in range(2 * KINDS):
        marks = [time.process_time()]
        frame = replace(recording.frames[index], name=f"{index}")
        color, sensor = frame.read()
        marks.append(time.process_time())
        view = sensor_view(color, sensor, frame.camera, restorer.method.input_size)
        answer = restorer.method.restore([view])[0]
        marks.append(time.process_time())
        full = to_full_size(sensor, answer, color)
        marks.append(time.process_time())
        found = RestoredFrame(full.depth, full.confidence, ~full.believed)
        write_frame(paths_of(out, frame, "same"), frame, color, sensor, found, setup)
        marks.append(time.process_time())
        for name, a, b in zip(
            ("read", "network", "enlarge", "write"), marks, marks[1:], strict=False
        ):
            least[name] = min(least.get(name, 9.0), b - a)
    told = ", ".join(f"{name} {1e3 * value:.1f}" for name, value in least.items())
    print(f"least processor time in ms: {told}")


def pss_mib(pid: int) -> float:
    """Memory of a process and those below it, shared pages counted once in all."""
    total = 0
    for child in [pid, *descendants(pid)]:
        try:
            lines = Path(f"/proc/{child}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total / 1024


def descendants(pid: int) -> list[int]:
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        below = [int(c) for t in tasks for c in (t / "children").read_text().split()]
    except OSError:
        return []
    return below + [c for b in below for c in descendants(b)]


def memory(count: int, workers: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        root = Path(place)
        make_frames(root / "all", count, SMALL)
        command = words(root / "all", root / "out", SMALL, "--workers", str(workers))
        with subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.DEVNULL) as program:
            reached, step, most = 0, max(1, count // 10), 0.0
            print(f"{'frames':>8} {'MiB':>8}")
            while program.poll() is None:
                time.sleep(1)
                folder = root / "out/frames"
                done = sum(1 for _ in folder.iterdir()) if folder.is_dir() else 0
                used = pss_mib(program.pid)
                most = max(most, used)
                if done >= reached + step or (reached == 0 and done >= 50):
                    reached = done
                    print(f"{done:8d} {used:8.1f}", flush=True)
            print(f"{'most':>8} {most:8.1f}")
            if program.returncode != 0:
                sys.exit(program.returncode)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", type=int, metavar="N")
    parser.add_argument("--by-default", action="store_true")
    args = parser.parse_args()
    if args.memory:
        memory(args.memory, args.workers)
    else:
        speed(args.frames, args.workers, args.by_default)


if __name__ == "__main__":
    main()
