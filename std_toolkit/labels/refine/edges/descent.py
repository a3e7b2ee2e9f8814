"""Gauss-Newton steps on the poses of several objects, from the coarsest level to the finest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.labels.refine import problem
from std_toolkit.labels.refine.caster import LayerStore
from std_toolkit.labels.refine.edges.measure import Level, Measurements, PoseState, measure
from std_toolkit.labels.refine.edges.system import (
    FACTOR,
    SCALE,
    NormalEquations,
    Step,
    TextureRows,
    WeightedRows,
)

Array = NDArray[np.float64]

# Neighbouring samples of a contour are correlated, as are errors of mesh, lens and light in all
# views. With one independent sample per this many pixels, the covariance agrees with the errors
# on recordings with known truth.
_CONTOUR_CORRELATION_PX = 100.0
_SMALLEST_EDGE_STD_PX = 0.25
_SMALLEST_DEPTH_STD_M = 0.001
# Matches of a texture in one view count as at most this many independent points: what is off is the
# texture on the mesh and the camera pose, alike for neighbours.
_TEXTURE_SAMPLES, _SMALLEST_TEXTURE_STD_PX, _LARGEST_TEXTURE_STD_PX = 6.0, 0.5, 1.5
# Beside a texture, the contours of all views count as those of one view.
_CONTOURS_BESIDE_TEXTURE = 1.0
# Convergence limit of a step (mm at the object's surface): less than the change by contour
# sampling from one step to the next. Coarse levels stop earlier.
_SETTLED_MM = 0.1
_SETTLED_COARSE_MM = 0.5


@dataclass(frozen=True, eq=False)
class Descent:
    """Result of the steps.

    Attributes:
        measured: measurements at the start of the last step.
        scale: image scale of the last level.
        step_mm: largest motion of an object's surface in the last step.
        scale_step: change of the log scale in the last step.
        beside: by object index, where its texture lies relative to its place on the mesh, for
            textures that contradict the contour and were not followed.
    """

    measured: Measurements
    scale: float
    step_mm: float
    scale_step: float = 0.0
    beside: Mapping[int, SE3] = field(default_factory=dict)


def descend(
    views: Sequence[problem.RefineView],
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    levels: Sequence[Level],
    options: problem.RefineOptions,
    *,
    layers: LayerStore | None = None,
    progress: problem.Progress = problem.no_progress,
) -> Descent:
    """Optimise `state` level by level until the steps are small.

    Args:
        layers: cached layers of earlier calls with the same objects and views.
        progress: called with the completed fraction.

    Raises:
        ToolkitError: no object is visible in any view.
    """
    layers = LayerStore() if layers is None else layers
    measured = made = Measurements([], [])
    largest, scale, scale_step = np.inf, 1.0, 0.0
    for number, level in enumerate(levels):
        enough = _SETTLED_MM if number == len(levels) - 1 else _SETTLED_COARSE_MM
        scale = level.scale
        scaled = [v.at_scale(scale) for v in views]
        # Motion of each object since it was last compared with the images, mm.
        moved = np.full(len(objects), np.inf)
        moved[[o.fixed for o in objects]] = 0
        for iteration in range(level.iterations):
            progress((number + iteration / level.iterations) / len(levels))
            again = np.flatnonzero(moved > enough)
            if not len(again):
                break
            measured = measured + measure(
                views,
                scaled,
                objects,
                state,
                level,
                use_depth=options.use_depth,
                layers=layers,
                chosen=again,
            )
            if not measured.contours and not measured.depths:
                raise ToolkitError(
                    "no object is visible in the views of the refinement",
                    hint="is the annotated pose of one of them far off?",
                )
            made = measured
            before = state.log_scale
            steps = advance(objects, state, measured, scale, options)
            scale_step = abs(state.log_scale - before)
            size = np.array([step_size_mm(o, s) for o, s in zip(objects, steps, strict=True)])
            moved[again] = 0
            moved += size
            largest = float(size.max())
            measured = measured.after({k: s for k, s in enumerate(steps) if moved[k] <= enough})
        measured = Measurements([], [])
    return Descent(made, scale, largest, scale_step)


def step_size_mm(obj: problem.RefineObject, step: Step) -> float:
    """Largest motion of the surface by a step."""
    shift, turn = np.linalg.norm(step.xi[:3]), np.linalg.norm(step.xi[3:])
    return 1000 * float(shift + turn * obj.radius)


def advance(
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    measured: Measurements,
    scale: float,
    options: problem.RefineOptions,
) -> list[Step]:
    """One Gauss-Newton step with robust weights; returns the change of each object."""
    delta = np.zeros(6 * len(objects) + 2)
    for _ in range(3):
        # Weights for the residuals after the step, so that outliers do not influence it.
        system, _, _ = assemble(objects, state, measured, scale, options, delta)
        delta = system.solve([o.radius for o in objects])
    log_scale, factor = float(delta[system.SCALE]), float(delta[system.FACTOR])
    steps = []
    for i, obj in enumerate(objects):
        xi = delta[6 * i : 6 * i + 6]
        shift, turn = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
        # The linearisation is valid for motions that are small relative to the object.
        xi = xi / max(shift / (0.25 * obj.radius), turn / 0.2, 1.0)
        state.poses[i] = state.poses[i] @ SE3.exp(xi)
        steps.append(Step(xi, log_scale, factor))
    state.log_scale += log_scale
    state.depth_factor *= 1 + factor
    return steps


def assemble(
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    measured: Measurements,
    scale: float,
    options: problem.RefineOptions,
    delta: Array,
) -> tuple[NormalEquations, dict[int, float], dict[int, float]]:
    """Normal equations, and the robust standard deviations of edges (px) and depth (m)."""
    rows, edge_std, depth_std = weigh(len(objects), measured, scale, options, delta)
    system = NormalEquations(len(objects))
    for one in rows:
        system.add(one)
    _add_priors(system, objects, state, options)
    return system, edge_std, depth_std


def weigh(
    objects: int,
    measured: Measurements,
    scale: float,
    options: problem.RefineOptions,
    delta: Array,
) -> tuple[list[WeightedRows], dict[int, float], dict[int, float]]:
    """Measurements with robust weights for the residuals after the step `delta`.

    Args:
        objects: number of objects.
        scale: image scale of the measurements.
        delta: (6 * objects + 2,).

    Returns:
        Weighted rows, and the robust standard deviations of edges (px) and depth (m) by object.
    """
    found: list[WeightedRows] = []
    edge_std: dict[int, float] = {}
    depth_std: dict[int, float] = {}
    d_scale, d_factor = delta[-SCALE], delta[-FACTOR]
    for i in range(objects):
        xi = delta[6 * i : 6 * i + 6]
        mine = [rows for k, rows in measured.contours if k == i]
        if mine:
            left = [r.residual - r.pose @ xi - r.scale * d_scale for r in mine]
            clear = np.concatenate([r.weight for r in mine]) > 0.1
            edge_std[i] = max(_robust_std(np.concatenate(left)[clear]), _SMALLEST_EDGE_STD_PX)
            information = 1 / (edge_std[i] ** 2 * _CONTOUR_CORRELATION_PX * max(scale, 0.5))
            if any(k == i for k, _ in measured.textures):
                # The rim of a scanned mesh is off by more than its texture, and in all views alike.
                information *= min(1.0, _CONTOURS_BESIDE_TEXTURE / len(mine))
            for rows, rest in zip(mine, left, strict=True):
                weight = information * rows.weight * _cauchy(rest / edge_std[i])
                J = np.column_stack([rows.pose, rows.scale])
                found.append(
                    WeightedRows(
                        "contour",
                        i,
                        rows.view,
                        rows.residual,
                        J,
                        (SCALE,),
                        weight,
                        rows.points,
                        rows.spacing,
                    )
                )
        surfaces = [rows for k, rows in measured.depths if k == i]
        if surfaces:
            left = [
                r.residual - r.pose @ xi - r.scale * d_scale + r.factor * d_factor for r in surfaces
            ]
            depth_std[i] = max(_robust_std(np.concatenate(left)), _SMALLEST_DEPTH_STD_M)
            for surface, rest in zip(surfaces, left, strict=True):
                share = min(1.0, options.depth_samples / len(rest)) / depth_std[i] ** 2
                J = np.column_stack([surface.pose, surface.scale, -surface.factor])
                weight = share * _cauchy(rest / depth_std[i])
                shared = (SCALE, FACTOR)
                found.append(
                    WeightedRows(
                        "depth",
                        i,
                        surface.view,
                        surface.residual,
                        J,
                        shared,
                        weight,
                        surface.points,
                    )
                )
        textured = [rows for k, rows in measured.textures if k == i]
        if textured:
            found += _weigh_textures(i, textured, xi, d_scale)
    return found, edge_std, depth_std


def _weigh_textures(
    index: int, textured: Sequence[TextureRows], xi: Array, d_scale: float
) -> list[WeightedRows]:
    left = [r.residual - r.pose @ xi - r.scale * d_scale for r in textured]
    std = max(_robust_std(np.concatenate(left)), _SMALLEST_TEXTURE_STD_PX)
    # A texture may have parts that the mesh's texture has not: the mode of the matches counts.
    sharp = min(std, _LARGEST_TEXTURE_STD_PX)
    found = []
    for rows, rest in zip(textured, left, strict=True):
        share = min(1.0, _TEXTURE_SAMPLES / len(rest)) / std**2
        weight = share * _cauchy(np.linalg.norm(rest, axis=1) / (sharp * np.sqrt(2)))
        J = np.concatenate([rows.pose, rows.scale[..., None]], axis=2).reshape(-1, 7)
        points = np.repeat(rows.points, 2, axis=0)
        flat = rows.residual.reshape(-1), J, (SCALE,), np.repeat(weight, 2), points
        found.append(WeightedRows("texture", index, rows.view, *flat))
    return found


def _add_priors(
    system: NormalEquations,
    objects: Sequence[problem.RefineObject],
    state: PoseState,
    options: problem.RefineOptions,
) -> None:
    weak = np.array([options.translation_std] * 3 + [options.rotation_std] * 3)
    for i, obj in enumerate(objects):
        at = slice(6 * i, 6 * i + 6)
        moved = (obj.T_world_obj.inverse() @ state.poses[i]).log()
        stiff = np.full(6, 1e12) if obj.fixed else weak**-2
        system.add_prior(at, np.diag(stiff), moved)
        for axis, offset in obj.symmetry.continuous:
            # A rotation about the axis of symmetry has no visible effect.
            twist = np.concatenate([-np.cross(axis, offset), axis])
            system.A[at, at] += 1e8 * np.outer(twist, twist)
    scale_information = options.scale_std**-2 if options.refine_scale else 1e16
    system.add_prior(system.SCALE, scale_information, state.log_scale)
    system.add_prior(system.FACTOR, options.depth_factor_std**-2, state.depth_factor - 1)


def _robust_std(values: Array) -> float:
    return float(1.4826 * np.median(np.abs(values))) if len(values) else 1.0


def _cauchy(r: Array) -> Array:
    return np.asarray(1 / (1 + (r / 1.5) ** 2))
