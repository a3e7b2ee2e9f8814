"""Gates on labels that exclude each other, and on symmetries that a mesh does not have."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from std_toolkit.checks.gates.gate import (
    Measured,
    ObjectGate,
    Reading,
    Readings,
    no_exemption,
)
from std_toolkit.checks.result import CheckWarning, ObjectCheck
from std_toolkit.settings import Settings, limit


@dataclass(frozen=True, kw_only=True)
class PlacementSettings(Settings):
    """How far labels may reach into each other, and meshes differ after a declared turn."""

    overlap_part: float = limit(
        0.25, source="neighbours that touch reach into each other by the errors of their labels"
    )
    """two labels exclude each other from this part of the size of the smaller object"""
    noted_mm: float = limit(8.0, unit="mm", source="twice the limit of a label's translation")
    """a smaller overlap brings no warning"""
    symmetry_part: float = limit(0.05, source="scanned meshes are off by a few percent")
    """a declared symmetry is wrong if it moves the surface by this part of the object's size"""


def _overlap(item: ObjectCheck, measured: Measured) -> Reading | None:
    """1 if the label lies in that of another object."""
    entry = item.entry("overlap_mm")
    if entry is None or entry.value is None:
        return None
    sizes = [item.value("size_m")]
    sizes += [o.value("size_m") for o in measured.objects if o.name == entry.text]
    smaller = 1000 * min((s for s in sizes if s is not None), default=0.1)
    inside = entry.value > PlacementSettings.current().overlap_part * smaller
    return Reading(float(inside), detail=f"{item.name} lies in {entry.text}")


def _symmetry(item: ObjectCheck, measured: Measured) -> Reading | None:
    """1 if the mesh is another one after a declared turn."""
    del measured
    entry = item.entry("symmetry_mm")
    if entry is None or entry.value is None:
        return None
    size = 1000 * (item.value("size_m") or 0.1)
    wrong = bool(entry.text) and entry.value > PlacementSettings.current().symmetry_part * size
    return Reading(float(wrong), detail=f"{item.name} by {entry.value:.1f} mm")


def _details(found: Readings, measured: Measured) -> str:
    del measured
    return ", ".join(reading.detail for _, reading in found)


def _contacts(measured: Measured) -> Iterable[CheckWarning]:
    for item in measured.labelled:
        entry, reading = item.entry("overlap_mm"), _overlap(item, measured)
        if entry is None or reading is None or reading.value:
            continue
        if (entry.value or 0.0) >= PlacementSettings.current().noted_mm:
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"reaches {entry.value:.1f} mm into {entry.text}",
                advice="inspect both labels, and the sizes of their meshes",
            )


GATES = (
    ObjectGate(
        key="overlap",
        title="labels that lie in the label of another object",
        measure=_overlap,
        counts=True,
        exempt=no_exemption,
        names=False,
        optional=True,
        detail=_details,
        advice="two labels are on one object, or one of them is far off: remove or correct it",
        warn=_contacts,
    ),
    ObjectGate(
        key="symmetry",
        title="declared symmetries that the mesh does not have",
        measure=_symmetry,
        counts=True,
        exempt=no_exemption,
        verdict="doubtful",
        names=False,
        optional=True,
        detail=_details,
        advice="declare the symmetry of the mesh (`std-curate label --symmetry auto`)",
    ),
)
