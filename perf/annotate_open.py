"""Time and memory of std-annotate when it opens a scene of 900 or more frames of 1280x720.

    python perf/annotate_open.py [--frames 900] [--runs 5] [--scene DIR]

Every run is a fresh process, timed from its start by the system's clock; CPU seconds, of all
threads, are reliable on a busy machine. Times are the least of all runs, memory is the largest;
the images are in the file cache.

session       the headless session alone, until the first image is decoded; then all images
bare window   one empty view of pyvistaqt, the lower bound for any window
std-annotate  the command, watched from outside on a virtual display drawn in software: until the
              image of the first frame is on the screen, until the views show it beside the
              panels, and until the meshes are there, too, and nothing changes any more
window        the same window made in Python, then shown a third of all frames
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

REPOSITORY = Path(__file__).resolve().parent.parent
LIMIT_SECONDS, LIMIT_VIEWS_SECONDS, LIMIT_MIB = 1.0, 3.0, 1536
# On a busy machine a window takes minutes.
PATIENCE_SECONDS = 600
IMAGES = 12
WIDTH, HEIGHT = 1600, 1000
Stages = dict[str, list[float]]


def make_scene(folder: Path, frames: int) -> Path:
    """A labelled scene of the synthetic table top; all frames are links to a few images."""
    import msgspec

    from sensors.synthetic import RecordingOptions, make_recording, scene_from_truth
    from std_toolkit.jobs import JobOptions
    from std_toolkit.scene import CameraPoses, Frames, Scene

    options = RecordingOptions(frames=IMAGES, width=1280, height=720, samples=1)
    make_recording(folder / "recording", options, jobs=JobOptions(progress=False))
    few = scene_from_truth(folder / "recording", folder / "few")
    rows, poses = [], []
    for i in range(frames):
        # To and fro, so that the path has no jumps.
        turn = i % (2 * IMAGES - 2)
        k = turn if turn < IMAGES else 2 * IMAGES - 2 - turn
        row, name = few.frames[k], f"{i:06d}"
        color, depth = f"color/{name}.png", f"depth/{name}.png"
        for source, target in ((row.color, color), (row.depth, depth)):
            (folder / "scene" / target).parent.mkdir(parents=True, exist_ok=True)
            os.link(folder / "few" / str(source), folder / "scene" / target)
        rows.append(msgspec.structs.replace(row, id=i, name=name, color=color, depth=depth))
        assert few.poses is not None
        poses.append(msgspec.structs.replace(few.poses.frames[k], frame=i))
    (folder / "few" / "models").rename(folder / "scene" / "models")
    scene = Scene.create(folder / "scene", few.info, Frames(frames=rows), few.objects)
    scene.save_poses(CameraPoses(frames=poses, source="truth"))
    scene.save_labels(few.labels)
    return scene.root


# --- what runs in a process of its own ---------------------------------------------------------


def peak_mib(process: str = "self") -> float:
    """Largest resident memory of a process since it began, MiB."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def open_session(scene: Path, reached: Callable[[str], None]) -> None:
    from annotator.app.image_cache import ImageCache
    from annotator.session import Session

    reached("imports")
    with Session.open(scene, read_only=True) as session, ImageCache(session.scene) as images:
        reached("documents")
        images.image(session.scene.frames[0].id)
        reached("first image")
        for frame in session.scene.frames:
            images.image(frame.id)
            images.thumbnail(frame.id, 160)
        reached("every frame read")


def open_bare_window(_: Path, reached: Callable[[str], None]) -> None:
    import pyvistaqt
    from PySide6.QtWidgets import QApplication, QMainWindow

    reached("imports")
    app = QApplication(["bare"])
    window = QMainWindow()
    view = pyvistaqt.QtInteractor(window, auto_update=False, multi_samples=1)
    window.setCentralWidget(view)
    window.resize(1280, 720)
    window.show()
    app.processEvents()
    view.render()
    app.processEvents()
    reached("shown")
    view.close()


def open_window(scene: Path, reached: Callable[[str], None]) -> None:
    from annotator.qt.qt_app import make_application
    from annotator.startup import quick_imports

    app = make_application()
    with quick_imports():
        from annotator.qt.main_window import Shell
    reached("imports")
    shell = Shell()
    shell.show()
    shell.open_scene(scene, read_only=True)
    until = time.monotonic() + 3
    while time.monotonic() < until:
        app.processEvents()
    reached("opened, 3 s later")
    assert shell.controller is not None
    for frame in shell.controller.session.scene.frames[::3]:
        shell.controller.show_frame(frame.id)
        app.processEvents()
    reached("every 3rd frame shown")
    shell.close()


KINDS = {"session": open_session, "bare window": open_bare_window, "window": open_window}


def child(kind: str, scene: Path, began: float) -> None:
    stages: Stages = {}

    def reached(stage: str) -> None:
        stages[stage] = [time.monotonic() - began, time.process_time(), peak_mib()]

    reached("python")
    KINDS[kind](scene, reached)
    print(json.dumps(stages), flush=True)
    os._exit(0)


# --- from outside ---------------------------------------------------------


