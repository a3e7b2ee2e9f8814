"""Gates on the pose of a label by all evidence, on its size, and on what could see a fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from std_toolkit.checks.gates.gate import (
    Measured,
    ObjectGate,
    Reading,
    Readings,
    unlabelled,
)
from std_toolkit.checks.gates.hypotheses import Weighed, fits_as_well, graded
from std_toolkit.checks.measure.object_motion import ConfirmationSettings
from std_toolkit.checks.result import CheckWarning, ObjectCheck, Verdict
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Causes for which a motion accuses no label.
_EXCUSES = ("shape", "texture", "blind", "misled", "contradicted")
_REFINE = "run `std-curate propagate --refine`, or correct the label in the annotator"


@dataclass(frozen=True, kw_only=True)
class MotionGateSettings(Settings):
    """Motions that are noted, and edges beside a label that count."""

    noted_mm: float = limit(2.0, unit="mm", source=NOT_RECORDED)
    """a smaller translation brings no warning"""
    noted_deg: float = limit(1.2, unit="deg", source=NOT_RECORDED)
    """a smaller rotation brings no warning"""
    noted_sigmas: float = limit(3.0, unit="deviations", source=NOT_RECORDED)
    """nor does one of fewer deviations"""
    beside: float = limit(
        2.0, source="five in a hundred by chance; a right dish of glass of seed 759 has 1.4"
    )
    """a label is not on the object's edges where its support is less by more deviations than that
    of a pose nearby"""


def size_error(item: ObjectCheck) -> float:
    """The relative difference in size, 0 if it is not significant."""
    error, std = item.value("size_error"), item.std("size_error")
    if error is None or std is None:
        return 0.0
    return error if abs(error) > ConfirmationSettings.current().size_deviations * std else 0.0


def is_judged(item: ObjectCheck, measured: Measured) -> bool:
    """Whether the pose is judged by a motion in six degrees of freedom.

    Distances in pixels depend on resolution and distance. They decide where there is no motion.
    """
    found = measured.weighed.get(item.object)
    return found is not None and found.verdict != "unknown"


def _motion(part: Literal["mm", "deg"]) -> Callable[[ObjectCheck, Measured], Reading | None]:
    """The measure of one part of the motion."""
    where = slice(3) if part == "mm" else slice(3, 6)

    def measure(item: ObjectCheck, measured: Measured) -> Reading | None:
        found = measured.weighed.get(item.object)
        if found is None:
            return None
        value = float(np.linalg.norm(found.located.motion[where]))
        within = found.within_mm if part == "mm" else found.within_deg
        other = found.within_deg if part == "mm" else found.within_mm
        verdict = found.verdict
        if verdict in ("doubtful", "wrong") and within > other:
            # The other part of the motion is what is wrong.
            verdict = graded(within)
        return Reading(
            value,
            found.located.along(where),
            excuse=found.reason if found.cause in _EXCUSES else "",
            verdict=verdict,
        )

    return measure


def _size(item: ObjectCheck, measured: Measured) -> Reading | None:
    if item.value("size_error") is None or item.text("support") in ("loose", "faint", "absent"):
        return None
    found = measured.weighed.get(item.object)
    std = 100 * (item.std("size_error") or 0)
    if found is not None and found.cause == "shape":
        return Reading(100 * abs(size_error(item)), std, excuse=found.reason, verdict="fits")
    return Reading(100 * abs(size_error(item)), std)


def _seen(item: ObjectCheck, measured: Measured) -> Reading | None:
    """Whether the images show the object where its label puts it."""
    if unlabelled(item, measured) or item.entry("confirmed") is None:
        return None
    if item.object in measured.weighed or item.text("confirmed") == "yes":
        return Reading(0.0, verdict="fits")
    support = item.entry("support")
    seen = support.text if support is not None else ""
    verdict: Verdict = "unknown"
    if seen == "absent" and _is_expected(item):
        verdict = "wrong"
    elif seen == "faint" and _is_expected(item) and item.material in DIFFUSE_MATERIALS:
        verdict = "doubtful"
    elif seen == "aside" and item.material == "transparent":
        # Not of steel: edges beside it may be those of its highlights.
        as_well = fits_as_well(item, MotionGateSettings.current().beside)
        verdict = "unknown" if as_well else "doubtful"
    return Reading(1.0, detail=_UNSEEN.get(seen, _UNSEEN["faint"]), verdict=verdict)


_UNSEEN = {
    "faint": "too little of its contour lies on image edges",
    "loose": "the images allow poses far from it",
    "aside": "edges nearby fit another pose clearly better",
    "absent": "the images do not show it where its label puts it",
}


def _is_expected(item: ObjectCheck) -> bool:
    """Whether enough of the contour is in view to be missed."""
    support = item.entry("support")
    limits = ConfirmationSettings.current()
    return support is not None and (support.std or 1.0) < limits.missed_std


def _worst_name(found: Readings, measured: Measured) -> str:
    del measured
    ((item, reading),) = found
    return item.name if reading.value else ""


def _with_reasons(found: Readings, measured: Measured) -> str:
    del measured
    return "; ".join(f"{item.name}: {reading.detail}" for item, reading in found)


def _explained(measured: Measured) -> Iterable[tuple[ObjectCheck, Weighed]]:
    for item in measured.labelled:
        found = measured.weighed.get(item.object)
        if found is not None:
            yield item, found


def _motion_warnings(measured: Measured) -> Iterable[CheckWarning]:
    """Motions within the limits, and objects that differ from the mesh."""
    limits = MotionGateSettings.current()
    for item, found in _explained(measured):
        if found.cause in ("shape", "texture"):
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=found.reason,
                advice="the label fits best; scan this object if its shape or texture matters",
            )
        elif found.verdict == "fits":
            at = found.located
            parts = [
                f"{value:.1f} {unit} (± {std:.1f})"
                for (value, _), std, noted, unit in (
                    (at.mm, at.along(slice(3)), limits.noted_mm, "mm"),
                    (at.deg, at.along(slice(3, 6)), limits.noted_deg, "deg"),
                )
                if value >= max(noted, limits.noted_sigmas * std)
            ]
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
        if abs(size) < limits.noted_size:
            continue
        yield CheckWarning(
            severity="medium",
            about=item.name,
            problem=f"the mesh differs from the object: it is {100 * abs(size):.1f} % "
            f"(± {std:.1f}) too {'large' if size < 0 else 'small'}, or the "
            "scale of the poses is off",
            advice="measure the object and scale its mesh, or check the scale sources",
        )


def _undetermined(measured: Measured) -> Iterable[CheckWarning]:
    """Labels whose faults no source could have seen."""
    for item in measured.labelled:
        found = measured.weighed.get(item.object)
        reading = _seen(item, measured)
        why = ""
        if found is not None and found.verdict == "unknown":
            why = found.reason
        elif reading is not None and reading.verdict == "unknown":
            why = reading.detail
        if why:
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"is unknown: {why}",
                advice="record it nearer and from more sides, or use a mesh with texture",
            )


GATES = (
    ObjectGate(
        key="motion",
        title="translation between a label and the images, worst object",
        measure=_motion("mm"),
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
        measure=_motion("deg"),
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
        sigmas=1.0,
        detail=_worst_name,
        advice="the mesh differs from the object: measure the object and scale its mesh, or use "
        "the mesh of this object",
        warn=_size_warnings,
    ),
    ObjectGate(
        key="seen",
        title="labels that the images speak against",
        measure=_seen,
        counts=True,
        exempt=unlabelled,
        verdict="doubtful",
        detail=_with_reasons,
        advice="inspect their overlays; annotate them again in frames that show them clearly",
        warn=_undetermined,
    ),
)
