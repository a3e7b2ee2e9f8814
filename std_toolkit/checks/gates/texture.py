"""Gates on the mesh of an object: texture and contour against turns of the label, and its file."""

from __future__ import annotations

from collections.abc import Iterable

from std_toolkit.checks.gates.gate import (
    Measured,
    ObjectGate,
    Reading,
    Readings,
    all_names,
    no_exemption,
)
from std_toolkit.checks.result import CheckWarning, ObjectCheck, Verdict

_VERDICTS: dict[str, Verdict] = {"turned": "wrong", "other": "doubtful", "undecided": "unknown"}


def texture_sentence(item: ObjectCheck) -> str:
    """The finding in words, such as "turned by 180 deg about z fits the texture better"."""
    return item.text("texture_says")


def _texture(item: ObjectCheck, measured: Measured) -> Reading | None:
    del measured
    if not _is_compared(item):
        return None
    found = item.text("texture")
    verdict = _VERDICTS.get(found, "fits")
    return Reading(float(found in _VERDICTS), detail=texture_sentence(item), verdict=verdict)


def _is_compared(item: ObjectCheck) -> bool:
    """Whether a texture was compared, or the contour speaks for a turn."""
    return item.value("texture") is not None or item.value("texture_says") is not None


def _turns(found: Readings, measured: Measured) -> str:
    del measured
    return ", ".join(f"{item.name}: {reading.detail}" for item, reading in found)


def _not_told(measured: Measured) -> Iterable[CheckWarning]:
    """One line per object whose turn neither its silhouette nor a texture determines."""
    for item in measured.labelled:
        found = item.text("texture")
        if found == "ambiguous":
            yield CheckWarning(
                severity="low",
                about=item.name,
                problem=texture_sentence(item),
                advice="use a mesh with texture, or declare the symmetry of the model if both "
                "poses are right",
            )
        elif found == "undecided" and _is_compared(item):
            yield CheckWarning(
                severity="medium",
                about=item.name,
                problem=f"is unknown: {texture_sentence(item)}",
                advice="turn it in the annotator if the other turn is right",
            )


def _unreadable(item: ObjectCheck, measured: Measured) -> Reading | None:
    problem = measured.unreadable.get(item.object)
    return None if problem is None else Reading(1.0, advice=problem)


GATES = (
    ObjectGate(
        key="texture",
        title="labels that fit better after a turn, or whose texture is not there",
        measure=_texture,
        counts=True,
        exempt=no_exemption,
        detail=_turns,
        advice="turn the object in the annotator until texture and outline agree with the image, "
        "or use the mesh of this product; refine, save, and run `std-curate propagate` again",
        warn=_not_told,
    ),
    ObjectGate(
        key="meshes",
        title="labelled objects whose mesh cannot be read",
        measure=_unreadable,
        counts=True,
        exempt=no_exemption,
        verdict="unknown",
        scope="scene",
        optional=True,
        detail=all_names,
        advice="restore the files of the meshes",
    ),
)
