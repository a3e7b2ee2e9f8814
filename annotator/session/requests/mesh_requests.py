"""Base class of requests, and the request that imports a mesh file.

A request is resolved on a snapshot, in any thread, and returns one edit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec

from annotator.session.edits import AnyEdit, EnterModel
from annotator.session.state import Snapshot
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.symmetry import symmetry_words
from std_toolkit.io.locks import scene_lock
from std_toolkit.labels.entry.label import copy_model
from std_toolkit.scene import ObjectTable, Scene
from std_toolkit.scene.document import Document, safe_name
from std_toolkit.scene.model import SymmetryModel

if TYPE_CHECKING:
    from std_toolkit.labels.texture.comparison import TextureComparison

Progress = Callable[[float], None]

Cancelled = Callable[[], bool]

# Generic file names in data sets whose folders have the objects' names.
_GENERIC = frozenset(
    ("mesh", "model", "models", "nontextured", "object", "poisson", "scan", "textured", "untitled")
)


@dataclass(frozen=True)
class Outcome:
    """Result of a request.

    Attributes:
        edit: edit to apply.
        report: lines of text on the result.
        warnings: sentences on what to inspect.
        weak_directions: sentence by object name on the least determined direction of its pose.
        textures: comparison by object name of its texture with near-symmetric turns.
    """

    edit: AnyEdit
    report: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    weak_directions: dict[str, str] = field(default_factory=dict)
    textures: dict[str, TextureComparison] = field(default_factory=dict)


class RequestCancelled(ToolkitError):
    """The request was cancelled; nothing has changed."""


@dataclass(frozen=True)
class Watch:
    """Progress and cancellation callbacks of a request.

    Attributes:
        progress: called with the completed fraction, 0 to 1.
        cancelled: polled repeatedly; True stops the request.
    """

    progress: Progress
    cancelled: Cancelled


class Request(Document, frozen=True, kw_only=True, tag_field="edit"):
    """Base of all requests; subclasses override `title` and `carry_out`."""

    @property
    def title(self) -> str:
        """Displayed name of the request."""
        raise NotImplementedError

    def resolve(
        self,
        snapshot: Snapshot,
        *,
        progress: Progress | None = None,
        cancelled: Cancelled | None = None,
    ) -> Outcome:
        """Compute the request on a snapshot, in any thread.

        Args:
            progress: called with the completed fraction, 0 to 1.
            cancelled: polled repeatedly; True stops the request.

        Raises:
            RequestCancelled: `cancelled` returned True.
            ToolkitError: the request fails.
        """
        watch = Watch(progress or (lambda _: None), cancelled or (lambda: False))
        return self.carry_out(snapshot, watch)

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        """See `resolve`."""
        raise NotImplementedError


class ImportMesh(Request, frozen=True, kw_only=True, tag="import_mesh"):
    """Copies a mesh file into the scene and adds it to the library.

    Attributes:
        mesh: path of the file.
        unit: unit of the file: "m", "cm" or "mm"; the stored mesh is in metres.
        category: category such as "mug".
        model: id of the model; default: from the file's name, or from its folder's for names such
            as "textured", with a number if another mesh has that id.
        symmetry: as for the command line: "auto", "axis:z", "fold:z:4", a JSON file; default: the
            `symmetry.json` of `std-scan` beside the mesh, if there is one, else none.
        faces: decimate a mesh of more faces to this number; its texture becomes vertex colours.
    """

    mesh: str
    unit: Literal["m", "cm", "mm"] = "m"
    category: str | None = None
    model: str | None = None
    symmetry: list[str] | None = None
    faces: Annotated[int, msgspec.Meta(ge=4)] | None = None

    @property
    def title(self) -> str:
        return f"Add mesh {Path(self.mesh).name}"

    def carry_out(self, snapshot: Snapshot, watch: Watch) -> Outcome:
        del watch
        return self.import_as(self.model or model_name(Path(self.mesh)), snapshot)

    def import_as(self, name: str, snapshot: Snapshot) -> Outcome:
        """As `resolve`, with another default for the id than the file's name."""
        from std_toolkit.geometry.mesh import load_mesh, mesh_bounds
        from std_toolkit.labels.entry.symmetry_argument import (
            parse_symmetry,
            read_symmetry_file,
            symmetry_proposal,
        )

        if not snapshot.writable:
            raise ToolkitError("the scene is open read-only", path=snapshot.scene.root)
        path = Path(self.mesh).expanduser()
        symmetry = None
        beside = _scanned_symmetry(path) if self.symmetry is None and self.unit == "m" else None
        if beside is not None:
            symmetry = read_symmetry_file(beside)
        if self.symmetry is not None:
            try:
                mesh = load_mesh(path, unit=self.unit)
            except ToolkitError as error:
                raise _plain_hint(error) from error
            centre = mesh_bounds(mesh).mean(axis=0).tolist()
            symmetry = parse_symmetry(self.symmetry, centre=centre, mesh=mesh)
        # Locked, because another process removes temporary files while it writes.
        with scene_lock(snapshot.scene.root):
            try:
                model = copy_model(
                    snapshot.scene.root,
                    known_models(snapshot),
                    path,
                    mesh_unit=self.unit,
                    category=self.category,
                    symmetry=symmetry,
                    model_id=name,
                    number=self.model is None,
                    faces=self.faces,
                )
            except ToolkitError as error:
                raise _plain_hint(error) from error
        size = " x ".join(f"{x * 1000:.1f}" for x in model.size_m)
        line = f"model {model.id}: {size} mm, diameter {model.diameter_m * 1000:.1f} mm"
        report = [line]
        if beside is not None:
            words = symmetry_words(model.symmetry.symmetry())
            report.append(f"symmetry of the scan ({beside.name}): {words}")
        elif model.symmetry == SymmetryModel():
            proposal = symmetry_proposal(load_mesh(snapshot.scene.root / model.mesh))
            if proposal is not None:
                report.append(f"{proposal}: Symmetry... enters it")
        return Outcome(EnterModel(model=model), report)


