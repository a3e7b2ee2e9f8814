"""The unit of a mesh file, asked where metres cannot be meant."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtWidgets import QWidget

from annotator.placing.mesh_unit import MeshSize, Unit, measure_mesh
from annotator.window.dialogs.question import Answer, Question

_NAMES: dict[Unit, str] = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}


def ask_unit(parent: QWidget | None, path: Path) -> Unit | None:
    """The unit of a mesh file; None if the person would rather leave it.

    Raises:
        ToolkitError: an unreadable mesh, or one of a size that no unit explains.
    """
    size = measure_mesh(path)
    if size.units == ("m",):
        return "m"
    answer = unit_question(parent, path, size).ask()
    return next((u for u in size.units if u == answer), None)


def unit_question(parent: QWidget | None, path: Path, size: MeshSize) -> Question:
    """Answers are the plausible units, or "cancel"."""
    numbers = " x ".join(f"{x:.4g}" for x in size.extents)
    lines = [
        f"In metres the mesh would be {numbers} m large, which no object on a table is. "
        "Scenes hold meshes in metres: in which unit is this file?",
        "",
    ]
    answers = []
    for unit in size.units:
        extent = " x ".join(f"{x:.4g}" for x in size.in_mm(unit))
        lines.append(f"As {_NAMES[unit]} it is {extent} mm.")
        answers.append(Answer(unit, f"It is in {_NAMES[unit]}", f"{extent} mm"))
    answers.append(Answer("cancel", "Cancel", "The mesh is not added."))
    heading = f"{path.name} is not in metres"
    return Question(parent, heading, "\n".join(lines), answers, level="warning")
