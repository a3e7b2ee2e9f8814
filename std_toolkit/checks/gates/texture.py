"""Gates on the mesh of an object: its texture against turns of the label, and its file."""

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
from std_toolkit.checks.result import CheckWarning, ObjectCheck
from std_toolkit.labels.texture.comparison import TextureComparison


def texture_sentence(item: ObjectCheck) -> str:
    """The finding in words, such as "turned by 180 deg about z fits the texture better"."""
    verdict, turn = item.text("texture"), item.text("texture_rival")
    if not verdict:
        return ""
    nan = float("nan")
    return TextureComparison(verdict, None, turn, nan, nan, 0).sentence()  # type: ignore[arg-type]


def _texture(item: ObjectCheck, measured: Measured) -> Reading | None:
    del measured
    if item.value("texture") is None:
        return None
    turned = item.text("texture") == "turned"
    return Reading(float(turned), detail=texture_sentence(item))


def _turns(found: Readings, measured: Measured) -> str:
    del measured
    return ", ".join(f"{item.name}: {reading.detail}" for item, reading in found)


def _ambiguous(measured: Measured) -> Iterable[CheckWarning]:
    """One line per object whose turn neither its silhouette nor a texture determines."""
    for item in measured.objects:
        if item.text("texture") == "ambiguous":
            yield CheckWarning(
                severity="low",
                about=item.name,
                problem=texture_sentence(item),
                advice="use a mesh with texture, or declare the symmetry of the model if both "
                "poses are right",
            )


def _unreadable(item: ObjectCheck, measured: Measured) -> Reading | None:
    problem = measured.unreadable.get(item.object)
    return None if problem is None else Reading(1.0, advice=problem)


GATES = (
    ObjectGate(
        key="texture",
        title="labels whose texture fits better after a turn",
        measure=_texture,
        counts=True,
        exempt=no_exemption,
        detail=_turns,
        advice="turn the object in the annotator until its texture agrees with the image, refine "
        "and save it, and run `std-curate propagate` again",
        warn=_ambiguous,
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
