"""What several views of a recording agree on, and which frames are of one view."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.evaluation.batches import chosen_frames
from benchmark.metrics.depth.figures import tolerance
from std_toolkit.arrays import Floats
from std_toolkit.geometry.camera import Camera, pixel_rays
from std_toolkit.geometry.se3 import SE3, rotation_angle
from std_toolkit.scene.model import Frame
from std_toolkit.scene.scene import Scene
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_NOTHING = np.float32(1e6)  # metres, where there is no point
# A point this many times farther than the median around it shows through.
_THROUGH = np.float32(1.02)


@dataclass(frozen=True, kw_only=True)
class BakeoffSceneSettings(Settings):
    """What counts as truth around the objects, and as another view."""

    views: int = limit(16, source=NOT_RECORDED)
    """other views that are asked what stands around the objects, evenly chosen"""
    agreeing: int = limit(3, source="two may err alike, as neighbours do")
    """views that must agree within max(3 mm, 1 %) of their median"""
    moved_deg: float = limit(
        10.0, unit="deg",
        source="differences of methods in frames 13 degrees apart correlate by 0.24 (demo's scene)",
    )  # fmt: skip
    """a camera that turned by more, or moved by as much of the depth, sees another view"""


def views_of(scene: Scene, frames: Sequence[Frame]) -> list[int]:
    """Return the number of the view of each frame, of frames in recording order.

    A view ends where the camera has turned by more than `moved_deg` since its first frame, or
    moved by as much of the median depth. Frames without camera poses are one view.

    Args:
        scene: whose poses and depth count.
        frames: some of it.
    """
    limits = BakeoffSceneSettings.current()
    least = np.deg2rad(limits.moved_deg)
    found: list[int] = []
    first: SE3 | None = None
    number, distance = 0, 1.0
    for frame in frames:
        T = scene.T_world_cam(frame.id)
        if first is None and T is not None:
            first = T
            depth = scene.read_depth(frame)
            if depth is not None and (depth > 0).any():
                distance = float(np.median(depth[depth > 0]))
        elif first is not None and T is not None:
            moved = float(np.linalg.norm(T.t - first.t)) / distance
            if max(moved, rotation_angle(first.R.T @ T.R)) > least:
                number, first = number + 1, T
        found.append(number)
    return found


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What several views of a recording measured.

    Attributes:
        points: (N, 3) metres in the frame of the world, of each view by frame id.
    """

    points: dict[int, Floats]

    @staticmethod
    def of(scene: Scene) -> "Surroundings":
        """Read some views of a scene, evenly chosen; none without camera poses.

        Raises:
            ToolkitError: a depth image cannot be read.
        """
        frames = [f for f in scene.registered_frames() if f.depth is not None]
        most = BakeoffSceneSettings.current().views
        found: dict[int, Floats] = {}
        for i in chosen_frames(len(frames), most):
            depth, T = scene.read_depth(frames[i]), scene.T_world_cam(frames[i].id)
            assert depth is not None and T is not None
            there = depth > 0
            rays = pixel_rays(scene.camera(frames[i]))[there]
            found[frames[i].id] = (T @ (rays * depth[there][:, None])).astype(np.float32)
        return Surroundings(found)

    def seen_by(self, camera: Camera, T_world_cam: SE3 | None, without: int = -1) -> Floats:
        """Depth where views agree.

        Args:
            camera: that looks.
            T_world_cam: its pose; without one nothing is known.
            without: id of a frame that is not asked, such as the one that is judged.

        Returns:
            (H, W) metres: the median of the views that see something behind a pixel, 0 where too
            few are within max(3 mm, 1 %) of it.
        """
        asked = [points for frame, points in self.points.items() if frame != without]
        fewest = BakeoffSceneSettings.current().agreeing
        if T_world_cam is None or len(asked) < fewest:
            return np.zeros((camera.height, camera.width), np.float32)
        T = T_world_cam.inverse()
        layers = np.stack([_drawn(T @ points, camera) for points in asked])
        layers.sort(axis=0)
        seen = np.isfinite(layers).sum(axis=0)
        median = np.take_along_axis(layers, np.maximum(seen - 1, 0)[None] // 2, axis=0)[0]
        median[seen == 0] = 0
        agree = (np.abs(layers - median) <= tolerance(np.where(median > 0, median, 1))).sum(axis=0)
        return np.where(agree >= fewest, median, np.float32(0))


def _drawn(points: NDArray[np.floating], camera: Camera) -> Floats:
    """The nearest of points (N, 3) in each pixel, infinite where there is none."""
    depth = np.full(camera.height * camera.width, np.inf, np.float32)
    points = points[points[:, 2] > 0]
    uv = np.rint(camera.project(points))
    inside = (uv >= 0).all(axis=1) & (uv < camera.size).all(axis=1)
    u, v = uv[inside].astype(np.intp).T
    np.minimum.at(depth, v * camera.width + u, points[inside, 2].astype(np.float32))
    layer = depth.reshape(camera.height, camera.width)
    # Between the points of a near surface, single ones of what it hides show through.
    beside = cv2.medianBlur(np.minimum(layer, _NOTHING), 3)
    layer[layer > _THROUGH * beside] = np.inf
    return layer
