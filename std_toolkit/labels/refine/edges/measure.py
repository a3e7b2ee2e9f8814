"""Measurements in the images at the current poses: edges around contours, depth on surfaces."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.labels.refine.caster import LayerStore, WorldCaster, cast_patch
from std_toolkit.labels.refine.edges import system
from std_toolkit.labels.refine.edges.contour import contour_image, trace_contour
from std_toolkit.labels.refine.edges.evidence import colour_odds, measure_edges
from std_toolkit.labels.refine.problem import RefineObject, RefineOptions, RefineView


@dataclass(frozen=True, kw_only=True)
class Level:
    """One stage of coarse to fine.

    Attributes:
        scale: image scale.
        reach: pixels of that image searched to both sides of a contour.
        spread: expected distance of the edge, pixels of that image.
        gate_m: sensor depth further than this from the model is ignored.
        region: weight of the colour statistics on diffuse objects.
        region_glossy: the same on glass and metal, which show the colours of their surroundings.
        along: Gaussian sigma of the averaging along the contour, pixels.
        iterations: largest number of Gauss-Newton steps.
    """

    scale: float
    reach: int
    spread: float
    gate_m: float
    region: float
    region_glossy: float
    along: float
    iterations: int


def coarse_to_fine(views: Sequence[RefineView], options: RefineOptions) -> list[Level]:
    """The stages for `search_px`, coarsest first."""
    n = options.iterations
    widest = max(v.camera.width for v in views)
    base = min(1.0, options.largest_image / widest)
    stages = [
        Level(scale=base, reach=6, spread=2.0, gate_m=0.012, region=0.25, region_glossy=0.0,
              along=3.0, iterations=n + 4),
        Level(scale=base, reach=8, spread=3.0, gate_m=0.02, region=0.75, region_glossy=0.0,
              along=3.0, iterations=n),
    ]  # fmt: skip
    scale, gate = base / 2, 0.03
    while scale * widest > 100:
        stages.append(
            Level(scale=scale, reach=10, spread=5.0, gate_m=gate, region=1.0, region_glossy=0.5,
                  along=2.0, iterations=n)
        )  # fmt: skip
        if 10 / scale >= options.search_px * (1 - 1e-9):
            break
        scale, gate = scale / 2, 0.06
    return stages[::-1]


@dataclass
class PoseState:
    """The unknowns.

    Attributes:
        poses: T_world_obj of each object, metres.
        log_scale: logarithm of the factor on all camera positions.
        depth_factor: true depth = depth_factor * sensor depth.
    """

    poses: list[SE3]
    log_scale: float = 0.0
    depth_factor: float = 1.0

    def copy(self) -> PoseState:
        """The same unknowns, independent of later steps."""
        return PoseState(list(self.poses), self.log_scale, self.depth_factor)

    def in_scale_of(self, other: PoseState) -> PoseState:
        """The same poses where the world has the scale of another state."""
        factor = float(np.exp(other.log_scale - self.log_scale))
        poses = [SE3(T.R, factor * T.t) for T in self.poses]
        return PoseState(poses, other.log_scale, self.depth_factor)

    def set(self, other: PoseState) -> None:
        """Take over the unknowns of another state."""
        self.poses[:] = other.poses
        self.log_scale, self.depth_factor = other.log_scale, other.depth_factor

    def camera_pose(self, view: RefineView) -> SE3:
        """T_world_cam in the current scale."""
        T = view.T_world_cam
        return SE3(T.R, T.t * np.exp(self.log_scale))


@dataclass(frozen=True, eq=False)
class Measurements:
    """Residuals with their derivatives, by object index, one entry per view that shows it."""

    contours: list[tuple[int, system.ContourRows]]
    depths: list[tuple[int, system.DepthRows]]
    textures: list[tuple[int, system.TextureRows]] = field(default_factory=list)

    def after(self, steps: Mapping[int, system.Step]) -> Measurements:
        """The residuals of the objects after these steps, by index, to first order."""
        return Measurements(
            [(k, rows.after(steps[k])) for k, rows in self.contours if k in steps],
            [(k, rows.after(steps[k])) for k, rows in self.depths if k in steps],
            [(k, rows.after(steps[k])) for k, rows in self.textures if k in steps],
        )

    def __add__(self, other: Measurements) -> Measurements:
        return Measurements(
            self.contours + other.contours,
            self.depths + other.depths,
            self.textures + other.textures,
        )


def measure(
    views: Sequence[RefineView],
    scaled: Sequence[tuple[Camera, NDArray[np.uint8]]],
    objects: Sequence[RefineObject],
    state: PoseState,
    level: Level,
    *,
    use_depth: bool,
    layers: LayerStore | None = None,
    chosen: Collection[int] | None = None,
) -> Measurements:
    """Render all objects together in every view and compare with the images.

    Args:
        scaled: camera and image of every view at the level's scale.
        layers: layers kept between steps; only objects that moved are rendered again.
        chosen: indices of the objects to compare; default: all that are not fixed.
    """
    caster = WorldCaster(objects, state.poses, layers)
    found = Measurements([], [])
    for number, (view, (camera, image)) in enumerate(zip(views, scaled, strict=True)):
        T_world_cam = state.camera_pose(view)
        sensor = _sensor(view, camera, state) if use_depth else None
        for i, obj in enumerate(objects):
            if obj.fixed or (chosen is not None and i not in chosen):
                continue
            patch = cast_patch(
                caster, obj, state.poses[i], camera, T_world_cam, margin=level.reach + 8
            )
            if patch is None:
                continue
            contour = trace_contour(caster, patch, i, camera, T_world_cam)
            if contour is not None:
                edges = measure_edges(
                    image,
                    patch,
                    contour,
                    colour_odds(image, patch, i, margin=level.reach + 4),
                    reach=level.reach,
                    along=level.along,
                    spread=level.spread,
                    region_weight=level.region if obj.trusts_depth else level.region_glossy,
                    crease_weight=0.4 if obj.trusts_depth else 1.0,
                    taken=contour_image(patch),
                )
                rows = system.contour_rows(
                    contour.points,
                    contour.normals,
                    edges.offset,
                    edges.weight * contour.thinning,
                    camera,
                    T_world_cam,
                    state.poses[i],
                    view=number,
                    spacing=contour.thinning,
                )
                found.contours.append((i, rows))
            if sensor is not None and obj.trusts_depth:
                samples = system.sample_depth(
                    patch, i, sensor, camera, T_world_cam, gate_m=level.gate_m
                )
                if samples is not None:
                    rows_here = system.depth_rows(samples, T_world_cam, state.poses[i], view=number)
                    found.depths.append((i, rows_here))
    return found


def _sensor(view: RefineView, camera: Camera, state: PoseState) -> NDArray[np.float32] | None:
    """Sensor depth at the level's size, with the current factor applied."""
    if view.depth is None:
        return None
    depth = view.depth
    if camera.size != view.camera.size:
        depth = np.asarray(
            cv2.resize(depth, camera.size, interpolation=cv2.INTER_NEAREST), dtype=np.float32
        )
    return depth * np.float32(state.depth_factor)
