"""A small scene and views of it without a window, with the hands of a person and a clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyvista
import trimesh
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.image_cache import ImageCache
from annotator.app.tasks import InlineRunner
from annotator.session import Session
from annotator.views import SceneView, ViewSet
from annotator.views.interaction import interactor_of
from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.scene import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    Label,
    Labels,
    Model,
    Object,
    ObjectTable,
    Scene,
    SceneInfo,
)

CAMERA = Camera(320, 240, 300.0, 290.0, 163.3, 116.8)
LENS = Camera(320, 240, 300.0, 290.0, 163.3, 116.8, (-0.12, 0.05, 0.002, -0.001))
GREY = 90
TABLE_M = 0.8
T_WORLD_RING = SE3.exp([-0.07, 0.0, 0.6, 0.5, 0.3, 0.1])
T_WORLD_BOX = SE3.exp([0.09, 0.02, 0.62, 0.2, 0.5, 0.0])


def meshes() -> dict[str, trimesh.Trimesh]:
    """A ring, which has a hole, and a box."""
    return {
        "ring": trimesh.creation.torus(0.05, 0.018, major_sections=96, minor_sections=48),
        "box": trimesh.creation.box((0.06, 0.09, 0.04)),
    }


def camera_pose(index: int) -> SE3:
    """Cameras on an arc around the objects."""
    middle = SE3(np.eye(3), np.array([0.0, 0.0, 0.6]))
    turn = SE3.exp([0.0, 0.0, 0.0, 0.05 * index, -0.15 * index, 0.0])
    return middle @ turn @ middle.inverse()


def write_scene(
    root: Path,
    *,
    frames: int = 5,
    camera: Camera = CAMERA,
    depth: bool = True,
    posed: bool = True,
    unregistered: Sequence[int] = (),
    size: tuple[int, int] | None = None,
    objects: bool = True,
) -> Path:
    """A scene of grey images whose number is written into them, a wall behind the objects."""
    rows = []
    for i in range(frames):
        image = np.full((camera.height, camera.width, 3), GREY, np.uint8)
        cv2.putText(image, str(i), (8, 230), cv2.FONT_HERSHEY_SIMPLEX, 1.0, (140, 140, 140), 2)
        write_color(root / f"color/{i:06d}.png", image)
        if depth:
            wall = np.full((camera.height, camera.width), TABLE_M, np.float32)
            write_depth_png16(root / f"depth/{i:06d}.png", wall, scale=0.001)
        rows.append(
            Frame(
                id=i,
                name=f"{i:06d}",
                color=f"color/{i:06d}.png",
                depth=f"depth/{i:06d}.png" if depth else None,
            )
        )
    models = []
    for name, mesh in meshes().items():
        path = root / f"models/{name}/{name}.ply"
        path.parent.mkdir(parents=True)
        mesh.export(path)
        extents = [float(x) for x in mesh.extents]
        models.append(
            Model(
                id=name,
                mesh=f"models/{name}/{name}.ply",
                size_m=extents,
                diameter_m=float(np.linalg.norm(extents)),
            )
        )
    scene = Scene.create(
        root,
        SceneInfo(name="desk", cameras={"color": CameraModel.of(camera)}, depth_scale=0.001),
        Frames(frames=rows),
        ObjectTable(
            models=sorted(models, key=lambda m: m.id) if objects else [],
            objects=[
                Object(id=1, name="ring_1", model="ring", material="diffuse"),
                Object(id=2, name="box_1", model="box", material="transparent"),
            ]
            if objects
            else [],
        ),
    )
    if posed:
        scene.save_poses(
            CameraPoses(
                frames=[
                    FramePose(
                        frame=i,
                        status="unregistered" if i in unregistered else "registered",
                        T_world_cam=None if i in unregistered else camera_pose(i).flat(),
                    )
                    for i in range(frames)
                ],
                source="import:test",
            )
        )
    if objects:
        T_cam_world = camera_pose(0).inverse()
        scene.save_labels(
            Labels(
                labels=[
                    Label(object=i, frame=0, T_cam_obj=(T_cam_world @ T).flat())
                    for i, T in ((1, T_WORLD_RING), (2, T_WORLD_BOX))
                ]
            )
        )
    return root


class Clock:
    """Time that passes only when told to, and what is to be done in it."""

    def __init__(self) -> None:
        self.now = 0.0
        self._jobs: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0

    def __call__(self) -> float:
        return self.now

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        self._count += 1
        self._jobs.append((self.now + seconds, self._count, action))

    def pass_(self, seconds: float) -> None:
        """Let time pass, doing what becomes due in its order."""
        end = self.now + seconds
        while self._jobs:
            job = min(self._jobs, key=lambda j: j[:2])
            if job[0] > end + 1e-9:
                break
            self._jobs.remove(job)
            self.now = max(self.now, job[0])
            job[2]()
        self.now = end


class Desk:
    """Views of a scene, drawn without a window."""

    def __init__(
        self,
        root: Path,
        *,
        sizes: Sequence[tuple[int, int]] = ((640, 480), (200, 160)),
        read_only: bool = False,
        repaint: Callable[[Any], None] | None = None,
    ) -> None:
        self.session = Session.open(root, annotator="test", recover="no", read_only=read_only)
        self.controller = Controller(
            self.session,
            ImageCache(self.session.scene),
            runner=InlineRunner(),
            view_frames=list(range(len(sizes))),
        )
        self.events: list[Event] = []
        self.controller.subscribe(self.events.append)
        self.clock = Clock()
        self.plotters = [pyvista.Plotter(off_screen=True, window_size=size) for size in sizes]
        self.views = ViewSet(
            self.controller,
            self.plotters,
            later=self.clock.later,
            clock=self.clock,
            repaint=repaint,
            background=False,
        )
        self.settle()

    def close(self) -> None:
        self.views.close()
        for plotter in self.plotters:
            plotter.close()
        self.controller.images.close()
        self.session.close(discard=True)

    def settle(self) -> None:
        """Until every view is in full detail."""
        self.clock.pass_(3.0)

    @property
    def main(self) -> SceneView:
        return self.views.views[0]

    def pose(self, name: str = "ring_1", frame: int = 0) -> SE3:
        pose = self.session.pose(name, frame)
        assert pose is not None
        return pose

    def messages(self) -> list[str]:
        return [e.text for e in self.events if e.kind == "message"]

    # --- hands ----------------------------------------------------------------------------------

    def on(self, name: str, view: int = 0) -> NDArray[np.float64]:
        """Screen position at which an object is surely hit: of a point of its surface."""
        drawn = self.views.views[view]
        solid = drawn.solid(name)
        assert solid is not None and solid.T_eye_obj is not None
        vertices, faces = solid.shape.full.corners
        middles = solid.T_eye_obj @ vertices[faces].mean(axis=1)
        nearest = middles[np.argmin(middles[:, 2])]
        return drawn.screen.project(nearest)

    def event(
        self,
        kind: str,
        at: Sequence[float] | NDArray[np.float64],
        *,
        view: int = 0,
        shift: bool = False,
        ctrl: bool = False,
        repeat: int = 0,
    ) -> None:
        """One event of the mouse at a screen position; its pixel is what is told."""
        interactor = interactor_of(self.plotters[view])
        height = self.views.views[view].size[1]
        x, y = int(np.floor(at[0])), int(height - 1 - np.floor(at[1]))
        interactor.SetEventInformation(x, y, int(ctrl), int(shift), "\0", repeat, None)
        interactor.InvokeEvent(f"{kind}Event")

    def drag(
        self,
        start: Sequence[float] | NDArray[np.float64],
        *way: Sequence[float],
        button: str = "Left",
        release: bool = True,
        **keys: Any,
    ) -> None:
        """Press, move by each of `way` relative to the start, and let go."""
        self.event("MouseMove", start, **keys)
        self.event(f"{button}ButtonPress", start, **keys)
        at = np.asarray(start, dtype=float)
        for dx, dy in way:
            at = np.asarray(start, dtype=float) + np.array([dx, dy])
            self.event("MouseMove", at, **keys)
        if release:
            self.event(f"{button}ButtonRelease", at, **keys)

    def click(self, at: Sequence[float] | NDArray[np.float64], **keys: Any) -> None:
        self.drag(at, **keys)

    def press(self, key: str, view: int = 0) -> None:
        interactor = interactor_of(self.plotters[view])
        interactor.SetKeySym(key)
        interactor.InvokeEvent("KeyPressEvent")


def edits(desk: Desk) -> list[str]:
    """Titles of the edits in force."""
    return [step.title for step in desk.session.steps]


def pixel_middle(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """The screen position that an event in the pixel of `at` tells."""
    return np.floor(at) + 0.5
