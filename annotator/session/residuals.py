"""Residuals of object poses against image edges and, on diffuse materials, sensor depth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import LabelCaster, trace_contour
from std_toolkit.checks.measure.edges import edge_distance, noise_level, read_profiles, smooth_image
from std_toolkit.checks.measure.sensor_depth import depth_residual
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.scene.model import DIFFUSE_MATERIALS

# Search radius for edges around the rendered contour.
REACH_PX = 12.0


@dataclass(frozen=True)
class FrameResidual:
    """Residuals of one object in one frame.

    Attributes:
        frame: frame id.
        visible_px: number of visible pixels of the object.
        edge_px: median distance from its contour to the nearest image edge; None if none is near.
        edge_chance_px: chance level: the value for a contour at a random position nearby. An
            `edge_px` that is not clearly smaller is not informative.
        edge_support: fraction of the contour with an edge nearby.
        depth_mm: median of rendered minus sensor depth; None if the sensor is not trusted or
            returned no depth.
        problem: reason why the frame could not be measured, or "".
    """

    frame: int
    visible_px: int = 0
    edge_px: float | None = None
    edge_chance_px: float | None = None
    edge_support: float = 0.0
    depth_mm: float | None = None
    problem: str = ""


def measure_residuals(
    scene: Scene,
    poses: Mapping[int, Callable[[int], SE3 | None]],
    materials: Mapping[int, str],
    meshes: Mapping[int, object],
    frames: Sequence[int],
    *,
    cancelled: Callable[[], bool] = lambda: False,
) -> dict[int, list[FrameResidual]]:
    """Measure residuals of objects in several frames, with occlusion by other objects.

    Several objects take little longer than one, because images are read once.

    Args:
        poses: object id to T_cam_obj by frame id; None without a pose.
        materials: by the ids of the objects to measure; depth is compared on "raw" and "diffuse"
            ones only.
        meshes: object id to mesh, metres.
        frames: ids; frames in which an object has no pose are skipped.
        cancelled: polled repeatedly; True returns the residuals measured so far.

    Returns:
        By object id.
    """
    rows: dict[int, list[FrameResidual]] = {i: [] for i in materials}
    for frame in frames:
        placed = {i: T for i, pose in poses.items() if (T := pose(frame)) is not None}
        wanted = [i for i in materials if i in placed]
        view = _View(scene, frame, placed, meshes) if wanted else None
        for i in wanted:
            if cancelled():
                return rows
            assert view is not None
            try:
                rows[i].append(view.measure(i, materials[i]))
            except ToolkitError as error:
                rows[i].append(FrameResidual(frame, problem=str(error)))
    return rows


class _View:
    """One frame with its placed objects; images are read on first use."""

    def __init__(
        self,
        scene: Scene,
        frame_id: int,
        placed: Mapping[int, SE3],
        meshes: Mapping[int, object],
    ) -> None:
        self._scene, self._frame = scene, scene.frame(frame_id)
        self._caster = LabelCaster(
            {
                i: (T @ np.asarray(meshes[i].vertices), np.asarray(meshes[i].faces))  # type: ignore[attr-defined]
                for i, T in placed.items()
            }
        )

    @cached_property
    def _image(self) -> tuple[NDArray[np.floating], float]:
        """Return the image for edge detection, and its noise."""
        image = self._scene.read_color(self._frame)
        return smooth_image(image), noise_level(image)

    @cached_property
    def _depth(self) -> NDArray[np.float32] | None:
        return self._scene.read_depth(self._frame)

    def measure(self, object_id: int, material: str) -> FrameResidual:
        """Measure an object; raises ToolkitError for an unreadable image."""
        frame_id, caster = self._frame.id, self._caster
        camera, eye = self._scene.camera(self._frame), SE3.identity()
        window = caster.window(object_id, camera, eye)
        if window is None:
            return FrameResidual(frame_id, problem="out of view")
        x0, y0, x1, y1 = window
        v, u = np.mgrid[y0:y1, x0:x1]
        hits = caster.cast(camera, eye, np.stack([u, v], axis=-1).astype(np.float64))
        mask = hits.object_id == object_id
        visible = int(mask.sum())
        contour = trace_contour(caster, camera, eye, object_id, mask, origin=(x0, y0))
        if visible == 0 or contour is None:
            return FrameResidual(frame_id, visible, problem="hidden")
        smooth, noise = self._image
        profiles = read_profiles(smooth, contour, reach_px=REACH_PX, noise=noise)
        edges = edge_distance(profiles) if profiles is not None else None
        depth_mm = None
        if material in DIFFUSE_MATERIALS and self._depth is not None:
            found = depth_residual(hits.depth, self._depth[y0:y1, x0:x1], mask)
            depth_mm = None if found is None else 1000 * found.median_m
        return FrameResidual(
            frame_id,
            visible,
            edges.median_px if edges else None,
            edges.chance_px if edges else None,
            edges.support if edges else 0.0,
            depth_mm,
        )
