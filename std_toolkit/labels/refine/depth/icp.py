"""Refinement of one object's pose on sensor depth, for opaque objects: one view or several.

A search tries many poses on the depth images to get from a rough start (50 mm, 30 degrees off)
into the right basin of convergence (`pose_search`). ICP in both directions fits the pose
(`depth_steps`). Edges of the colour images refine it laterally (`solver`), where depth is smeared
at borders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.depth import depth_steps
from std_toolkit.labels.refine.depth.observed import ObservedRays, ObservedView, observe
from std_toolkit.labels.refine.depth.pose_search import THOROUGH, SearchRange, search_pose
from std_toolkit.labels.refine.directions import weakest_direction
from std_toolkit.labels.refine.edges.solver import refine_poses
from std_toolkit.labels.refine.object_surface import ObjectSurface
from std_toolkit.scene.scale_model import SOURCE_ERRORS
from std_toolkit.settings import NOT_RECORDED, Settings, limit

Array = NDArray[np.float64]

# Largest error of a start: metres, and fraction of the object's radius.
_REACH_M, _REACH = 0.05, 0.5
_FIXED_FACTOR_STD = 0.001
# Prior of the depth factor in one view, in which edges cannot correct depth.
_DEPTH_SAMPLES = 5.0


@dataclass(frozen=True, kw_only=True)
class DepthFitSettings(Settings):
    """When a fit to sensor depth is accepted."""

    fewest_readings: int = limit(60, source=NOT_RECORDED)
    """readings on the object that a fit needs"""
    largest_finish_m: float = limit(0.03, unit="m", source=NOT_RECORDED)
    """edges that move the pose from depth farther follow another contour"""
    largest_finish: float = limit(np.deg2rad(20), unit="rad", source=NOT_RECORDED)
    """edges that turn the pose from depth by more follow another contour"""
    largest_loss: float = limit(0.1, source=NOT_RECORDED)
    """edges that lower the fraction of explained readings by more are not followed"""
    thin: float = limit(0.5, source="most starts miss a thin object")
    """an object that is thinner than this part of the reach is searched again with more starts"""
    doubtful: float = limit(0.88, source=NOT_RECORDED)
    """the same only if its pose explains a smaller fraction of the readings"""
    smallest_explained: float = limit(0.5, source=NOT_RECORDED)
    """a fit that explains a smaller fraction of the readings has not converged"""
    parallax: float = limit(np.deg2rad(15), unit="rad", source=NOT_RECORDED)
    """from views this far apart, edges determine the distance, and with it the depth factor"""


@dataclass(frozen=True, kw_only=True)
class DepthFitOptions:
    """Options of fitting an object to sensor depth.

    Attributes:
        reach_m: largest position error of the start, metres; default: 50 mm, or half the object's
            radius if that is more.
        turn: largest rotation error of the start, radians.
        flips: also try rotations about the axes of the bounding box; they are used only if depth
            or the texture of the mesh clearly supports them.
        use_edges: refine the pose with edges of the colour images.
    """

    reach_m: float | None = None
    turn: float = float(np.deg2rad(30))
    flips: bool = True
    use_edges: bool = True


@dataclass(frozen=True, eq=False)
class DepthFit:
    """Outcome of a fit to sensor depth.

    Attributes:
        name: name of the object.
        T_world_obj: fitted pose.
        covariance: (6, 6) of a right perturbation `T_world_obj @ SE3.exp(xi)`.
        weak_direction: sentence on the least determined direction.
        depth: agreement with the sensor at the end.
        edge_rms_px: robust standard deviation of the edges around the contour; None if they were
            not used.
        views: number of views with depth in which the object may be seen.
        depth_factor: true depth = depth_factor * sensor depth, estimated from views around the
            object; 1 if it was not estimated.
        converged: most readings on the visible surface agree with it.
    """

    name: str
    T_world_obj: SE3
    covariance: Array
    weak_direction: str
    depth: depth_steps.DepthAgreement
    edge_rms_px: float | None
    views: int
    depth_factor: float
    converged: bool


def refine_on_depth(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    options: DepthFitOptions | None = None,
    *,
    others: Sequence[problem.RefineObject] = (),
    layers: LayerStore | None = None,
    progress: problem.Progress = problem.no_progress,
) -> DepthFit:
    """Refine the world pose of one object with the sensor depth around it.

    Args:
        views: images with metric camera poses; a single one may have the identity. Views without
            depth contribute edges only.
        obj: the object at its start pose; its material is ignored.
        others: neighbours at fixed poses, which act as occluders.
        layers: cached layers of the neighbours, if any.
        progress: called with the completed fraction.

    Raises:
        ToolkitError: no views, the object is out of view, or there is no depth (on it).
    """
    limits = DepthFitSettings.current()
    options = options or DepthFitOptions()
    progress(0)
    searched = 0.7 if options.use_edges else 1.0
    surface = obj.surface
    reach_m = options.reach_m or max(_REACH_M, _REACH * obj.radius)
    observed = observe(views, obj, others, surface, reach_m=reach_m, layers=layers)
    _check(views, obj, observed)
    search = SearchRange(1.2 * reach_m, 1.2 * options.turn, options.flips)
    pose = search_pose(
        obj, surface, observed, search, progress=problem.sub_progress(progress, 0.1, searched)
    )
    agreement = depth_steps.measure_depth(surface, observed, pose)
    if (
        agreement.readings >= limits.fewest_readings
        and agreement.explained < limits.doubtful
        and surface.thickness < limits.thin * reach_m
    ):
        pose = search_pose(obj, surface, observed, search, effort=THOROUGH, known=[pose])
        agreement = depth_steps.measure_depth(surface, observed, pose)
    if agreement.readings < limits.fewest_readings:
        raise ToolkitError(
            f"the sensor has no depth on {obj.name}",
            hint="glass and metal have none: refine it on the edges of several frames; "
            "else move the object onto its image first",
        )
    found = replace(obj, T_world_obj=pose, material="diffuse")
    if options.use_edges:
        finished = _finish(
            views,
            found,
            surface,
            observed,
            agreement,
            others,
            progress=problem.sub_progress(progress, searched, 1),
        )
        if finished is not None:
            return finished
    rays = ObservedRays.of([o.thinned(3000) for o in observed])
    rows = depth_steps.depth_residuals(surface, rays, pose, gate_m=0.008, reverse_weight=0.0)
    covariance = depth_steps.pose_covariance(obj, rows) + _sensor_spread(views, found)
    return DepthFit(
        obj.name,
        pose,
        covariance,
        weakest_direction(
            covariance, obj.centre, obj.radius, obj.symmetry, T_world_obj=pose, views=views
        ),
        agreement,
        None,
        len(observed),
        1.0,
        agreement.explained >= limits.smallest_explained,
    )


def depth_agreement(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
    *,
    depth_factor: float = 1.0,
    layers: LayerStore | None = None,
) -> depth_steps.DepthAgreement:
    """How well the sensor depth of the views agrees with an object at its pose.

    Args:
        others: neighbours, which act as occluders.
        depth_factor: true depth = depth_factor * sensor depth.
        layers: cached layers of the neighbours, if any.
    """
    surface = obj.surface
    observed = observe(views, obj, others, surface, reach_m=0.0, background=False, layers=layers)
    return depth_steps.measure_depth(surface, observed, obj.T_world_obj, depth_factor=depth_factor)


def _check(
    views: Sequence[problem.RefineView], obj: problem.RefineObject, observed: Sequence[ObservedView]
) -> None:
    limits = DepthFitSettings.current()
    if not views:
        raise ToolkitError("a refinement needs at least one view")
    if all(v.depth is None for v in views):
        raise ToolkitError(
            "the views have no sensor depth",
            field=obj.name,
            hint="refine on the edges of several frames instead",
        )
    if not observed:
        raise ToolkitError(
            f"{obj.name} is out of view",
            hint="move the object onto its image first",
        )
    if sum(int((o.sensor > 0).sum()) for o in observed) < limits.fewest_readings:
        raise ToolkitError(
            f"there is no sensor depth around {obj.name}",
            hint="refine on the edges of several frames instead",
        )


def _finish(
    views: Sequence[problem.RefineView],
    found: problem.RefineObject,
    surface: ObjectSurface,
    observed: Sequence[ObservedView],
    before: depth_steps.DepthAgreement,
    others: Sequence[problem.RefineObject],
    *,
    progress: problem.Progress,
) -> DepthFit | None:
    """The pose refined with edges; None if they make it worse."""
    limits = DepthFitSettings.current()
    around = _apart(views, found) > DepthFitSettings.current().parallax
    if around:
        options = problem.RefineOptions(search_px=24)
    else:
        # One view cannot separate a depth bias from a wrong distance: it follows the sensor.
        options = problem.RefineOptions(
            search_px=12, depth_factor_std=_FIXED_FACTOR_STD, depth_samples=_DEPTH_SAMPLES
        )
    fixed = [replace(o, fixed=True) for o in _near(views, found, others)]
    try:
        result: problem.RefineResult = refine_poses(
            views, [found, *fixed], options, progress=progress
        )
    except ToolkitError:  # it is not visible enough
        return None
    edges = result.objects[0]
    after = depth_steps.measure_depth(
        surface, observed, edges.T_world_obj, depth_factor=result.depth_factor
    )
    if (
        edges.views == 0
        or moved_too_far(found, edges.T_world_obj)
        or after.readings < limits.fewest_readings
        or after.explained < before.explained - limits.largest_loss
    ):
        return None
    covariance, weak_direction = edges.covariance, edges.weak_direction
    if not around:
        at_end = replace(found, T_world_obj=edges.T_world_obj)
        covariance = covariance + _sensor_spread(views, at_end)
        weak_direction = weakest_direction(
            covariance,
            found.centre,
            found.radius,
            found.symmetry,
            T_world_obj=edges.T_world_obj,
            views=views,
        )
    return DepthFit(
        found.name,
        edges.T_world_obj,
        covariance,
        weak_direction,
        after,
        edges.edge_rms_px,
        len(observed),
        result.depth_factor if around else 1.0,
        after.explained >= limits.smallest_explained,
    )


def _sensor_spread(views: Sequence[problem.RefineView], obj: problem.RefineObject) -> Array:
    """(6, 6) covariance of a pose that is as far away as the sensor says."""
    centre = obj.T_world_obj @ obj.centre
    along = np.mean([centre - v.T_world_cam.t for v in views], axis=0) @ obj.T_world_obj.R
    spread = np.zeros((6, 6))
    spread[:3, :3] = SOURCE_ERRORS["depth"] ** 2 * np.outer(along, along)
    return spread


def moved_too_far(obj: problem.RefineObject, T_world_obj: SE3) -> bool:
    """Whether a pose is too far from the pose by depth to be a refinement of it."""
    limits = DepthFitSettings.current()
    step = T_world_obj @ obj.centre - obj.T_world_obj @ obj.centre
    turn = rotation_error(T_world_obj, obj.T_world_obj, obj.symmetry)
    return bool(np.linalg.norm(step) > limits.largest_finish_m or turn > limits.largest_finish)


def _apart(views: Sequence[problem.RefineView], obj: problem.RefineObject) -> float:
    """Largest angle between two views of the object, radians."""
    centre = obj.T_world_obj @ obj.centre
    rays = np.array([v.T_world_cam.t - centre for v in views])
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    return float(np.arccos(np.clip(rays @ rays.T, -1, 1)).max())


def _near(
    views: Sequence[problem.RefineView],
    obj: problem.RefineObject,
    others: Sequence[problem.RefineObject],
) -> list[problem.RefineObject]:
    """The others that may overlap the object's image in a view."""
    near = []
    for other in others:
        for view in views:
            T = view.T_world_cam.inverse()
            a, b = (T @ (o.T_world_obj @ o.centre) for o in (obj, other))
            if a[2] < 0.05 or b[2] < 0.05:
                continue
            apart = np.linalg.norm((a / a[2] - b / b[2])[:2])
            if apart < 1.2 * (obj.radius / a[2] + other.radius / b[2]) + 0.05:
                near.append(other)
                break
    return near
