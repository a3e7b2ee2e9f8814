"""Whether recording reaches the frame rate of a camera: `python perf/record.py`.

Frames of 1280x720 with colour, depth to align and an infrared pair go through std-record's writer.
The first table gives the time of each step on one core. The second gives the frame rate of the
writer by number of threads, relative to the camera's 30, and the number of cores for 30 frames a
second from the processor time, which depends little on other load. The third is ten seconds at 30
frames a second, with the dropped frames. The last column is the ratio to a simple baseline: one
thread, PNG with the defaults of OpenCV, no sync to disk.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path

import cv2
import numpy as np

from sensors.record.frame_files import aligned_units, write_sensor_png
from sensors.record.hints import HintMaker
from sensors.record.options import FileOptions, WriterOptions
from sensors.record.recording_document import CapturedFrame, Device, RecordingDocument, Session
from sensors.record.scene_writer import SceneWriter
from sensors.specs import load_sensor
from std_toolkit import __version__
from std_toolkit.io.images import write_color
from std_toolkit.scene.model import CameraModel, SceneInfo

WIDTH, HEIGHT, FPS = 1280, 720, 30
SECONDS = 10
COUNT = 45
SENSOR = load_sensor("d415")
DOCUMENT = RecordingDocument(
    device=Device(name=SENSOR.title),
    color=CameraModel.of(SENSOR.color_camera(WIDTH, HEIGHT)),
    depth=CameraModel.of(SENSOR.infrared_camera(WIDTH, HEIGHT)),
    T_color_depth=SENSOR.pose_of_color.inverse().flat(),
    depth_unit_m=0.001,
    aligned_by="toolkit",
    sessions=[Session(version=__version__, source="camera", first_frame=0)],
)


def frames(count: int) -> list[CapturedFrame]:
    """Smooth surfaces, edges, noise of a sensor, a tenth without depth."""
    rng = np.random.default_rng(0)
    out = []
    for number in range(count):
        smooth = rng.integers(20, 236, (24, 40, 3), dtype=np.uint8)
        color = cv2.resize(smooth, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC).astype(float)
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        depth = 900 - 0.4 * v
        for _ in range(12):
            x, y, r = rng.uniform(0, WIDTH), rng.uniform(0, HEIGHT), rng.uniform(30, 120)
            inside = (u - x) ** 2 + (v - y) ** 2 < r * r
            color[inside] = rng.uniform(20, 236, 3)
            depth[inside] -= rng.uniform(20, 150)
        color += rng.normal(0, 2, color.shape)
        depth += rng.normal(0, 0.7, depth.shape)
        holes = cv2.resize(rng.random((HEIGHT // 8, WIDTH // 8)), (WIDTH, HEIGHT)) < 0.15
        depth[holes] = 0
        grey = np.clip(color.mean(axis=2), 0, 255).astype(np.uint8)
        out.append(
            CapturedFrame(
                color=np.clip(color, 0, 255).astype(np.uint8),
                depth=np.rint(depth).astype(np.uint16),
                timestamp=number / FPS,
                infrared={"infrared_left": grey, "infrared_right": grey[:, ::-1].copy()},
                exposure_s=0.01,
            )
        )
    return out


def core_ms(work: Callable[[], object], repeats: int = 5) -> float:
    """Processor time of this process, all threads, in the least of the repeats."""
    work()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(1000 * (time.process_time() - began))
    return min(times)


def steps(folder: Path, frame: CapturedFrame) -> None:
    calibration, hints = DOCUMENT.calibration(), HintMaker(FPS)
    units = aligned_units(frame, calibration)
    rows: list[tuple[str, Callable[[], object]]] = [
        ("align depth to colour", lambda: aligned_units(frame, calibration)),
        ("colour as JPEG, on disk", lambda: write_color(folder / "c.jpg", frame.color)),
        ("colour as PNG, on disk", lambda: write_sensor_png(folder / "c.png", frame.color)),
        ("depth as PNG, on disk", lambda: write_sensor_png(folder / "d.png", units)),
        ("infrared as PNG, on disk", lambda: write_sensor_png(folder / "i.png", grey)),
        ("hints (eight times a second)", lambda: hints.look(frame)),
    ]
    grey = frame.infrared["infrared_left"]
    print(f"{'step':34}{'ms of a core':>14}")
    for name, work in rows:
        print(f"{name:34}{core_ms(work):14.1f}")


def plain_rate(folder: Path, pool: list[CapturedFrame]) -> float:
    """Frames a second of the simple baseline."""
    calibration = DOCUMENT.calibration()
    began = time.perf_counter()
    for number, frame in enumerate(pool):
        cv2.imwrite(str(folder / f"{number}.png"), frame.color[..., ::-1])
        cv2.imwrite(str(folder / f"{number}_depth.png"), aligned_units(frame, calibration))
    return len(pool) / (time.perf_counter() - began)


def writer(out: Path, files: FileOptions, threads: int, *, drop: bool) -> SceneWriter:
    info = SceneInfo(name="perf", cameras={"color": DOCUMENT.color}, depth_scale=0.001)
    return SceneWriter(out, info, DOCUMENT, WriterOptions(files, threads=threads), drop=drop)


def rates(folder: Path, pool: list[CapturedFrame], plain: float) -> None:
    cores = os.cpu_count() or 1
    counts = sorted({1, 2, min(8, cores)})
    head = f"{'frames/s':>10}{'of 30':>8}{'cores for 30':>14}{'MB/frame':>10}{'over plain':>12}"
    print(f"\n{'writer':34}{head}")
    print(f"{'plain: one thread, PNG':34}{plain:10.1f}{plain / FPS:8.2f}{'':24}{1:12.2f}")
    for title, files in (
        ("JPEG", FileOptions()),
        ("JPEG, infrared, raw depth", FileOptions(infrared=True, raw_depth=True)),
        ("PNG", FileOptions(color_format="png")),
    ):
        for threads in counts:
            out = folder / f"{title}{threads}".replace(", ", "_").replace(" ", "_")
            with writer(out, files, threads, drop=False) as made:
                began, used = time.perf_counter(), time.process_time()
                for frame in islice(cycle(pool), COUNT):
                    made.offer(frame)
                made.close()
                rate = COUNT / (time.perf_counter() - began)
                cores_needed = FPS * (time.process_time() - used) / COUNT
            size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / (1e6 * COUNT)
            name = f"{title}, {threads} thread{'s' if threads > 1 else ''}"
            print(
                f"{name:34}{rate:10.1f}{rate / FPS:8.2f}{cores_needed:14.2f}{size:10.2f}"
                f"{rate / plain:12.2f}"
            )


def paced(folder: Path, pool: list[CapturedFrame]) -> None:
    """Record ten seconds at the rate of a camera, including hints."""
    cores = os.cpu_count() or 1
    print(f"\n{SECONDS} s at {FPS} frames/s, {cores} cores")
    for title, files in (("JPEG", FileOptions()), ("PNG", FileOptions(color_format="png"))):
        hints = HintMaker(FPS)
        with writer(folder / f"paced_{title}", files, min(8, cores), drop=True) as made:
            began = time.perf_counter()
            for number, frame in enumerate(islice(cycle(pool), SECONDS * FPS)):
                time.sleep(max(0.0, began + number / FPS - time.perf_counter()))
                made.offer(frame)
                if number % 4 == 0 and made.waiting < 0.5:
                    hints.look(frame)
            print(f"  {title}: {made.taken} written, {made.dropped} dropped")


def main() -> None:
    pool = frames(12)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        steps(folder, pool[0])
        rates(folder, pool, plain_rate(folder, pool))
        paced(folder, pool)


if __name__ == "__main__":
    main()
