"""Mesh files added to the scene's library: size and unit, what is asked, the import."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from annotator.app.controller import Controller
from annotator.app.operations import listed
from annotator.app.questions import Button, Question, Reaction
from annotator.app.tasks import Task
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import (
    LARGEST_EXTENT_M,
    SMALLEST_EXTENT_M,
    UNITS_IN_M,
    load_mesh,
    mesh_extents,
)

if TYPE_CHECKING:
    from annotator.session.edits import EnterModel

Unit = Literal["m", "cm", "mm"]
UNITS: tuple[Unit, ...] = ("m", "mm", "cm")
# Usual size of an object on a table; determines which of two plausible units is first.
_USUAL_SIZE_M = 0.15
# Longer messages hide the view.
MOST_LINES = 8
_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}


@dataclass(frozen=True)
class MeshSize:
    """Size of a mesh, and the units in which it is plausible for a table-top object.

    Attributes:
        extents: (x, y, z) of the bounding box in the numbers of the file.
        units: plausible units, most likely first; only metres if they are plausible.
        faces: number of faces.
        textured: whether the mesh has a texture, which decimation turns into vertex colours.
    """

    extents: tuple[float, float, float]
    units: tuple[Unit, ...]
    faces: int = 0
    textured: bool = False

    def in_mm(self, unit: Unit) -> tuple[float, float, float]:
        """Return the extents in millimetres if the file is in `unit`."""
        factor = 1000 * UNITS_IN_M[unit]
        x, y, z = self.extents
        return x * factor, y * factor, z * factor


def measure_mesh(path: Path) -> MeshSize:
    """Return size and plausible units of a mesh file.

    Raises:
        ToolkitError: the file is unreadable or has no faces, or its size is implausible for a
            table-top object in every unit.
    """
    from trimesh.visual import TextureVisuals

    mesh = load_mesh(path, any_size=True, corners=False)
    extents = mesh_extents(mesh)
    size = float(extents.max())
    found: list[Unit] = [
        u for u in UNITS if SMALLEST_EXTENT_M <= size * UNITS_IN_M[u] <= LARGEST_EXTENT_M
    ]
    x, y, z = (float(v) for v in extents)
    if not found:
        raise ToolkitError(
            "the mesh has a size that no object on a table has, in metres, centimetres or "
            "millimetres",
            path=path,
            value=f"{x:.4g} x {y:.4g} x {z:.4g} m",
            hint="scale it in the program that made it",
        )
    if "m" in found:
        found = ["m"]
    order = sorted(found, key=lambda u: abs(np.log(size * UNITS_IN_M[u] / _USUAL_SIZE_M)))
    textured = isinstance(mesh.visual, TextureVisuals)
    return MeshSize((x, y, z), tuple(order), len(mesh.faces), textured)


@dataclass(frozen=True)
class NewMesh:
    """Mesh file to add to the scene.

    Attributes:
        unit: unit of its coordinates.
        name: wanted id of the model; default: from the name of the file.
        faces: decimate it to this number of faces; None: keep all.
    """

    path: Path
    unit: Unit = "m"
    name: str | None = None
    faces: int | None = None


def import_meshes(
    controller: Controller,
    files: Sequence[NewMesh],
    then: Callable[[list[str]], object] = lambda _: None,
) -> None:
    """Copy mesh files into the scene's library, as one edit.

    Args:
        then: called with the ids of the models after the edit.
    """
    from annotator.session.edits import CompoundEdit, EnterModel, SingleEdit
    from annotator.session.requests import ImportMesh
    from annotator.session.requests.mesh_requests import model_name

    start = controller.session.snapshot()
    names = listed([file.path.name if file.name is None else file.name for file in files])

    def work(task: Task) -> tuple[list[EnterModel], list[str]]:
        edits: list[EnterModel] = []
        report: list[str] = []
        snapshot = start
        for place, file in enumerate(files):
            request = ImportMesh(mesh=str(file.path), unit=file.unit, faces=file.faces)
            outcome = request.import_as(file.name or model_name(file.path), snapshot)
            assert isinstance(outcome.edit, EnterModel)
            edits.append(outcome.edit)
            # Two files of one name must not become one model.
            snapshot = snapshot.with_model(outcome.edit.model)
            report += outcome.report
            task.progress((place + 1) / len(files))
            if task.cancelled:
                break
        return edits, report

    def finish(found: tuple[list[EnterModel], list[str]]) -> None:
        edits, report = found
        single: list[SingleEdit] = [*edits]
        controller.session.apply(CompoundEdit(edits=single, label=f"Add {names}"))
        between = "\n" if len(report) <= MOST_LINES else "; "
        controller.tell(f"Added {between.join(report)}")
        then([edit.model.id for edit in edits])

    controller.start(f"Add {names}", work, finish, beside=True)


def unit_question(
    name: str, size: MeshSize, react: Reaction, cancelled: Callable[[], object]
) -> Question:
    """Ask for the unit of a mesh file among the plausible ones."""
    numbers = " × ".join(f"{x:.4g}" for x in size.extents)
    extents = {u: " × ".join(f"{x:.4g}" for x in size.in_mm(u)) + " mm" for u in size.units}
    lines = [f"As {_NAMES[unit]} it is {extent}." for unit, extent in extents.items()]
    return Question(
        f"{name} is not in metres",
        react,
        text=f"In metres the mesh would be {numbers} m large, which no object on a table is. "
        "Scenes hold meshes in metres: in which unit is this file?\n\n" + "\n".join(lines),
        level="warning",
        buttons=(
            *(Button(u, f"It is in {_NAMES[u]}", extent) for u, extent in extents.items()),
            Button("", "Cancel", "The mesh is not added."),
        ),
        cancelled=cancelled,
    )


def decimate_question(
    name: str,
    size: MeshSize,
    fewer: int,
    react: Reaction,
    cancelled: Callable[[], object],
) -> Question:
    """Ask whether to decimate a mesh of many faces: "fewer" or "keep"."""
    colors = " Its texture becomes colours of the vertices." if size.textured else ""
    return Question(
        f"{name} has {size.faces:,} faces",
        react,
        text=f"Views, refinement and checks are slow with so many. A mesh of {fewer:,} faces "
        f"has the same shape up to small details.{colors} The file itself does not change.",
        buttons=(
            Button("fewer", f"Decimate to {fewer:,}", f"The scene gets a mesh of {fewer:,} faces."),
            Button("keep", "Keep all", "The scene gets a copy of the file."),
            Button("", "Cancel", "The mesh is not added."),
        ),
        cancelled=cancelled,
    )
