"""Residual motion, size and confirmation of the labels: values, gates and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.contours import mesh_problem, object_centre
from std_toolkit.checks.measure.motion import (
    FEWEST_FRAMES,
    FiledEquations,
    MotionEquations,
    Support,
    pooled_support,
)
from std_toolkit.checks.measure.motion_solver import Motion, solve_motion, symmetry_motions
from std_toolkit.checks.measure.residuals import FrameObservation
from std_toolkit.checks.result import CheckGate, CheckWarning, ObjectCheck, ObjectFrameCheck
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene

_Equations = MotionEquations | FiledEquations

# Motions below these are not worth a warning.
_NOTED_MM = 2.0
_NOTED_DEG = 1.2
_NOTED_SIZE = 0.015
_SIZE_DEVIATIONS = 3.0
_JUDGED_FRACTION = 0.2
# Support of all frames together that confirms a label which few frames confirm alone: deviations
# above chance, and the part of what chance leaves. Right labels on glass reach 0.43, the mesh of
# another object 0.37.
_CLEAR_DEVIATIONS = 3.5
_CLEAR_PART = 0.4
# Systematic part of the deviation of a size: reflections and refraction move the edges of contours.
_SIZE_STD = {"specular": 0.014, "transparent": 0.008}
# The same for motions, px.
_SYSTEMATIC_PX = {"specular": 1.0, "transparent": 0.4}
_OPAQUE_SYSTEMATIC_PX = 0.1
# Together with the size, such an error can look like a rotation.
_SIZED_SYSTEMATIC_PX = 0.25
_OPAQUE_SIZE_STD = 0.004
# A mesh of the right size brings at least this share of the contour onto edges that a wrong one
# leaves beside them. Sizes 2 to 8 % off change the share by 0.09 to 0.45, shades and reflections
# that look like a size by up to 0.05.
_SIZE_SHARE = 0.07
_LABELLED = ("propagated", "refined")
# Motions up to this many limits are put down to the shape of the mesh where its texture fits.
_OTHER_SHAPE = 3.0
# Reflections give edges at which a pose is about as likely; up to this many limits away, they say
# nothing against the label.
_LOOSE = 1.5
# A label from which no motion is significant keeps at least this part of the support above chance
# that the images offer nearby. Right labels keep 0.81 or more on glass and steel.
_KEPT_SUPPORT = 0.65
# Contours further from the image than this differ in shape.
_OFFSET_PX = 1.5


def with_motions(
    scene: Scene,
    objects: Sequence[ObjectCheck],
    observed: Sequence[FrameObservation],
    options: CheckOptions,
) -> list[ObjectCheck]:
    """The rows of the objects with their motion, size and confirmation."""
    return [_with_motion(scene, o, observed, options) for o in objects]


def is_small(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the images confirm the label, and determine that its motion is within the limits.

    One frame leaves the distance open: its motion says little.
    """
    if is_another_shape(item, options):
        return True
    return (
        item.confirmed is True
        and item.motion_mm is not None
        and max(item.motion_mm or 0, item.motion_std_mm or 0) <= options.max_motion_mm
        and max(item.motion_deg or 0, item.motion_std_deg or 0) <= options.max_motion_deg
    )


