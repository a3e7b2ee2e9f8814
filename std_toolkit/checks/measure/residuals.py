"""Measurement of the labels in one frame, as one job item."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.array_file import ArrayFile
from std_toolkit.checks.measure.contours import NOTHING, Contour, LabelCaster, trace_contour
from std_toolkit.checks.measure.depth_motion import DepthEquations, depth_equations
from std_toolkit.checks.measure.edges import (
    EdgeDistance,
    Shift,
    best_shift,
    edge_distance,
    noise_level,
    read_profiles,
    shift_jacobian,
    smooth_image,
)
from std_toolkit.checks.measure.motion import FiledEquations, MotionEquations, motion_equations
from std_toolkit.checks.measure.sensor_depth import (
    DepthResidual,
    DepthShift,
    ErrorTally,
    FiledTally,
    depth_residual,
    depth_shift,
)
from std_toolkit.geometry import SE3, Camera
from std_toolkit.options import CheckOptions
from std_toolkit.rendering import ground_truth
from std_toolkit.rendering.placements import truth_is_current
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import DIFFUSE_MATERIALS


@dataclass(frozen=True, eq=False, slots=True)
class ObjectObservation:
    """One object in one frame.

    Attributes:
        visible_px, silhouette_px: visible pixels, and pixels in the image without occlusion.
        visible_fraction: from the ground truth if present, otherwise the ratio of these two.
        edges, shift, residual: None if the frame does not determine them.
        depth_shift: shift of sensor depth against the image; None if undetermined.
        jacobian: (2, 3) px per metre in the world of the object's centre.
        metres_per_px: size of a pixel at the object.
        motion: equations of the residual motion in six degrees of freedom.
        surface: the same by sensor depth; None without.
        T_world_obj: the label that was measured.
    """

    visible_px: int
    silhouette_px: int
    visible_fraction: float
    edges: EdgeDistance | None = None
    shift: Shift | None = None
    residual: DepthResidual | None = None
    jacobian: NDArray[np.float64] | None = None
    metres_per_px: float | None = None
    depth_shift: DepthShift | None = None
    motion: MotionEquations | FiledEquations | None = None
    surface: DepthEquations | None = None
    T_world_obj: SE3 | None = None


@dataclass(eq=False, slots=True)
class FrameObservation:
    """One frame.

    Attributes:
        frame: frame id.
        objects: objects in view, by object id.
        tallies: raw depth against ground truth, by object id.
        has_depth: the frame has sensor depth.
        truth: "current" ground truth was used, "stale" is older than the labels, or "none".
        depth_valid: fraction of pixels with sensor depth.
    """

    frame: int
    objects: dict[int, ObjectObservation] = field(default_factory=dict)
    tallies: dict[int, ErrorTally | FiledTally] = field(default_factory=dict)
    has_depth: bool = False
    truth: str = "none"
    depth_valid: float | None = None

    def filed(self, file: ArrayFile) -> FrameObservation:
        """The frame with its arrays moved into a file; some numbers per object stay in memory.

        Raises:
            ToolkitError: the disk is full.
        """
        objects = {
            i: replace(
                o,
                motion=o.motion and o.motion.load().filed(file),
                surface=o.surface and o.surface.filed(file),
            )
            for i, o in self.objects.items()
        }
        tallies: dict[int, ErrorTally | FiledTally] = {
            i: t.load().filed(file) for i, t in self.tallies.items()
        }
        return replace(self, objects=objects, tallies=tallies)


@dataclass(frozen=True, eq=False)
class LabelledView:
    """A frame with its labels ray-cast, the input of measuring and drawing.

    Attributes:
        object_id: (H, W) nearest labelled object.
        depth: (H, W) its z-depth, metres.
        truth: current ground truth, if any.
        truth_state: see `FrameObservation.truth`.
    """

    frame: Frame
    camera: Camera
    T_world_cam: SE3
    caster: LabelCaster
    object_id: NDArray[np.int32]
    depth: NDArray[np.float32]
    truth: ground_truth.GroundTruth | None
    truth_state: str

    def mask(self, object_id: int) -> NDArray[np.bool_]:
        """(H, W) pixels that show the object."""
        return self.object_id == object_id

    @property
    def hides(self) -> bool:
        """Whether the ground truth contains occluders without a label.

        Policy "sensor" does not count: it hides every part of a label behind the measured
        surface, and a wrong label would have no residual.
        """
        return self.truth is not None and self.truth.info.policy != "sensor"

    def contour(self, object_id: int) -> Contour | None:
        """The visible outline of an object."""
        window = self.caster.window(object_id, self.camera, self.T_world_cam)
        if window is None:
            return None
        x0, y0, x1, y1 = window
        part = np.s_[y0:y1, x0:x1]
        shown = self.truth.mask[part] == object_id if self.truth and self.hides else None
        return trace_contour(
            self.caster,
            self.camera,
            self.T_world_cam,
            object_id,
            self.mask(object_id)[part],
            origin=(x0, y0),
            shown=shown,
        )


@lru_cache(maxsize=2)
def open_for_work(root: Path, fingerprint: str) -> tuple[Scene, LabelCaster]:
    """The scene and its caster, created once per worker process.

    Args:
        root: scene folder.
        fingerprint: digest of the documents; a changed scene is opened again.
    """
    del fingerprint
    scene = Scene.open(root)
    return scene, LabelCaster.of_scene(scene)


def render_view(scene: Scene, caster: LabelCaster, frame: Frame) -> LabelledView:
    """Ray-cast the labels into a registered frame.

    Raises:
        ToolkitError: damaged ground truth.
    """
    camera = scene.camera(frame)
    T_world_cam = scene.T_world_cam(frame.id)
    assert T_world_cam is not None, "only registered frames can be checked"
    ids = np.zeros((camera.height, camera.width), np.int32)
    depth = np.zeros((camera.height, camera.width), np.float32)
    within = caster.possible(camera, T_world_cam)
    if within.any():
        hits = caster.cast_pixels(camera, T_world_cam, within)
        ids[within] = hits.object_id
        depth[within] = hits.depth
    truth = None
    state = "none"
    if ground_truth.info_path(scene.root, frame.id).is_file():
        truth = ground_truth.read_ground_truth(scene, frame.id)
        state = "current" if truth_is_current(scene, truth.info) else "stale"
    return LabelledView(
        frame,
        camera,
        T_world_cam,
        caster,
        ids,
        depth,
        truth if state == "current" else None,
        state,
    )


def observe_frame(
    frame_id: int, *, root: Path, fingerprint: str, options: CheckOptions
) -> FrameObservation:
    """Measure all labels of one frame.

    Args:
        frame_id: id of a registered frame.
        root, fingerprint: see `open_for_work`.
        options: search ranges.

    Raises:
        ToolkitError: a file of the frame is missing or damaged.
    """
    scene, caster = open_for_work(root, fingerprint)
    return measure_frame(scene, caster, scene.frame(frame_id), options)


def measure_frame(
    scene: Scene,
    caster: LabelCaster,
    frame: Frame,
    options: CheckOptions,
    *,
    only: Collection[int] | None = None,
) -> FrameObservation:
    """Measure the labels of one frame.

    Args:
        scene: the scene, possibly with changes that are not on disk.
        caster: its labelled objects.
        frame: a registered frame.
        options: search ranges.
        only: ids of the objects to measure; None measures all.

    Raises:
        ToolkitError: a file of the frame is missing or damaged.
    """
    view = render_view(scene, caster, frame)
    image = scene.read_color(frame)
    smoothed, noise = smooth_image(image), noise_level(image)
    sensor = scene.read_depth(frame)
    result = FrameObservation(frame.id, truth=view.truth_state, has_depth=sensor is not None)
    if sensor is not None:
        result.depth_valid = float((sensor > 0).mean())
    measured = [i for i in caster.object_ids if only is None or i in only]
    for object_id in measured:
        seen = _observe_object(scene, view, object_id, smoothed, noise, sensor, options)
        if seen is not None:
            result.objects[object_id] = seen
    if sensor is not None:
        truth_mask = view.truth.mask if view.truth else view.object_id
        truth_depth = view.truth.depth if view.truth else view.depth
        for object_id in measured:
            inside = (truth_mask == object_id) & (truth_depth > 0)
            if inside.any():
                tally = ErrorTally()
                tally.add(sensor[inside], truth_depth[inside])
                result.tallies[object_id] = tally
    return result


def _observe_object(
    scene: Scene,
    view: LabelledView,
    object_id: int,
    smoothed: NDArray[np.float32],
    noise: float,
    sensor: NDArray[np.float32] | None,
    options: CheckOptions,
) -> ObjectObservation | None:
    window = view.caster.window(object_id, view.camera, view.T_world_cam)
    if window is None:
        return None
    mask = view.mask(object_id)
    visible_px = int(mask.sum())
    silhouette_px = visible_px + _hidden_px(view, object_id, window)
    if silhouette_px == 0:
        return None
    fraction = visible_px / silhouette_px
    if view.truth is not None:
        rows = {row.object: row for row in view.truth.info.objects}
        if object_id in rows:
            fraction = rows[object_id].visible_fraction
    contour = view.contour(object_id)
    if contour is None:
        return ObjectObservation(visible_px, silhouette_px, fraction)
    profiles = read_profiles(smoothed, contour, reach_px=options.search_px, noise=noise)
    edges = edge_distance(profiles) if profiles else None
    shift = best_shift(profiles, largest_px=options.shift_px) if profiles else None
    centre = view.caster.corners[object_id].mean(axis=0)
    residual = displaced = surface = None
    if sensor is not None and scene.objects.object(object_id).material in DIFFUSE_MATERIALS:
        trusted = mask & (view.truth.mask == object_id) if view.truth and view.hides else mask
        residual = depth_residual(view.depth, sensor, trusted)
        displaced = depth_shift(contour, view.depth, sensor)
        surface = depth_equations(
            view.depth, sensor, trusted, view.camera, view.T_world_cam, centre
        )
    jacobian, z = shift_jacobian(view.camera, view.T_world_cam, centre)
    return ObjectObservation(
        visible_px,
        silhouette_px,
        fraction,
        edges,
        shift,
        residual,
        jacobian,
        2 * z / (view.camera.fx + view.camera.fy),
        displaced,
        motion_equations(contour, profiles, view.camera, view.T_world_cam, centre)
        if profiles
        else None,
        surface,
        scene.T_world_obj(object_id),
    )


def _hidden_px(view: LabelledView, object_id: int, window: tuple[int, int, int, int]) -> int:
    """Number of pixels of an object behind other labelled objects."""
    x0, y0, x1, y1 = window
    nearest = view.object_id[y0:y1, x0:x1]
    behind = (nearest != NOTHING) & (nearest != object_id)
    if behind.any():
        behind &= view.caster.within(object_id, view.camera, view.T_world_cam, window)
    if not behind.any():
        return 0
    hits = view.caster.cast_pixels(
        view.camera, view.T_world_cam, behind, origin=(x0, y0), only=object_id
    )
    return int((hits.object_id != NOTHING).sum())