def _scanned_symmetry(mesh: Path) -> Path | None:
    """The symmetry that `std-scan` wrote beside a mesh; None if the mesh is from elsewhere."""
    found = mesh.parent / "symmetry.json"
    return found if found.is_file() and (mesh.parent / "scan.json").is_file() else None


def known_models(snapshot: Snapshot) -> ObjectTable:
    """Return the models of the state and those added by others meanwhile, to avoid overwriting."""
    own = snapshot.scene.objects
    ids = {m.id for m in own.models}
    others = [m for m in Scene.open(snapshot.scene.root).objects.models if m.id not in ids]
    return ObjectTable(models=[*own.models, *others], objects=own.objects)


def _plain_hint(error: ToolkitError) -> ToolkitError:
    """Replace hints that refer to the command line of `std-curate`."""
    hint = error.hint
    if "large in metres" in error.problem:
        hint = "is the file in millimetres? Then give its unit as mm (or cm)"
    elif "has another mesh" in error.problem:
        hint = "give this one another id"
    return ToolkitError(
        error.problem, path=error.path, field=error.field, value=error.value, hint=hint
    )


def model_name(path: Path) -> str:
    """Return the model id of a mesh file: its name, or its folder's if the name is generic.

    Raises:
        ToolkitError: there is no such file.
    """
    path = path.expanduser()
    if not path.is_file():
        raise ToolkitError("mesh file not found", path=path)
    stem, folder = path.stem, path.resolve().parent.name
    return safe_name(folder if folder and is_generic_name(stem) else stem)


def is_generic_name(stem: str) -> bool:
    """Whether the name of a file, without its suffix, does not name an object: "textured"."""
    words = stem.lower().replace("-", "_").split("_")
    return all(w in _GENERIC or w.isdigit() for w in words)