@contextmanager
def virtual_display() -> Iterator[tuple[dict[str, str], Callable[[], NDArray[np.uint8]]]]:
    """Yield the environment for a program on a new display, and a function that returns its screen.

    The screen is (H, W, 3) in BGR order, read from the display server, not from the program.
    """
    number, tell_number = os.pipe()
    command = ["Xvfb", "-displayfd", str(tell_number), "-screen", "0", f"{WIDTH}x{HEIGHT}x24"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(
            [*command, "-fbdir", folder, "-nolisten", "tcp", "-noreset"],
            pass_fds=[tell_number],
            stderr=subprocess.DEVNULL,
        ) as server,
    ):
        os.close(tell_number)
        with os.fdopen(number) as answer:
            name = f":{answer.readline().strip()}"
        # The server's picture is a file in X's own format: header, colour map, rows of pixels.
        file = np.memmap(Path(folder) / "Xvfb_screen0", dtype=np.uint8, mode="r")
        header = np.frombuffer(file[:100].tobytes(), ">u4")
        start, row = int(header[0] + 12 * header[19]), int(header[12])

        def shown() -> NDArray[np.uint8]:
            rows = np.array(file[start : start + row * HEIGHT]).reshape(HEIGHT, row)
            return rows[:, : 4 * WIDTH].reshape(HEIGHT, WIDTH, 4)[..., :3]

        environment = {**os.environ, "DISPLAY": name, "LIBGL_ALWAYS_SOFTWARE": "1"}
        environment |= {"QT_API": "pyside6", "QT_QPA_PLATFORM": "xcb"}
        # As for a person: compiled once, by the first run, which does not count.
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        try:
            yield environment, shown
        finally:
            server.terminate()


def measure(kind: str, scene: Path) -> Stages:
    """Seconds and CPU seconds since the start, and peak MiB, at each stage of one run."""
    command = [sys.executable, __file__, "--child", kind, "--scene", str(scene)]
    with virtual_display() as (environment, _):
        done = subprocess.run(
            [*command, "--began", repr(time.monotonic())],
            capture_output=True,
            text=True,
            env=environment,
            cwd=REPOSITORY,
            timeout=600,
        )
    if done.returncode != 0:
        raise SystemExit(f"{kind} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def watch_command(scene: Path) -> Stages:
    """`std-annotate SCENE` until its first frame is seen, and until the picture stays."""
    command = [sys.executable, "-m", "annotator.cli", str(scene), "--read-only", "--quiet"]
    stages: Stages = {}
    with virtual_display() as (environment, shown):
        before = shown()
        began = changed = time.monotonic()
        process = subprocess.Popen(command, env=environment, cwd=REPOSITORY)

        def reached(stage: str, at: float) -> None:
            times = Path(f"/proc/{process.pid}/stat").read_text().rsplit(") ", 1)[1].split()
            cpu = (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")
            stages[stage] = [at - began, cpu, peak_mib(str(process.pid))]

        while "everything drawn" not in stages:
            if process.poll() is not None or time.monotonic() > began + PATIENCE_SECONDS:
                process.kill()
                raise SystemExit("std-annotate showed no image")
            time.sleep(0.01)
            picture, now = shown(), time.monotonic()
            if not np.array_equal(picture, before):
                before, changed = picture, now
                if "window" not in stages:
                    reached("window", now)
                # Images have many colours, panels and text few. While the views are being loaded
                # the image fills the window, thereafter there are panels on its right.
                middle, right = colours(picture[350:550, 250:550]), colours(picture[300:700, 1200:])
                if "first frame" not in stages and middle > 2000:
                    reached("first frame", now)
                if "views" not in stages and middle > 2000 > right:
                    reached("views", now)
            elif "views" in stages and now > changed + 2.0:
                reached("everything drawn", changed)
        process.terminate()
        process.wait()
    return stages


def colours(picture: NDArray[np.uint8]) -> int:
    return len(np.unique(picture.reshape(-1, 3) @ np.array([1, 256, 65536])))


# --- the table ---------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=900)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--scene", type=Path, help="this scene instead of a synthetic one")
    parser.add_argument("--child", choices=KINDS, help=argparse.SUPPRESS)
    parser.add_argument("--began", type=float, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child:
        child(args.child, args.scene, args.began)
    if shutil.which("Xvfb") is None:
        raise SystemExit("needs Xvfb; on Debian: apt-get install xvfb")
    with tempfile.TemporaryDirectory() as folder:
        scene = args.scene or make_scene(Path(folder), args.frames)
        print(f"{'':14}{'stage':22}{'seconds':>9}{'CPU s':>8}{'peak MiB':>10}")
        table("session", [measure("session", scene)])
        table("bare window", [measure("bare window", scene) for _ in range(args.runs)])
        watch_command(scene)
        table("std-annotate", [watch_command(scene) for _ in range(args.runs)])
        table("window", [measure("window", scene)])
    print(
        f"limits: first frame in {LIMIT_SECONDS} s, all views in {LIMIT_VIEWS_SECONDS} s, "
        f"{LIMIT_MIB} MiB"
    )


def table(kind: str, runs: list[Stages]) -> None:
    for stage in runs[0]:
        seconds, cpu = (min(run[stage][i] for run in runs) for i in (0, 1))
        memory = max(run[stage][2] for run in runs)
        print(f"{kind:14}{stage:22}{seconds:9.2f}{cpu:8.2f}{memory:10.0f}", flush=True)


if __name__ == "__main__":
    main()
