"""Dialogs of the program: their questions and the effects of the answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from annotator.app import label_questions, mesh_import, operations, pose_checks, questions
from annotator.app.action_table import key_rows
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.mesh_folder import MeshFolder, remember_folder
from annotator.app.mesh_import import MeshSize, NewMesh, measure_mesh
from annotator.app.verdicts import doubtful_objects
from annotator.session import ChangeObject, SetSymmetry
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES
from std_toolkit.geometry.symmetry import symmetry_words
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.project.nearby import nearby_scenes

if TYPE_CHECKING:
    from std_toolkit.scene.model import SymmetryModel

# A mesh with more faces than this may be decimated to fewer when it is added.
MANY_FACES, FEWER_FACES = 200_000, 50_000


class Dialogs:
    """Shows one question at a time.

    Args:
        controller: changed by the answers; its `dialogs` are set to the available ones.
        show: shows a question, or closes it (None); a front end may answer before it returns.
        own: dialogs implemented by the front end, by name.
        drawn_by: name of the renderer, for defect reports.
    """

    def __init__(
        self,
        controller: Controller,
        show: Callable[[questions.Question | None], None],
        *,
        own: Mapping[str, Callable[[], object]] | None = None,
        drawn_by: Callable[[], str] = lambda: "",
    ) -> None:
        self._c = controller
        self._show = show
        self._drawn_by = drawn_by
        self._open: questions.Question | None = None
        self._dialogs: dict[str, Callable[[], object]] = {
            "add_mesh": self._add_mesh,
            "place_mesh": self._place_mesh,
            "propagate": self._propagate,
            "carry": self._carry,
            "rename": self._rename,
            "note": self._note,
            "symmetry": self._symmetry,
            pose_checks.DOUBT: self._done_anyway,
            "conflict": self._conflict,
            "shortcuts": self._shortcuts,
            "about": self._about,
            **(own or {}),
        }
        controller.dialogs = frozenset(self._dialogs)

    def ask(self, name: str) -> None:
        """Open a dialog; does not replace a question that must be answered."""
        if name in self._dialogs and not (self._open is not None and self._open.must_answer):
            self._dialogs[name]()

    def answer(self, number: int, pressed: str, answers: questions.Answers) -> None:
        """Handle a pressed button of a question; "" is cancel.

        Args:
            number: of the question; ignored if another page has already answered it.
        """
        question = self._open
        if question is None or question.number != number:
            return
        if question.must_answer and not pressed:
            return
        self._open = None
        self._show(None)
        self._c.attempt(lambda: question.answer(pressed, answers))

    def put(self, question: questions.Question) -> None:
        """Show a question in place of another one."""
        self._open = question
        self._show(question)

    # --- meshes -----------------------------------------------------------------------------------

    def _add_mesh(self) -> None:
        def react(_: str, answers: questions.Answers) -> None:
            if answers["path"]:
                self.add_meshes([Path(answers["path"]).expanduser()])

        kinds = ", ".join(s.lstrip(".").upper() for s in MESH_SUFFIXES)
        self.put(
            questions.Question(
                "Add a mesh",
                react,
                text="The file is read on the machine that std-annotate runs on, and copied into "
                "the scene with its textures. The meshes of a folder are listed in the library and "
                "copied when they are placed.",
                fields=(questions.Field("path", f"File on the server ({kinds}), or folder"),),
                buttons=(questions.Button("add", "Add"), questions.CANCEL),
            )
        )

    def add_meshes(self, paths: Sequence[Path]) -> None:
        """Add mesh files to the library; a folder becomes the folder of meshes.

        Asks for the unit if metres are implausible, and whether to decimate many faces.
        """
        for folder in (path for path in paths if path.is_dir()):
            self._c.attempt(lambda folder=folder: self._set_folder(folder))  # type: ignore[misc]
        self._measure([NewMesh(path) for path in paths if not path.is_dir()])

    def _set_folder(self, path: Path) -> None:
        folder = MeshFolder.read(path)
        remember_folder(folder)
        self._c.mesh_folder = folder
        self._c.emit(Event("library"))
        count = "1 mesh" if len(folder.meshes) == 1 else f"{len(folder.meshes)} meshes"
        self._c.tell(f"The library shows {count} of {folder.path}.")

    def _place_mesh(self) -> None:
        wanted, self._c.mesh_to_place = self._c.mesh_to_place, None
        if wanted is not None:
            new = NewMesh(wanted.mesh.path, name=wanted.mesh.name)
            self._measure([new], lambda models: wanted.place(models[0]))

    def _measure(
        self, meshes: Sequence[NewMesh], then: Callable[[list[str]], object] = lambda _: None
    ) -> None:
        """Read meshes, ask about them, add them, then call `then` with the ids of the models."""

        def measure(_: object) -> list[tuple[NewMesh, MeshSize | ToolkitError]]:
            found: list[tuple[NewMesh, MeshSize | ToolkitError]] = []
            for mesh in meshes:
                try:
                    found.append((mesh, measure_mesh(mesh.path)))
                except ToolkitError as error:
                    found.append((mesh, error))
            return found

        def finish(found: list[tuple[NewMesh, MeshSize | ToolkitError]]) -> None:
            for _, size in found:
                if isinstance(size, ToolkitError):
                    self._c.tell(str(size), "error")
            self._ask_units([(m, s) for m, s in found if isinstance(s, MeshSize)], [], then)

        if meshes:
            names = ", ".join(mesh.path.name for mesh in meshes[:3])
            self._c.start(f"Read {names}", measure, finish, beside=True)

    def _ask_units(
        self,
        waiting: Sequence[tuple[NewMesh, MeshSize]],
        known: Sequence[NewMesh],
        then: Callable[[list[str]], object],
    ) -> None:
        """Ask about meshes one by one, then import them all as one edit."""
        if not waiting:
            if known:
                mesh_import.import_meshes(self._c, known, then)
            return
        (mesh, size), *rest = waiting
        name = mesh.name or mesh.path.name

        def skip() -> None:
            self._ask_units(rest, known, then)

        def react(unit: str, _: object = None) -> None:
            new = replace(mesh, unit=next(u for u in size.units if u == unit))

            def decide(pressed: str, _: object = None) -> None:
                faces = FEWER_FACES if pressed == "fewer" else None
                self._ask_units(rest, [*known, replace(new, faces=faces)], then)

            if size.faces > MANY_FACES:
                self.put(mesh_import.decimate_question(name, size, FEWER_FACES, decide, skip))
            else:
                decide("keep")

        if size.units == ("m",):
            react("m")
        else:
            self.put(mesh_import.unit_question(name, size, react, skip))

    def _done_anyway(self) -> None:
        name = self._c.selected
        doubts = [] if name is None else doubtful_objects(self._c, [name])

        def react(pressed: str, _: questions.Answers) -> None:
            if pressed == "done" and self._c.selected == name:
                self._c.mark("done", anyway=True)

        if doubts:
            self.put(label_questions.doubt_question(doubts, react))

    # --- the labels -------------------------------------------------------------------------------

    def _doubts(self) -> list[tuple[str, str]]:
        c = self._c
        return doubtful_objects(c, [o.name for o in c.session.state.objects if o.placements])

    def _propagate(self) -> None:
        def react(_: str, answers: questions.Answers) -> None:
            operations.propagate(self._c, label_questions.propagate_options(answers))

        self.put(label_questions.propagate_question(self._c.session, self._doubts(), react))

    def _carry(self) -> None:
        def react(_: str, answers: questions.Answers) -> None:
            operations.carry_over(self._c, label_questions.carry_request(answers))

        scene = self._c.session.snapshot().scene
        self.put(label_questions.carry_question(nearby_scenes(scene.root, scene.objects), react))

    def _conflict(self) -> None:
        def react(pressed: str, _: questions.Answers) -> None:
            operations.save(self._c, on_conflict="mine" if pressed == "mine" else "theirs")

        self.put(questions.conflict_question(self._c.conflict, react))

    def recovery(self) -> None:
        """Ask what to do with the recoverable edits of an earlier session."""
        session = self._c.session

        def react(pressed: str, _: questions.Answers) -> None:
            # Another page may have answered already.
            if session.recovery is not None:
                session.recover() if pressed == "recover" else session.discard_recovery()

        if session.recovery is not None:
            self.put(questions.recovery_question(session.recovery, react, can_leave=False))

    # --- the selected object ----------------------------------------------------------------------

    def _rename(self) -> None:
        old = self._c.selected
        if old is None:
            return

        def react(_: str, answers: questions.Answers) -> None:
            name = answers["name"]
            if name not in ("", old) and self._c.apply(ChangeObject(object=old, name=name)):
                self._c.select(name)

        self.put(
            questions.Question(
                f"Rename {old}",
                react,
                fields=(questions.Field("name", "New name", value=old),),
                buttons=(questions.Button("rename", "Rename"), questions.CANCEL),
            )
        )

    def _note(self) -> None:
        name = self._c.selected
        if name is None:
            return
        old = self._c.session.object(name).note

        def react(_: str, answers: questions.Answers) -> None:
            if answers["note"] != old:
                self._c.apply(ChangeObject(object=name, note=answers["note"]))

        self.put(
            questions.Question(
                f"Note on {name}",
                react,
                fields=(questions.Field("note", "What to look at again", kind="lines", value=old),),
                buttons=(questions.Button("keep", "Keep"), questions.CANCEL),
            )
        )

    def _symmetry(self) -> None:
        if self._c.selected is None:
            return
        model = self._c.session.state.model_of(self._c.selected)

        def react(_: str, answers: questions.Answers) -> None:
            words = questions.symmetry_words(answers)
            if words is not None:
                centre = self._c.session.centre(model.id).tolist()
                if words != ["auto"]:
                    enter(parse_symmetry(words, centre=centre))
                    return
                mesh = self._c.session.mesh(model.id)
                self._c.start(
                    f"Find the symmetry of {model.id}",
                    lambda _: parse_symmetry(words, centre=centre, mesh=mesh),
                    found,
                    beside=True,
                )

        def found(symmetry: SymmetryModel) -> None:
            enter(symmetry)
            self._c.tell(f"{model.id}: {symmetry_words(symmetry.symmetry())}")

        def enter(symmetry: SymmetryModel) -> None:
            if symmetry != model.symmetry:
                self._c.apply(SetSymmetry(model=model.id, symmetry=symmetry))

        self.put(questions.symmetry_question(model, react))

    def ask_pose(self, frames: str, paste: Callable[[str], object]) -> None:
        """Ask for a pose as text, for front ends that cannot read the clipboard.

        Args:
            frames: text on the source and target coordinate frames.
            paste: called with the text.
        """
        self.put(
            questions.Question(
                "Paste a pose",
                lambda _, answers: paste(answers["matrix"]),
                fields=(questions.Field("matrix", f"4x4 matrix, {frames}, metres", kind="lines"),),
                buttons=(questions.Button("set", "Set"), questions.CANCEL),
            )
        )

    # --- help -------------------------------------------------------------------------------------

    def _shortcuts(self) -> None:
        groups = key_rows(self._c.dialogs)
        self.put(questions.Question("Keys and mouse", groups=groups, searchable=True))

    def _about(self) -> None:
        drawn_by = self._drawn_by()
        text = (
            f"Version {__version__}\n\nAligns the CAD meshes of objects to a recorded scene. "
            "Guides: docs/annotating.md, and docs/annotating-web.md for the browser."
        )
        if drawn_by:
            text += f"\n\nViews are drawn by {drawn_by}."
        self.put(questions.Question("std-annotate", text=text))
