"""Meshes from files."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from annotator.session.edits import EnterModel
from annotator.session.mesh_name import model_name
from annotator.session.requests.base import Outcome, Request, Watch
from annotator.session.snapshot import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.labels.label import copy_model
from std_toolkit.scene import ObjectTable, Scene
from std_toolkit.scene.lock import scene_lock


class ImportMesh(Request, frozen=True, kw_only=True, tag="import_mesh"):
    """A mesh file joins the library: it is copied into the scene at once.

    Attributes:
        mesh: path of the file.
        unit: of the file: "m", "cm" or "mm"; stored in metres.
        category: such as "mug".
        model: id of the model; default: from the file's name, or from its folder's for names such
            as "textured", with a number where another mesh has that id.
        symmetry: as on the command line: "axis:z", "fold:z:4", a JSON file; default: none.
    """

    mesh: str
    unit: Literal["m", "cm", "mm"] = "m"
    category: str | None = None
    model: str | None = None
    symmetry: list[str] | None = None

    @property
    def title(self) -> str:
        return f"Add mesh {Path(self.mesh).name}"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del watch
        from std_toolkit.geometry.mesh import load_mesh, mesh_bounds
        from std_toolkit.labels.symmetry_argument import parse_symmetry

        if not snapshot.writable:
            raise ToolkitError("the scene is open for looking only", path=snapshot.scene.root)
        path = Path(self.mesh).expanduser()
        try:
            mesh = load_mesh(path, unit=self.unit)
        except ToolkitError as error:
            raise _plain_hint(error) from error
        symmetry = None
        if self.symmetry is not None:
            centre = mesh_bounds(mesh).mean(axis=0).tolist()
            symmetry = parse_symmetry(self.symmetry, centre=centre)
        # The lock: another process sweeps away temporary files while it writes.
        with scene_lock(snapshot.scene.root):
            try:
                model = copy_model(
                    snapshot.scene.root,
                    _known(snapshot),
                    path,
                    mesh_unit=self.unit,
                    category=self.category,
                    symmetry=symmetry,
                    model_id=self.model or model_name(path),
                    number=self.model is None,
                )
            except ToolkitError as error:
                raise _plain_hint(error) from error
        size = " x ".join(f"{x * 1000:.1f}" for x in model.size_m)
        line = f"model {model.id}: {size} mm, diameter {model.diameter_m * 1000:.1f} mm"
        return Outcome(EnterModel(model=model), [line])


def _known(snapshot: Snapshot) -> ObjectTable:
    """The models of the state, and those that others entered meanwhile: none is overwritten."""
    own = snapshot.scene.objects
    ids = {m.id for m in own.models}
    others = [m for m in Scene.open(snapshot.scene.root).objects.models if m.id not in ids]
    return ObjectTable(models=[*own.models, *others], objects=own.objects)


def _plain_hint(error: ToolkitError) -> ToolkitError:
    """The library's hints are for the command line of `std-curate`."""
    hint = error.hint
    if "large in metres" in error.problem:
        hint = "is the file in millimetres? Then give its unit as mm (or cm)"
    elif "with another mesh" in error.problem:
        hint = "give this one another id"
    return ToolkitError(
        error.problem, path=error.path, field=error.field, value=error.value, hint=hint
    )
