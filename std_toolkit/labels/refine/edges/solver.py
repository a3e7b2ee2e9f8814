"""Joint refinement of object poses over several views: coarse to fine Gauss-Newton.

Every iteration renders all objects together at their poses, measures where the edges around each
visible contour are, compares sensor depth with the visible surface of diffuse objects, and solves
for all poses, one factor on sensor depth and (optionally) one scale of the camera positions. The
depth factor is a nuisance parameter: a sensor with a bias of 1-2 % has it on every object, and
without the factor the labels would move by as much. Rough starts need a search first (`approach`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.directions import weakest_direction
from std_toolkit.labels.refine.edges.approach import approach
from std_toolkit.labels.refine.edges.descent import Descent, assemble, descend, weigh
from std_toolkit.labels.refine.edges.measure import Level, PoseState, coarse_to_fine
from std_toolkit.labels.refine.edges.restarts import end_elsewhere
from std_toolkit.labels.refine.edges.texture_following import follow_textures
from std_toolkit.labels.refine.edges.uncertainty import pose_covariances
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Distance of the edges after a search; at lower resolutions glass and metal would diverge again.
# Objects that are not rough are as near.
_APPROACHED_PX = 20.0
# Fraction of the time after which the last level is repeated from other starts.
_RESTARTED = 0.9
# Time of the search for an object, in units of its edge refinement.
_SEARCH = 3.0


@dataclass(frozen=True, kw_only=True)
class ConvergenceSettings(Settings):
    """When a joint refinement has converged."""

    last_step_mm: float = limit(0.5, unit="mm", source=NOT_RECORDED)
    """largest last step at the surface"""


def refine_poses(
    views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    options: problem.RefineOptions | None = None,
    *,
    texture_views: Sequence[problem.RefineView] = (),
    layers: LayerStore | None = None,
    progress: problem.Progress = problem.no_progress,
) -> problem.RefineResult:
    """Refine the world poses of objects jointly with the images.

    Args:
        views: images with metric camera poses; three or more from different sides determine
            objects without depth, one determines the distance to the camera weakly.
        objects: all labelled objects of the scene, so that occlusions between them are known.
        texture_views: more views, in which only textures are matched, because that is cheap.
        layers: cached layers of the objects in these views, if any.
        progress: called with the completed fraction.

    Returns:
        Poses, covariances and the other estimated parameters, in the order of `objects`.

    Raises:
        ToolkitError: no views or objects, or no object is visible in any view.
    """
    options = options or problem.RefineOptions()
    if not views or not objects:
        raise ToolkitError("a refinement needs at least one view and one object")
    layers = LayerStore() if layers is None else layers
    rough = [o for o in objects if o.rough and not o.fixed] if len(views) > 1 else []
    near = sum(not o.fixed for o in objects) - len(rough)
    searched = _SEARCH * len(rough) / max((_SEARCH + 1) * len(rough) + near, 1)
    if rough:
        objects = approach(
            views,
            objects,
            options,
            layers=layers,
            progress=problem.sub_progress(progress, 0, searched),
        )
        options = replace(options, search_px=min(options.search_px, _APPROACHED_PX))
    textured = options.use_textures and any(o.texture is not None and not o.fixed for o in objects)
    ended = searched + (1 - searched) * _RESTARTED
    contours_done = searched + (ended - searched) * (0.6 if textured else 1.0)
    state = PoseState([o.T_world_obj for o in objects])
    levels = coarse_to_fine(views, options)
    descent = descend(
        views,
        objects,
        state,
        levels,
        options,
        layers=layers,
        progress=problem.sub_progress(progress, searched, contours_done),
    )
    if textured:
        descent = follow_textures(
            views,
            texture_views,
            objects,
            state,
            descent,
            levels[-1],
            options,
            layers=layers,
            progress=problem.sub_progress(progress, contours_done, ended),
        )
    return _result(
        views,
        texture_views,
        objects,
        state,
        descent,
        levels[-1],
        options,
        layers=layers,
        progress=problem.sub_progress(progress, ended, 1),
    )


def _result(
    views: Sequence[problem.RefineView],
    texture_views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    descent: Descent,
    level: Level,
    options: problem.RefineOptions,
    *,
    layers: LayerStore,
    progress: problem.Progress,
) -> problem.RefineResult:
    limits = ConvergenceSettings.current()
    measured, scale = descent.measured, descent.scale
    zero = np.zeros(6 * len(objects) + 2)
    system, edge_std, depth_std = assemble(objects, state, measured, scale, options, zero)
    covariance = system.covariance([o.radius for o in objects])
    rows, _, _ = weigh(len(objects), measured, scale, options, zero)
    noise = [covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(len(objects))]
    # Matches of a texture do not depend on the start.
    followed = {i for i, _ in measured.textures}
    ends = end_elsewhere(
        views,
        [replace(o, fixed=o.fixed or i in followed) for i, o in enumerate(objects)],
        state,
        noise,
        level,
        options,
        layers=layers,
        progress=progress,
    )
    every = [*views, *texture_views]
    blocks = pose_covariances(system, rows, every, state.poses, objects, ends, scale=scale)
    refined = []
    for i, obj in enumerate(objects):
        block = blocks[i]
        seen = sum(1 for k, rows in measured.contours if k == i and len(rows.residual) >= 8)
        refined.append(
            problem.RefinedObject(
                obj.name,
                state.poses[i],
                block,
                weakest_direction(
                    block,
                    obj.centre,
                    obj.radius,
                    obj.symmetry,
                    T_world_obj=state.poses[i],
                    views=every,
                ),
                edge_std.get(i, float("nan")) / scale,
                depth_std.get(i),
                seen,
                seen > 0 and descent.step_mm < limits.last_step_mm,
                covariance[6 * i : 6 * i + 6, system.SCALE] / covariance[system.SCALE, system.SCALE]
                if options.refine_scale
                else np.zeros(6),
                descent.beside.get(i),
            )
        )
    scale_std = float(np.sqrt(covariance[system.SCALE, system.SCALE]))
    settled = descent.step_mm < limits.last_step_mm and descent.scale_step < scale_std
    factor_std = float(np.sqrt(covariance[system.FACTOR, system.FACTOR]))
    return problem.RefineResult(
        tuple(refined),
        float(np.exp(state.log_scale)) if options.refine_scale else 1.0,
        scale_std if options.refine_scale else 0.0,
        state.depth_factor if measured.depths else 1.0,
        factor_std if measured.depths else 0.0,
        settled or not options.refine_scale,
    )
