"""Gates on the motion between a label and the images, on its size, and on its confirmation."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from std_toolkit.checks.gates.gate import (
    Measured,
    ObjectGate,
    Reading,
    Readings,
    all_names,
    unlabelled,
)
from std_toolkit.checks.measure.object_motion import ConfirmationSettings
from std_toolkit.checks.result import CheckWarning, ObjectCheck
from std_toolkit.options import CheckOptions
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_REFINE = "run `std-curate propagate --refine`, or correct the label in the annotator"


@dataclass(frozen=True, kw_only=True)
class MotionGateSettings(Settings):
    """Motions that are noted, and those put down to the shape of the mesh."""

    noted_mm: float = limit(2.0, unit="mm", source=NOT_RECORDED)
    """a smaller translation brings no warning"""
    noted_deg: float = limit(1.2, unit="deg", source=NOT_RECORDED)
    """a smaller rotation brings no warning"""
    other_shape: float = limit(3.0, source=NOT_RECORDED)
    """motions up to this many limits are put down to the shape of the mesh where its texture
    fits"""
    offset_px: float = limit(1.5, unit="px", source=NOT_RECORDED)
    """contours further from the image differ in shape"""


def is_small(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the images confirm the label, and determine that its motion is within the limits.

    One frame leaves the distance open: its motion says little.
    """
    if is_another_shape(item, options):
        return True
    if item.text("confirmed") != "yes":
        return False
    mm, deg = item.entry("motion_mm"), item.entry("motion_deg")
    return (
        mm is not None
        and deg is not None
        and max(mm.value or 0, mm.std or 0) <= options.max_motion_mm
        and max(deg.value or 0, deg.std or 0) <= options.max_motion_deg
    )


def is_another_shape(item: ObjectCheck, options: CheckOptions) -> bool:
    """Whether the texture fits and the contour does not: mesh and object differ in shape.

    A box that bulges or a bottle of another production has the texture of the mesh, and a contour
    that no pose explains.
    """
    limits = MotionGateSettings.current()
    mm, deg = item.value("motion_mm") or 0, item.value("motion_deg") or 0
    return (
        item.text("texture") == "fits"
        and item.value("motion_mm") is not None
        and (mm > options.max_motion_mm or deg > options.max_motion_deg or _is_offset(item))
        and mm <= limits.other_shape * options.max_motion_mm
        and deg <= limits.other_shape * options.max_motion_deg
    )


def _is_offset(item: ObjectCheck) -> bool:
    return (item.value("edge_px") or 0) > MotionGateSettings.current().offset_px


def size_error(item: ObjectCheck) -> float:
    """The relative difference in size, 0 if it is not significant."""
    error, std = item.value("size_error"), item.std("size_error")
    if error is None or std is None:
        return 0.0
    return error if abs(error) > ConfirmationSettings.current().size_deviations * std else 0.0


def _motion(key: str) -> Callable[[ObjectCheck, Measured], Reading | None]:
    """The measure of one part of the motion."""

    def measure(item: ObjectCheck, measured: Measured) -> Reading | None:
        if is_another_shape(item, measured.options):
            return Reading(0.0, excuse="its texture fits: the mesh has another shape")
        return Reading(item.value(key), item.std(key))

    return measure


def _size(item: ObjectCheck, measured: Measured) -> Reading | None:
    del measured
    if item.value("size_error") is None:
        return None
    return Reading(100 * abs(size_error(item)), 100 * (item.std("size_error") or 0))


def _confirmed(item: ObjectCheck, measured: Measured) -> Reading | None:
    if unlabelled(item, measured):
        return None
    return Reading(float(item.text("confirmed") == "no"))


def _worst_name(found: Readings, measured: Measured) -> str:
    del measured
    ((item, reading),) = found
    return item.name if reading.value else ""


def _motion_warnings(measured: Measured) -> Iterable[CheckWarning]:
    """Motions within the limits, and contours that differ from the mesh."""
    limits = MotionGateSettings.current()
    options = measured.options
    for item in measured.labelled:
        mm, deg = item.value("motion_mm") or 0, item.value("motion_deg") or 0
        parts = []
        if is_another_shape(item, options):
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem="the mesh has another shape than the object: its texture fits, its "
                f"contour lies {mm:.1f} mm and {deg:.1f} deg from the label",
                advice="the label fits best; scan this object if its shape matters",
            )
            continue
        if limits.noted_mm <= mm <= options.max_motion_mm:
            parts.append(f"{mm:.1f} mm (± {item.std('motion_mm') or 0:.1f})")
        if limits.noted_deg <= deg <= options.max_motion_deg:
            parts.append(f"{deg:.1f} deg (± {item.std('motion_deg') or 0:.1f})")
        if parts:
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"all frames together place it {' and '.join(parts)} from its label",
                advice="run `std-curate propagate --refine`",
            )


def _size_warnings(measured: Measured) -> Iterable[CheckWarning]:
    limits = ConfirmationSettings.current()
    for item in measured.labelled:
        size, std = size_error(item), 100 * (item.std("size_error") or 0)
        if abs(size) < limits.noted_size or is_another_shape(item, measured.options):
            continue
        yield CheckWarning(
            severity="medium",
            about=item.name,
            problem=f"the mesh differs from the object: it is {100 * abs(size):.1f} % "
            f"(± {std:.1f}) too {'large' if size < 0 else 'small'}, or the "
            "scale of the poses is off",
            advice="measure the object and scale its mesh, or check the scale sources",
        )


def _unconfirmed(measured: Measured) -> Iterable[CheckWarning]:
    for item in measured.labelled:
        if item.text("confirmed") == "no" and not is_another_shape(item, measured.options):
            share = 100 * (item.value("confirmed") or 0)
            yield CheckWarning(
                severity="high",
                about=item.name,
                problem="is unconfirmed: its contour beats chance in "
                f"{share:.0f} % of the frames that show it",
                advice="inspect its close-ups",
            )


GATES = (
    ObjectGate(
        key="motion",
        title="translation between a label and the images, worst object",
        measure=_motion("motion_mm"),
        exempt=unlabelled,
        limit=lambda options: options.max_motion_mm,
        unit="mm",
        detail=_worst_name,
        advice=_REFINE,
        warn=_motion_warnings,
    ),
    ObjectGate(
        key="rotation",
        title="rotation between a label and the images, worst object",
        measure=_motion("motion_deg"),
        exempt=unlabelled,
        limit=lambda options: options.max_motion_deg,
        unit="deg",
        detail=_worst_name,
        advice=_REFINE,
    ),
    ObjectGate(
        key="size",
        title="difference in size between a mesh and its object, worst object",
        measure=_size,
        exempt=unlabelled,
        limit=lambda options: 100 * options.max_size_error,
        unit="%",
        detail=_worst_name,
        advice="the mesh differs from the object: measure the object and scale its mesh, or use "
        "the mesh of this object",
        warn=_size_warnings,
    ),
    ObjectGate(
        key="confirmed",
        title="labels that the images do not confirm",
        measure=_confirmed,
        counts=True,
        exempt=unlabelled,
        verdict="doubtful",
        detail=all_names,
        advice="inspect their overlays; annotate them in frames that show them clearly, or accept "
        "them with --allow-doubtful",
        warn=_unconfirmed,
    ),
)
