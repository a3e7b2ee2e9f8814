"""Point clouds of the views, read on first use."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.view_options import CloudSource
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from annotator.app.tasks import Task
    from std_toolkit.scene import Scene

# Number of points that software rendering draws in a fraction of a second, and during motion.
MOST_POINTS = 200_000
LIGHT_POINTS = 20_000
# Largest number of fused frames: more take longer but add hardly any surface.
MOST_FRAMES = 30
_KEPT_FRAMES = 6


@dataclass(frozen=True, eq=False)
class Cloud:
    """Point cloud in random order, so that the first N points are a subsample.

    Attributes:
        points: (N, 3) float32 metres, in the world or in the camera of the frame.
        colors: (N, 3) uint8 RGB.
        in_world: whether the points are in the world frame.
        spacing_m: approximate distance of neighbouring points.
        note: sentence on what is shown, or on why nothing is.
    """

    points: NDArray[np.float32]
    colors: NDArray[np.uint8]
    in_world: bool
    spacing_m: float = 0.0
    note: str = ""


class CloudReader:
    """Point clouds of a scene: single frames are read directly, the fused cloud in the background.

    If their source data change during the session, such as the scale of the camera poses, the
    clouds are read again.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._frames: OrderedDict[int, Cloud] = OrderedDict()
        self._fused: Cloud | None = None
        self._sparse: Cloud | None = None
        # Token of the fusion in progress and its error message, for the current scene, or None.
        self._fusing: object | None = None
        self._problem: str | None = None
        session = controller.session
        self._made_of = session.scene.info, session.scene.frame_table, session.cameras

    def get(self, frame: int, source: CloudSource) -> Cloud:
        """Return the cloud to show; a note instead of points while it is being computed."""
        self._notice_changes()
        if source is CloudSource.FUSED and self._controller.session.posed:
            if self._problem is not None:
                return _only(f"{self._problem}\nPress U for the points of this frame.")
            return self._fused or _only("Fusing the points of many frames ...")
        if frame not in self._frames:
            self._frames[frame] = self._read(frame)
            while len(self._frames) > _KEPT_FRAMES:
                self._frames.popitem(last=False)
        self._frames.move_to_end(frame)
        return self._frames[frame]

    def prepare(self, source: CloudSource) -> None:
        """Start the fusion if the fused cloud is requested and not available.

        A failed fusion is tried again when the cloud is deselected and requested again.
        """
        self._notice_changes()
        controller = self._controller
        if source is not CloudSource.FUSED or not controller.session.posed:
            self._problem = None
            return
        if self._fused is not None or self._fusing is not None or self._problem is not None:
            return
        mine = self._fusing = object()
        # A separate scene: saving reloads the documents of the session's scene.
        scene = controller.session.snapshot().scene

        def work(task: Task) -> Cloud | str:
            try:
                return _fuse(scene, task)
            except ToolkitError as error:
                return str(error)
            except Exception as error:  # such as out of memory; reported, and can be tried again
                return f"The points cannot be fused: {type(error).__name__}: {error}"

        def ended(found: Cloud | str) -> None:
            if self._fusing is not mine:
                return  # the scene has changed since
            self._fusing = None
            if isinstance(found, Cloud):
                self._fused = found
            else:
                self._problem = found
                controller.tell(found, "warning")
            controller.emit(Event("view"))

        controller.start_aside("Point cloud of many frames", work, ended)

    def clear(self) -> None:
        """Remove all clouds and cancel the fusion."""
        self._frames.clear()
        self._fused = self._sparse = self._fusing = self._problem = None

    def _notice_changes(self) -> None:
        """Remove clouds if their source documents have changed; labels and meshes do not matter."""
        session = self._controller.session
        made_of = session.scene.info, session.scene.frame_table, session.cameras
        if all(a is b for a, b in zip(made_of, self._made_of, strict=True)):
            return
        (*documents, cameras), (*earlier, before) = made_of, self._made_of
        self._made_of = made_of
        # Saving reloads the documents as new objects that are mostly equal.
        if documents != earlier or cameras is not before:
            self.clear()

    def _read(self, frame_id: int) -> Cloud:
        from std_toolkit.rendering.point_cloud import frame_cloud

        scene = self._controller.session.scene
        frame = scene.frame(frame_id)
        if frame.depth is None:
            return self._instead(
                "This frame has no sensor depth, so there is no point cloud of it."
            )
        camera = scene.camera(frame)
        stride = max(1, int(np.sqrt(camera.width * camera.height / MOST_POINTS)))
        try:
            points, colors = frame_cloud(scene, frame, stride=stride)
        except ToolkitError as error:
            return _only(str(error))
        if len(points) == 0:
            return self._instead("This frame has no valid depth.")
        spacing = stride * float(np.median(points[:, 2])) / camera.fx
        return _shuffled(points, colors, in_world=False, spacing_m=spacing)

    def _instead(self, reason: str) -> Cloud:
        """Return the points of the reconstruction, for frames without depth."""
        from std_toolkit.rendering.point_cloud import sparse_points

        if self._sparse is None and self._controller.session.posed:
            found = sparse_points(self._controller.session.scene)
            if found is not None:
                note = f"{reason}\nShown are the points of the reconstruction."
                points = found[0].astype(np.float32)
                self._sparse = _shuffled(points, found[1], in_world=True, note=note)
        if self._sparse is not None:
            return self._sparse
        return _only(f"{reason}\nPress Tab for the image.")


def _fuse(scene: Scene, task: Task) -> Cloud:
    from std_toolkit.rendering.point_cloud import fuse_clouds

    frames = scene.registered_frames()
    every = max(1, -(-len(frames) // MOST_FRAMES))
    fused = fuse_clouds(
        scene,
        frames[::every],
        limit=MOST_POINTS,
        progress=task.progress,
        cancel=lambda: task.cancelled,
    )
    return _shuffled(fused.points, fused.colors, in_world=True, spacing_m=fused.voxel_m)


def _shuffled(
    points: NDArray[np.float32],
    colors: NDArray[np.uint8],
    *,
    in_world: bool,
    spacing_m: float = 0.0,
    note: str = "",
) -> Cloud:
    order = np.random.default_rng(0).permutation(len(points))[:MOST_POINTS]
    spacing_m *= float(np.sqrt(len(points) / max(len(order), 1)))
    return Cloud(points[order], colors[order], in_world, spacing_m, note)


def _only(note: str) -> Cloud:
    return Cloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), False, note=note)
