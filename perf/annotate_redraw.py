"""Latency of the annotator's views while an object is dragged, and time to full detail.

    python perf/annotate_redraw.py [--drags 40] [--mesh textured.obj]

A window of 1280x720 with a main view and three side views of a 1280x720 recording, six objects of
50,000 faces, 200,000 points in the cloud; in style textured, the same solids with a texture of
4096x4096 each, or six times the given mesh. An object is dragged by mouse events as Qt delivers
them. Printed are the time until the view in hand shows the new pose, the time until all four do,
and the time from letting go until all four are in full detail. Where there is no display, one is
started; the driver drawn with is named.

The last column estimates the elapsed time on an idle machine: processor time of the main thread,
and that of the driver's threads divided among the cores. On a busy machine only that column is
valid.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
import trimesh
from PIL import Image
from render import CAMERA, bumpy_solid, make_scene

from annotator.views.viewset import SETTLE_S
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene.scene import Scene

if TYPE_CHECKING:
    from annotator.app.view_options import Mode, Style

LIMITS_MS = {"view in hand": 50.0, "all four": 150.0, "full detail": 600.0}
CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def scene_with_depth(root: Path) -> Scene:
    """The scene of perf/render.py with a picture and a depth map in every frame."""
    make_scene(root, 60)
    rng = np.random.default_rng(0)
    coarse = rng.integers(40, 220, (45, 80, 3), dtype=np.uint8)
    picture = np.kron(coarse, np.ones((16, 16, 1), np.uint8))
    write_color(root / "color.png", picture)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    depth = 0.8 + 0.0002 * v + 0.01 * np.sin(u / 50)
    write_depth_png16(root / "depth.png", depth.astype(np.float32), scale=0.0001)
    scene = Scene.open(root)
    frames = [msgspec.structs.replace(f, depth="depth.png") for f in scene.frames]
    table = msgspec.structs.replace(scene.frame_table, frames=frames)
    shutil.rmtree(root / ".std", ignore_errors=True)
    (root / "frames.json").write_bytes(msgspec.json.encode(table))
    scene.save_info(msgspec.structs.replace(scene.info, depth_scale=0.0001))
    return Scene.open(root)


def give_textures(root: Path, mesh: Path | None) -> None:
    """Replace the meshes of the scene by ones with a texture: their own, or a given mesh."""
    objects = Scene.open(root).objects
    models = []
    for k, model in enumerate(objects.models):
        name = f"models/{model.id}/textured.glb"
        if mesh is None:
            solid = bumpy_solid(k)
            unit = solid.vertices / np.linalg.norm(solid.vertices, axis=1, keepdims=True)
            uv = np.stack([np.arctan2(unit[:, 1], unit[:, 0]) / (2 * np.pi) + 0.5,
                           unit[:, 2] / 2 + 0.5], axis=1)  # fmt: skip
            noise = np.random.default_rng(k).integers(30, 230, (512, 512, 3), dtype=np.uint8)
            texture = Image.fromarray(np.kron(noise, np.ones((8, 8, 1), np.uint8)))
            material = trimesh.visual.material.PBRMaterial(baseColorTexture=texture)
            solid.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        else:
            solid = load_mesh(mesh)
            solid.apply_translation(-solid.bounds.mean(axis=0))
        solid.export(root / name)
        size = solid.extents.tolist()
        models.append(
            msgspec.structs.replace(model, mesh=name, size_m=size, diameter_m=float(solid.scale))
        )
    Scene.open(root).save_objects(msgspec.structs.replace(objects, models=models))


class Taken(NamedTuple):
    """Elapsed milliseconds, and their estimate on an idle machine."""

    clock: float
    alone: float


class Watch:
    """Measures the time since its creation."""

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self._process, self._thread = time.process_time(), time.thread_time()

    def taken(self, *, waited_ms: float = 0.0) -> Taken:
        thread = time.thread_time() - self._thread
        driver = time.process_time() - self._process - thread
        alone = thread + driver / CORES
        return Taken(1000 * (time.perf_counter() - self.start), 1000 * alone + waited_ms)


class Bench:
    """A window with four views, and a mouse in it."""

    def __init__(self, root: Path) -> None:
        from PySide6.QtCore import QTimer
        from PySide6.QtWidgets import QApplication, QGridLayout, QMainWindow, QWidget
        from pyvistaqt import QtInteractor

        from annotator.app.controller import Controller
        from annotator.app.image_cache import ImageCache
        from annotator.app.tasks import InlineRunner
        from annotator.session import Session
        from annotator.views import ViewSet

        self.app = QApplication.instance() or QApplication(["perf"])
        self.session = Session.open(root, annotator="perf", read_only=False)
        self.controller = Controller(
            self.session,
            ImageCache(self.session.scene),
            runner=InlineRunner(),
            view_frames=[0, 12, 24, 36],
        )
        self.window = QMainWindow()
        middle = QWidget()
        self.window.setCentralWidget(middle)
        grid = QGridLayout(middle)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(2)
        self.widgets = [QtInteractor(middle, auto_update=False, multi_samples=0) for _ in range(4)]
        grid.addWidget(self.widgets[0], 0, 0, 3, 1)
        for i, widget in enumerate(self.widgets[1:]):
            grid.addWidget(widget, i, 1)
        grid.setColumnStretch(0, 3)
        grid.setColumnStretch(1, 1)
        self.window.resize(1280, 720)
        self.window.show()
        self.wait(lambda: all(w.isVisible() for w in self.widgets))
        self.views = ViewSet(
            self.controller,
            self.widgets,
            later=lambda s, f: QTimer.singleShot(round(1000 * s), f),
        )
        self.drawn = [0.0] * 4
        for i, widget in enumerate(self.widgets):
            widget.ren_win.AddObserver("EndEvent", lambda *_, i=i: self._note(i))
        self.wait(lambda: not self.views.shapes.pending)
        self.settle()

    def _note(self, view: int) -> None:
        self.drawn[view] = time.perf_counter()

    def wait(self, done: Callable[[], bool], seconds: float = 60.0, *, idle: bool = False) -> None:
        end = time.perf_counter() + seconds
        while not done():
            self.app.processEvents()
            if idle:
                time.sleep(0.001)
            if time.perf_counter() > end:
                raise TimeoutError("the views do not settle")

    def settle(self) -> None:
        """Wait until all views are in full detail and drawing has finished."""
        self.wait(lambda: not any(v.moving for v in self.views.views))
        quiet = time.perf_counter() + 0.5
        while time.perf_counter() < max(quiet, max(self.drawn) + 0.4):
            self.app.processEvents()

    def mouse(self, kind: str, x: float, y: float, *, held: bool = True) -> None:
        from PySide6.QtCore import QEvent, QPointF, Qt
        from PySide6.QtGui import QMouseEvent

        left, none = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton
        button = none if kind == "MouseMove" else left
        buttons = left if held else none
        widget = self.widgets[0]
        at = QPointF(x, y)
        event = QMouseEvent(
            getattr(QEvent.Type, kind),
            at,
            widget.mapToGlobal(at),
            button,
            buttons,
            Qt.KeyboardModifier.NoModifier,
        )
        self.app.sendEvent(widget, event)

    def drag(self, name: str, moves: int) -> dict[str, list[Taken]]:
        """Return the measurements while an object is dragged and released."""
        view = self.views.views[0]
        pose, solid = view.T_eye_obj(name), view.solid(name)
        assert pose is not None and solid is not None
        x, y = view.screen.project(pose @ solid.shape.centre)
        times: dict[str, list[Taken]] = {name: [] for name in LIMITS_MS}
        self.mouse("MouseButtonPress", x, y)
        for i in range(moves):
            shift = 6 + 30 * np.sin(i / 6)
            others, watch = max(self.drawn[1:]), Watch()
            self.mouse("MouseMove", x + shift, y + 0.4 * shift)
            self.wait(lambda watch=watch: self.drawn[0] > watch.start)
            self.app.processEvents()
            # Now and then the others follow; that is measured below.
            if max(self.drawn[1:]) == others:
                times["view in hand"].append(watch.taken())
        for i in range(moves // 2):
            # All four at once: the throttle of the others is not what is measured.
            shift = 6 + 30 * np.cos(i / 6)
            self.wait(lambda: not self.views.others_due)
            watch = Watch()
            self.mouse("MouseMove", x + shift, y)
            for other in self.views.views[1:]:
                other.draw()
            self.wait(lambda watch=watch: min(self.drawn) > watch.start)
            self.app.processEvents()
            times["all four"].append(watch.taken())
        watch = Watch()
        self.mouse("MouseButtonRelease", x + 10, y, held=False)
        # The wait for a pause is spent in the loop of events: it would count as work.
        self.wait(lambda: self._full_since(watch.start), idle=True)
        times["full detail"].append(watch.taken(waited_ms=1000 * SETTLE_S))
        self.settle()
        return times

    def _full_since(self, start: float) -> bool:
        return min(self.full_drawn(i) for i in range(4)) > start

    def full_drawn(self, view: int) -> float:
        """When the view was last drawn in full detail; 0 while it is not."""
        return 0.0 if self.views.views[view].moving else self.drawn[view]


def measure(args: argparse.Namespace) -> int:
    os.environ.setdefault("QT_API", "pyside6")
    from annotator.app.view_options import Mode, Style

    plain = [
        ("image, solid", Mode.IMAGE, Style.SOLID),
        ("image, contour", Mode.IMAGE, Style.CONTOUR),
        ("image, wireframe", Mode.IMAGE, Style.WIREFRAME),
        ("cloud, solid", Mode.CLOUD, Style.SOLID),
    ]
    textured = [
        ("image, textured", Mode.IMAGE, Style.TEXTURED),
        ("cloud, textured", Mode.CLOUD, Style.TEXTURED),
    ]
    worst = Taken(0.0, 0.0)
    for has_textures, cases in ((False, plain), (True, textured)):
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder) / "scene"
            scene_with_depth(root)
            if has_textures:
                give_textures(root, args.mesh)
            found = measure_scene(root, cases, args.drags)
        worst = Taken(max(worst.clock, found.clock), max(worst.alone, found.alone))
    print(f"\nlargest median by its limit: {worst.clock:.2f}; alone: {worst.alone:.2f}")
    return 0


def measure_scene(root: Path, cases: list[tuple[str, Mode, Style]], drags: int) -> Taken:
    """Print the times of some styles; return the largest medians by their limits."""
    from annotator.app.view_options import CloudSource

    start = time.perf_counter()
    bench = Bench(root)
    print(f"views shown and settled after {time.perf_counter() - start:.1f} s")
    capabilities = bench.widgets[0].ren_win.ReportCapabilities()
    print(next(line for line in capabilities.splitlines() if "renderer" in line.lower()))
    sizes = ", ".join(f"{w.width()}x{w.height()}" for w in bench.widgets)
    print(f"views {sizes}; {CORES} cores, load {os.getloadavg()[0]:.1f}; times in ms\n")
    print(f"{'':34s}{'median':>8s}{'p90':>8s}{'limit':>8s}{'alone':>8s}")
    worst = worst_alone = 0.0
    for title, mode, style in cases:
        bench.controller.set_mode(mode)
        bench.controller.set_options(style=style, cloud=CloudSource.FRAME)
        bench.settle()
        times: dict[str, list[Taken]] = {}
        for name in ("o4", "o1", "o3"):
            for key, values in bench.drag(name, drags).items():
                times.setdefault(key, []).extend(values)
        for key, values in times.items():
            (middle, alone), (high, _) = np.median(values, 0), np.percentile(values, 90, 0)
            limit = LIMITS_MS[key]
            print(f"{title + ': ' + key:34s}{middle:8.0f}{high:8.0f}{limit:8.0f}{alone:8.0f}")
            worst = max(worst, middle / limit)
            worst_alone = max(worst_alone, alone / limit)
    bench.views.close()
    bench.session.close(discard=True)
    bench.window.close()
    return Taken(worst, worst_alone)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drags", type=int, default=40, help="moves of the mouse per drag")
    parser.add_argument("--mesh", type=Path, help="textured mesh of all objects in style textured")
    args = parser.parse_args()
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        program = shutil.which("Xvfb")
        if program is None:
            print("needs a display or Xvfb", file=sys.stderr)
            return 1
        number, tell = os.pipe()
        server = subprocess.Popen(
            [program, "-displayfd", str(tell), "-screen", "0", "1600x1200x24", "-nolisten", "tcp"],
            pass_fds=[tell],
            stderr=subprocess.DEVNULL,
        )
        os.close(tell)
        with os.fdopen(number) as answer:
            os.environ["DISPLAY"] = f":{answer.readline().strip()}"
        os.environ["QT_QPA_PLATFORM"] = "xcb"
        try:
            # In a process of its own: Qt aborts if its display goes first.
            return subprocess.call([sys.executable, __file__, *sys.argv[1:]])
        finally:
            server.terminate()
            server.wait()
    return measure(args)


if __name__ == "__main__":
    sys.exit(main())