def is_another_shape(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the texture fits and the contour does not: mesh and object differ in shape.

    A box that bulges or a bottle of another production has the texture of the mesh, and a contour
    that no pose explains.
    """
    mm, deg = item.motion_mm or 0, item.motion_deg or 0
    return (
        item.texture_verdict == "fits"
        and item.motion_mm is not None
        and (mm > options.max_motion_mm or deg > options.max_motion_deg or _is_offset(item))
        and mm <= _OTHER_SHAPE * options.max_motion_mm
        and deg <= _OTHER_SHAPE * options.max_motion_deg
    )


def _is_offset(item: ObjectCheck) -> bool:
    return (item.edge_px or 0) > _OFFSET_PX


def counted_motion(item: ObjectCheck, options: CheckOptions) -> tuple[float | None, float | None]:
    """Translation (mm) and rotation (degrees) that count against the label; None without."""
    if is_another_shape(item, options):
        return 0.0, 0.0
    return item.motion_mm, item.motion_deg


def has_wrong_size(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the mesh differs from the object by more than the limit."""
    return abs(size_error(item)) > options.max_size_error


def size_error(item: ObjectCheck) -> float:
    """The relative difference in size, 0 if it is not significant."""
    if item.size_error is None or item.size_std is None:
        return 0.0
    significant = abs(item.size_error) > _SIZE_DEVIATIONS * item.size_std
    return item.size_error if significant else 0.0


def motion_gates(objects: Sequence[ObjectCheck], options: CheckOptions) -> list[CheckGate]:
    """Gates on translation, rotation, size and confirmation."""
    labelled = [o for o in objects if o.label in _LABELLED]
    refine = "run `std-curate propagate --refine`, or correct the label in the annotator"
    unconfirmed = [o for o in labelled if o.confirmed is False]
    confirmed = _gate(
        "confirmed",
        "labels that the images do not confirm",
        {o.name: 1.0 for o in unconfirmed} or {o.name: 0.0 for o in labelled},
        0.0,
        "inspect their overlays; annotate them in frames that show them clearly, or accept them "
        "with --allow-unconfirmed",
    )
    names = ", ".join(o.name for o in unconfirmed)
    accepted = options.allow_unconfirmed and confirmed.status == "fail"
    confirmed = msgspec.structs.replace(
        confirmed,
        value=float(len(unconfirmed)) if labelled else None,
        detail=names + ("; allowed by --allow-unconfirmed" if accepted else ""),
        status="pass" if accepted else confirmed.status,
    )
    return [
        _gate(
            "motion",
            "translation between a label and the images, worst object",
            {o.name: v for o in labelled if (v := counted_motion(o, options)[0]) is not None},
            options.max_motion_mm,
            refine,
            unit="mm",
        ),
        _gate(
            "rotation",
            "rotation between a label and the images, worst object",
            {o.name: v for o in labelled if (v := counted_motion(o, options)[1]) is not None},
            options.max_motion_deg,
            refine,
            unit="deg",
        ),
        _gate(
            "size",
            "difference in size between a mesh and its object, worst object",
            {o.name: 100 * abs(size_error(o)) for o in labelled if o.size_error is not None},
            100 * options.max_size_error,
            "the mesh differs from the object: measure the object and scale its mesh, or use the "
            "mesh of this object",
            unit="%",
        ),
        confirmed,
    ]


def motion_warnings(objects: Sequence[ObjectCheck], options: CheckOptions) -> list[CheckWarning]:
    """Significant motions and sizes below the limits, and labels that are not confirmed."""
    found = []
    for item in objects:
        if item.label not in _LABELLED:
            continue
        if is_another_shape(item, options):
            found.append(
                CheckWarning(
                    severity="medium",
                    about=item.name,
                    problem="the mesh has another shape than the object: its texture fits, its "
                    f"contour lies {item.motion_mm or 0:.1f} mm and {item.motion_deg or 0:.1f} deg "
                    "from the label",
                    advice="the label fits best; scan this object if its shape matters",
                )
            )
            continue
        parts = []
        if _NOTED_MM <= (item.motion_mm or 0) <= options.max_motion_mm:
            parts.append(f"{item.motion_mm:.1f} mm (± {item.motion_std_mm or 0:.1f})")
        if _NOTED_DEG <= (item.motion_deg or 0) <= options.max_motion_deg:
            parts.append(f"{item.motion_deg:.1f} deg (± {item.motion_std_deg or 0:.1f})")
        if parts:
            found.append(
                CheckWarning(
                    severity="medium",
                    about=item.name,
                    problem=f"all frames together place it {' and '.join(parts)} from its label",
                    advice="run `std-curate propagate --refine`",
                )
            )
        size = size_error(item)
        if abs(size) >= _NOTED_SIZE:
            word = "large" if size < 0 else "small"
            found.append(
                CheckWarning(
                    severity="medium",
                    about=item.name,
                    problem=f"the mesh differs from the object: it is {100 * abs(size):.1f} % "
                    f"(± {100 * (item.size_std or 0):.1f}) too {word}, or the scale of the poses "
                    "is off",
                    advice="measure the object and scale its mesh, or check the scale sources",
                )
            )
        if item.confirmed is False:
            share = 100 * (item.confirmed_share or 0)
            found.append(
                CheckWarning(
                    severity="high",
                    about=item.name,
                    problem="is unconfirmed: its contour beats chance in "
                    f"{share:.0f} % of the frames that show it",
                    advice="inspect its close-ups",
                )
            )
    return found


def _with_motion(
    scene: Scene,
    item: ObjectCheck,
    observed: Sequence[FrameObservation],
    options: CheckOptions,
) -> ObjectCheck:
    T_world_obj = scene.T_world_obj(item.object)
    if item.label not in _LABELLED or T_world_obj is None:
        return item
    if mesh_problem(scene, item.model) is not None:
        return item
    rows: dict[int, _Equations] = {}
    judged: dict[int, _Equations] = {}
    for frame in observed:
        seen = frame.objects.get(item.object)
        if seen is not None and seen.motion is not None:
            rows[frame.frame] = seen.motion
            if seen.visible_fraction >= _JUDGED_FRACTION:
                judged[frame.frame] = seen.motion
    symmetry = scene.objects.model(item.model).symmetry.symmetry()
    free = symmetry_motions(symmetry, T_world_obj, object_centre(scene, item.object))
    equations = list(judged.values())
    item = msgspec.structs.replace(
        item, frames=[_frame_row(row, rows.get(row.frame), free) for row in item.frames]
    )
    systematic_px = _SYSTEMATIC_PX.get(item.material, _OPAQUE_SYSTEMATIC_PX)
    motion = solve_motion(equations, free, systematic_px=systematic_px)
    if motion is None:
        return msgspec.structs.replace(item, confirmed=False, confirmed_share=0.0)
    # Support is measured where the images put the object: a small motion has a gate of its own.
    support = pooled_support(equations, motion.vector)
    if len(equations) < FEWEST_FRAMES:
        # Errors of mesh and lens move a whole contour in one image: its motion is no evidence.
        return msgspec.structs.replace(
            item,
            confirmed=_is_supported(support) or item.texture_verdict == "fits",
            confirmed_share=round(support.frames, 4),
        )
    fields: dict[str, Any] = {}
    plain = motion
    sized = solve_motion(
        equations, free, with_size=True, systematic_px=max(systematic_px, _SIZED_SYSTEMATIC_PX)
    )
    assert sized is not None and sized.size is not None and sized.size_std is not None
    floor = _SIZE_STD.get(item.material, _OPAQUE_SIZE_STD)
    size_std = float(np.hypot(sized.size_std, floor))
    sized_support = pooled_support(equations, np.append(sized.vector, sized.size))
    if sized_support.share - support.share < _SIZE_SHARE:
        size_std = max(size_std, abs(sized.size))
    fields |= {"size_error": round(sized.size, 5), "size_std": round(size_std, 5)}
    # A wrong size pulls the motion with it, and a size that is right leaves it as it is.
    if abs(sized.size) > max(_NOTED_SIZE, _SIZE_DEVIATIONS * size_std):
        motion, support = sized, sized_support
    mm, mm_std = motion.translation_mm
    deg, deg_std = motion.rotation_deg
    fields |= {
        "motion_mm": round(mm, 2),
        "motion_std_mm": round(mm_std, 2),
        "motion_deg": round(deg, 2),
        "motion_std_deg": round(deg_std, 2),
        "motion": [
            *(round(float(x), 2) for x in 1000 * motion.vector[:3]),
            *(round(float(x), 2) for x in np.rad2deg(motion.vector[3:])),
        ],
        "confirmed_share": round(support.frames, 4),
        "confirmed": item.texture_verdict == "fits"
        or (
            _is_supported(support)
            and not _is_loose(plain, options)
            and _keeps_support(motion, support, equations)
        ),
    }
    return msgspec.structs.replace(item, **fields)


def _frame_row(
    row: ObjectFrameCheck, filed: _Equations | None, free: NDArray[np.float64]
) -> ObjectFrameCheck:
    """The row with the support of the label in this frame, and the motion by this frame alone."""
    if filed is None:
        return row
    equations = filed.load()
    alone = solve_motion([equations], free)
    assert alone is not None
    on_edges, chance = equations.support(np.zeros(6))
    (mm, mm_std), (deg, deg_std) = alone.translation_mm, alone.rotation_deg
    return msgspec.structs.replace(
        row,
        on_edges=round(on_edges, 4),
        on_edges_chance=round(chance, 4),
        motion_mm=round(mm, 2),
        motion_std_mm=round(mm_std, 2),
        motion_deg=round(deg, 2),
        motion_std_deg=round(deg_std, 2),
    )


def _is_supported(support: Support) -> bool:
    """Whether the images show the object: most frames alone, or all together clearly.

    The contour of clear glass is faint: few frames tell it from chance alone.
    """
    margin = support.share - support.chance
    together = margin > max(
        _CLEAR_DEVIATIONS * support.deviation, _CLEAR_PART * (1 - support.chance)
    )
    return support.frames > 0.5 or together


def _keeps_support(motion: Motion, support: Support, equations: Sequence[_Equations]) -> bool:
    """Whether the label itself lies on edges, where the motion to better ones is not significant.

    Reflections on steel leave the motion so uncertain that a wrong label may lie within it.
    """
    if motion.translation_mm[0] > 0 or motion.rotation_deg[0] > 0:
        return True
    label = pooled_support(equations, np.zeros(6))
    return label.share - label.chance >= _KEPT_SUPPORT * (support.share - support.chance)


def _is_loose(motion: Motion, options: CheckOptions) -> bool:
    """Whether the images allow a pose far from the label without showing it."""
    mm = 1000 * float(np.linalg.norm(motion.vector[:3]))
    deg = float(np.rad2deg(np.linalg.norm(motion.vector[3:])))
    return (mm > _LOOSE * options.max_motion_mm and motion.translation_mm[0] == 0) or (
        deg > _LOOSE * options.max_motion_deg and motion.rotation_deg[0] == 0
    )


def _gate(
    key: str,
    title: str,
    values: dict[str, float],
    limit: float,
    advice: str,
    *,
    unit: str = "",
) -> CheckGate:
    worst = max(values, key=lambda k: values[k]) if values else None
    status: Literal["pass", "fail", "open"] = "open"
    if worst is not None:
        status = "fail" if round(values[worst], 3) > limit + 1e-9 else "pass"
    return CheckGate(
        key=key,
        title=title,
        value=None if worst is None else round(values[worst], 3),
        limit=round(limit, 4),
        rule="at most",
        unit=unit,
        status=status,
        detail="" if worst is None or not values[worst] else worst,
        advice=advice,
    )
