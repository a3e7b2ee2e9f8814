"""The dialogs of the program: which question is asked, and what its answers do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from annotator.app import operations
from annotator.app.action_table import key_rows
from annotator.app.controller import Controller
from annotator.app.questions import (
    CANCEL,
    Answers,
    Field,
    MeshSize,
    Question,
    button,
    measure_mesh,
    propagation_text,
    symmetry_question,
    symmetry_words,
    whole_number,
)
from annotator.session import ChangeObject, SetSymmetry
from std_toolkit import __version__
from std_toolkit.geometry.mesh import MESH_SUFFIXES
from std_toolkit.labels.propagate import PropagateOptions
from std_toolkit.labels.symmetry_argument import parse_symmetry

_UNITS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}


class Dialogs:
    """Shows one question at a time.

    Args:
        show: hands a question (or None) to the page.
        controller: what the answers change.
    """

    def __init__(self, controller: Controller, show: Callable[[Question | None], None]) -> None:
        self._c = controller
        self._show = show
        self._open: Question | None = None
        self._questions: dict[str, Callable[[], None]] = {
            "add_mesh": self._add_mesh,
            "propagate": self._propagate,
            "rename": self._rename,
            "note": self._note,
            "symmetry": self._symmetry,
            "conflict": self._conflict,
            "shortcuts": self._shortcuts,
            "about": self._about,
        }

    @property
    def names(self) -> frozenset[str]:
        """Dialogs that this page has."""
        return frozenset(self._questions)

    def ask(self, name: str) -> None:
        # One that must be answered is not pushed aside by a key.
        if name in self._questions and not (self._open is not None and self._open.must):
            self._questions[name]()

    def answer(self, number: int, pressed: str, answers: Answers) -> None:
        """A button of a question was pressed; "" is cancel.

        Args:
            number: of the question: another page may have answered it already.
        """
        question = self._open
        if question is None or question.number != number or (question.must and not pressed):
            return
        self._open = None
        self._show(None)
        if pressed:
            self._c.attempt(lambda: question.react(pressed, answers))

    def _ask(self, question: Question) -> None:
        self._open = question
        self._show(question)

    # --- the questions ----------------------------------------------------------------------------

    def _add_mesh(self) -> None:
        kinds = ", ".join(s.lstrip(".").upper() for s in MESH_SUFFIXES)

        def react(_: str, answers: Answers) -> None:
            path = str(answers.get("path", "")).strip()
            if path:
                self.add_mesh(Path(path).expanduser())

        self._ask(
            Question(
                "Add a mesh",
                react,
                text="The file is read on the machine that std-annotate runs on, and copied into "
                "the scene with its textures.",
                fields=[Field("path", f"File on the server ({kinds})")],
                buttons=[button("add", "Add"), CANCEL],
            )
        )

    def add_mesh(self, path: Path) -> None:
        """Add a mesh file of the server; asks for the unit where metres cannot be meant."""

        def finish(size: MeshSize) -> None:
            if size.units == ("m",):
                operations.import_meshes(self._c, [(path, "m")])
            else:
                self._ask(self._unit_question(path, size))

        self._c.start(f"Read {path.name}", lambda _: measure_mesh(path), finish)

    def _unit_question(self, path: Path, size: MeshSize) -> Question:
        def react(unit: str, _: Answers) -> None:
            operations.import_meshes(self._c, [(path, u) for u in size.units if u == unit])

        numbers = " × ".join(f"{x:.4g}" for x in size.extents)
        lines = [
            f"In metres the mesh would be {numbers} m large, which no object on a table is. "
            "Scenes hold meshes in metres: in which unit is this file?",
            "",
        ]
        for unit in size.units:
            extent = " × ".join(f"{x:.4g}" for x in size.in_mm(unit))
            lines.append(f"As {_UNITS[unit]} it is {extent} mm.")
        return Question(
            f"{path.name} is not in metres",
            react,
            text="\n".join(lines),
            buttons=[*(button(u, f"It is in {_UNITS[u]}") for u in size.units), CANCEL],
        )

    def _propagate(self) -> None:
        session = self._c.session
        text = propagation_text(session)

        def react(_: str, answers: Answers) -> None:
            refine = bool(answers.get("refine"))
            options = PropagateOptions(
                refine=refine,
                refine_scale=refine and bool(answers.get("scale")),
                use_depth=bool(answers.get("depth", True)),
                keyframes=min(max(whole_number(answers, "keyframes"), 2), 200),
            )
            operations.propagate(self._c, options)

        refining = ("refine", True)
        self._ask(
            Question(
                "Save and propagate",
                react,
                text=text,
                fields=[
                    Field(
                        "refine",
                        "Adjust each pose to several frames at once (takes minutes)",
                        kind="switch",
                        value=False,
                    ),
                    Field(
                        "scale",
                        "Estimate the scale of the camera poses as well (rewrites poses.json)",
                        kind="switch",
                        value=False,
                        when=refining,
                    ),
                    Field(
                        "depth",
                        "Use the sensor depth on raw and diffuse objects",
                        kind="switch",
                        value=True,
                        when=refining,
                    ),
                    Field(
                        "keyframes", "Adjust to so many frames", kind="number", value=10,
                        when=refining,
                    ),
                ],
                buttons=[button("go", "Save and propagate"), CANCEL],
            )
        )  # fmt: skip

    def _rename(self) -> None:
        old = self._c.selected
        if old is None:
            return

        def react(_: str, answers: Answers) -> None:
            name = str(answers.get("name", "")).strip()
            renamed = name not in ("", old) and self._c.apply(ChangeObject(object=old, name=name))
            if renamed:
                self._c.select(name)

        self._ask(
            Question(
                f"Rename {old}",
                react,
                fields=[Field("name", "New name", value=old)],
                buttons=[button("rename", "Rename"), CANCEL],
            )
        )

    def _note(self) -> None:
        name = self._c.selected
        if name is None:
            return
        old = self._c.session.object(name).note

        def react(_: str, answers: Answers) -> None:
            note = str(answers.get("note", "")).strip()
            if note != old:
                self._c.apply(ChangeObject(object=name, note=note))

        self._ask(
            Question(
                f"Note on {name}",
                react,
                fields=[Field("note", "What is to be looked at again?", kind="lines", value=old)],
                buttons=[button("keep", "Keep"), CANCEL],
            )
        )

    def _symmetry(self) -> None:
        if self._c.selected is None:
            return
        model = self._c.session.state.model_of(self._c.selected)

        def react(_: str, answers: Answers) -> None:
            words = symmetry_words(answers)
            if words is not None:
                centre = self._c.session.centre(model.id).tolist()
                symmetry = parse_symmetry(words, centre=centre)
                if symmetry != model.symmetry:
                    self._c.apply(SetSymmetry(model=model.id, symmetry=symmetry))

        self._ask(symmetry_question(model, react))

    def _conflict(self) -> None:
        def react(pressed: str, _: Answers) -> None:
            operations.save(self._c, on_conflict="mine" if pressed == "mine" else "theirs")

        self._ask(
            Question(
                "Others changed the same objects",
                react,
                text=f"While you edited them, another program or person wrote these into the "
                f"scene: {self._c.conflict}.\n\nWhose version shall be saved? Everything else is "
                "kept from both, and what you give up can be brought back by undo.",
                buttons=[button("mine", "Keep mine"), button("theirs", "Keep theirs"), CANCEL],
            )
        )

    def _shortcuts(self) -> None:
        self._ask(
            Question(
                "Keys and mouse",
                lambda *_: None,
                groups=key_rows(),
                buttons=[button("close", "Close")],
            )
        )

    def _about(self) -> None:
        self._ask(
            Question(
                "std-annotate",
                lambda *_: None,
                text=f"Version {__version__}\n\nAligns the CAD meshes of objects to a recorded "
                "scene. The guide is docs/annotating.md; docs/annotating-web.md tells what is "
                "different in a browser.",
                buttons=[button("close", "Close")],
            )
        )

    def recovery(self) -> None:
        """Edits of an earlier session were found: what shall become of them?"""
        session = self._c.session
        found = session.recovery
        if found is None:
            return
        buttons = [button("discard", "Discard (their journal is kept aside)")]
        text = f"{found}.\n\n"
        if found.problem:
            text += "Their journal is kept aside."
        else:
            buttons.insert(0, button("recover", "Recover"))
            text += "Bring them back? Undo and redo will work as before."

        def react(pressed: str, _: Answers) -> None:
            # In another page it may have been decided already.
            if session.recovery is not None:
                session.recover() if pressed == "recover" else session.discard_recovery()

        self._ask(Question("Edits were not saved", react, text=text, buttons=buttons, must=True))
