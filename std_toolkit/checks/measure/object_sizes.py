"""Scale of the camera poses from the known sizes of the labelled objects.

Camera poses and labels that are too large by one factor agree with each other: every object is
farther away, and only its size in the images tells. The refinement of all labels together with one
scale measures it. The scale of each object alone shows whether the objects agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.labels.keyframes import choose_keyframes
from std_toolkit.labels.refine.edges.descent import descend, weigh
from std_toolkit.labels.refine.edges.measure import PoseState, coarse_to_fine
from std_toolkit.labels.refine.edges.system import SCALE
from std_toolkit.labels.refine.problem import RefineObject, RefineOptions
from std_toolkit.labels.refine_step import load_views, scene_object
from std_toolkit.log import logger
from std_toolkit.scene import Scene
from std_toolkit.scene.model import ScaleEstimate
from std_toolkit.scene.scale_model import mesh_deviation
from std_toolkit.settings import Settings, limit

SOURCE = "sizes"
_KEYFRAMES = 6
_OPTIONS = RefineOptions(
    refine_scale=True, use_depth=False, search_px=20.0, largest_image=960, iterations=3
)


@dataclass(frozen=True, kw_only=True)
class SizeSettings(Settings):
    """Objects whose sizes give a scale."""

    outlier_sigma: float = limit(3.0, source="its mesh, or its label, is wrong")
    """an object that differs more from the others is left out"""
    largest_error: float = limit(0.02, source="weak views tell nothing on the scale")
    """largest standard deviation of the size of an object"""


@dataclass(frozen=True)
class ObjectSize:
    """Scale of the camera poses by one object.

    Attributes:
        name, model: of the object.
        factor: on the camera positions.
        standard_error: of the factor, relative.
    """

    name: str
    model: str
    factor: float
    standard_error: float


def measure_sizes(scene: Scene) -> ScaleEstimate | None:
    """Factor on the camera positions that the sizes of the labelled objects ask for.

    Returns:
        An estimate whose factor is relative to the present scale, 1 if the sizes agree with it;
        None without camera poses, labels or sufficient views.
    """
    sizes = object_sizes(scene)
    return combine_sizes(sizes) if sizes else None


def object_sizes(scene: Scene) -> list[ObjectSize]:
    """The scale by each labelled object; those without sufficient views are left out."""
    placed = {o.id: T for o in scene.objects.objects if (T := scene.T_world_obj(o.id)) is not None}
    if not placed or not scene.registered_frames():
        return []
    try:
        frames = choose_keyframes(scene, placed, count=_KEYFRAMES)
        if len(frames) < 2:
            return []
        views = load_views(scene, frames, use_depth=False)
        objects = [scene_object(scene, i, placed[i]) for i in sorted(placed)]
        state = PoseState([o.T_world_obj for o in objects])
        # The scale settles long before the poses do, of which nothing is kept.
        levels = [
            replace(level, iterations=_OPTIONS.iterations)
            for level in coarse_to_fine(views, _OPTIONS)[-2:]
        ]
        descent = descend(views, objects, state, levels, _OPTIONS)
    except (ToolkitError, OSError) as error:
        logger.info("the sizes of the objects tell no scale: %s", error)
        return []
    zero = np.zeros(6 * len(objects) + 2)
    rows, _, _ = weigh(len(objects), descent.measured, descent.scale, _OPTIONS, zero)
    found = []
    for i, obj in enumerate(objects):
        mine = [r for r in rows if r.index == i]
        if len(mine) < 2:
            continue
        change, deviation = _own_scale(
            obj,
            np.concatenate([r.jacobian[:, [*range(6), 6 + r.shared.index(SCALE)]] for r in mine]),
            np.concatenate([r.residual for r in mine]),
            np.concatenate([r.information for r in mine]),
        )
        if deviation < SizeSettings.current().largest_error:
            model = scene.objects.object_named(obj.name).model
            factor = float(np.exp(state.log_scale + change))
            found.append(ObjectSize(obj.name, model, factor, deviation))
    return found


def combine_sizes(sizes: Sequence[ObjectSize]) -> ScaleEstimate | None:
    """Weighted mean of the objects that agree; None if fewer than half of several do."""
    factors = np.array([s.factor for s in sizes])
    sigma = np.array([mesh_deviation(s.standard_error, 1) for s in sizes])
    middle = _weighted_median(factors, sigma**-2)
    kept = np.abs(factors / middle - 1) < SizeSettings.current().outlier_sigma * sigma
    if 2 * kept.sum() <= len(sizes):
        return None
    weight = sigma[kept] ** -2 / (sigma[kept] ** -2).sum()
    factor = float(weight @ factors[kept])
    errors = np.array([s.standard_error for s in sizes])[kept]
    scatter = (factors[kept] / factor - 1) / sigma[kept]
    excess = max(float(scatter @ scatter) / max(kept.sum() - 1, 1) - 1, 0.0)
    error = float(
        np.hypot(np.sqrt(weight**2 @ errors**2), np.sqrt(excess / (sigma[kept] ** -2).sum()))
    )
    models = {s.model for s, used in zip(sizes, kept, strict=True) if used}
    left_out = [s.name for s, used in zip(sizes, kept, strict=True) if not used]
    note = ", ".join(f"{s.name} {s.factor:.4f}" for s in sizes)
    return ScaleEstimate(
        source=SOURCE,
        factor=factor,
        spread=float(np.ptp(factors)) / factor,
        standard_error=error,
        count=int(kept.sum()),
        note=note + (f"; without {', '.join(left_out)}" if left_out else ""),
        deviation=mesh_deviation(error, len(models)),
    )


def _own_scale(
    obj: RefineObject,
    J: NDArray[np.float64],
    residual: NDArray[np.float64],
    information: NDArray[np.float64],
) -> tuple[float, float]:
    """Change of the log scale by one object's rows alone, and its standard deviation."""
    A = J.T @ (J * information[:, None])
    b = J.T @ (residual * information)
    weak = [_OPTIONS.translation_std] * 3 + [_OPTIONS.rotation_std] * 3 + [_OPTIONS.scale_std]
    A += np.diag(np.array(weak) ** -2)
    for axis, offset in obj.symmetry.continuous:
        twist = np.concatenate([-np.cross(axis, offset), axis])
        A[:6, :6] += 1e8 * np.outer(twist, twist)
    C = np.linalg.inv(A)
    return float((C @ b)[6]), float(np.sqrt(C[6, 6]))


def _weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
