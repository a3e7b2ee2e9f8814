"""How well an object's pose agrees with what the frames show: edges and, where trusted, depth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from std_toolkit.checks.caster import LabelCaster
from std_toolkit.checks.contours import trace_contour
from std_toolkit.checks.depth import depth_residual
from std_toolkit.checks.edges import edge_distance, noise_level, read_profiles, smooth_image
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene
from std_toolkit.scene.model import DIFFUSE_MATERIALS

# How far from the drawn contour an edge is looked for.
REACH_PX = 12.0


@dataclass(frozen=True)
class FrameResidual:
    """One object in one frame.

    Attributes:
        frame: frame id.
        visible_px: pixels of the object that are seen.
        edge_px: median distance from its contour to the nearest image edge; None if none is near.
        edge_chance_px: what a contour at a random place nearby would have: an `edge_px` that is
            not clearly smaller says nothing.
        edge_support: share of the contour that meets an edge at all.
        depth_mm: median of rendered minus sensor depth; None where the sensor is not trusted or
            saw nothing.
        problem: why the frame could not be measured, or "".
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
    object_id: int,
    material: str,
    meshes: Mapping[int, object],
    frames: Sequence[int],
) -> list[FrameResidual]:
    """Residuals of one object in several frames, its neighbours hiding what they hide.

    Args:
        poses: object id to T_cam_obj by frame id; None where it has none.
        object_id: the object to measure.
        material: depth is compared on "raw" and "diffuse" objects only.
        meshes: object id to mesh, metres.
        frames: ids; those in which the object has no pose are left out.
    """
    rows = []
    for frame in frames:
        placed = {i: T for i, pose in poses.items() if (T := pose(frame)) is not None}
        if object_id in placed:
            try:
                rows.append(_measure(scene, placed, object_id, material, meshes, frame))
            except ToolkitError as error:
                rows.append(FrameResidual(frame, problem=str(error)))
    return rows


def _measure(
    scene: Scene,
    placed: Mapping[int, SE3],
    object_id: int,
    material: str,
    meshes: Mapping[int, object],
    frame_id: int,
) -> FrameResidual:
    frame = scene.frame(frame_id)
    camera, eye = scene.camera(frame), SE3.identity()
    caster = LabelCaster(
        {
            i: (T @ np.asarray(meshes[i].vertices), np.asarray(meshes[i].faces))  # type: ignore[attr-defined]
            for i, T in placed.items()
        }
    )
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
    image = scene.read_color(frame)
    profiles = read_profiles(
        smooth_image(image), contour, reach_px=REACH_PX, noise=noise_level(image)
    )
    edges = edge_distance(profiles) if profiles is not None else None
    depth_mm = None
    if material in DIFFUSE_MATERIALS and (sensor := scene.read_depth(frame)) is not None:
        found = depth_residual(hits.depth, sensor[y0:y1, x0:x1], mask)
        depth_mm = None if found is None else 1000 * found.median_m
    return FrameResidual(
        frame_id,
        visible,
        edges.median_px if edges else None,
        edges.chance_px if edges else None,
        edges.support if edges else 0.0,
        depth_mm,
    )
