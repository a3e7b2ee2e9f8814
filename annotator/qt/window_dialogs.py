"""The dialogs that actions ask for, and what becomes of their answers.

All keys and what the mouse does, made from the table of actions.

What this program is.

The unit of a mesh file, asked where metres cannot be meant.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtWidgets import (
    QDialog,
    QFileDialog,
    QHBoxLayout,
    QInputDialog,
    QLabel,
    QLineEdit,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from annotator.app import operations
from annotator.app.action import MOUSE, Action
from annotator.app.action_table import ACTIONS, MENUS
from annotator.app.controller import Controller
from annotator.app.events import Event
from annotator.app.questions import MeshSize, Unit, measure_mesh
from annotator.qt import theme
from annotator.qt.graphics import renderer_name
from annotator.qt.question_dialog import (
    Answer,
    PropagateDialog,
    Question,
    SymmetryDialog,
    conflict_question,
)
from annotator.session import ChangeObject, SetSymmetry
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES

if TYPE_CHECKING:
    from annotator.qt.main_window import Shell
    from annotator.qt.workspace import Workspace

_COLUMNS = 3

_NAMES: dict[Unit, str] = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}


class WindowDialogs(QObject):
    """Opens dialogs for one workspace."""

    def __init__(self, shell: Shell, workspace: Workspace, controller: Controller) -> None:
        super().__init__(workspace)
        self._shell = shell
        self._controller = controller
        self.dialogs: dict[str, Callable[[], object]] = {
            "open": shell.browse,
            "close": shell.close_soon,
            "add_mesh": self.browse_meshes,
            "propagate": self.propagate,
            "rename": self.rename,
            "note": self.write_note,
            "symmetry": self.set_symmetry,
            "shortcuts": self.show_shortcuts,
            "about": lambda: about_box(shell).ask(),
            "conflict": self.resolve_conflict,
        }
        workspace.library.files_dropped.connect(self.add_meshes)
        for tile in workspace.views.tiles:
            tile.view.files_dropped.connect(self.add_meshes)
        controller.dialogs = frozenset(self.dialogs)
        controller.subscribe(self._on_event)

    def _on_event(self, event: Event) -> None:
        if event.kind == "ask" and event.text in self.dialogs:
            self.dialogs[event.text]()

    # --- saving ----------------------------------------------------------------------------------

    def save(self) -> bool:
        """Save, and ask whose version to keep where others changed the same."""
        return operations.save(self._controller)

    def resolve_conflict(self) -> None:
        """Others changed the same objects: ask whose version to keep, and save again."""
        answer = conflict_question(self._shell, self._controller.conflict).ask()
        if answer in ("mine", "theirs"):
            operations.save(self._controller, on_conflict="mine" if answer == "mine" else "theirs")

    def propagate(self) -> None:
        options = PropagateDialog(self._shell, self._controller).ask()
        if options is not None:
            operations.propagate(self._controller, options)

    # --- meshes ----------------------------------------------------------------------------------

    def browse_meshes(self) -> None:
        """Choose mesh files and add them to the library."""
        kinds = " ".join(f"*{s}" for s in MESH_SUFFIXES)
        names, _ = QFileDialog.getOpenFileNames(self._shell, "Add mesh", "", f"Meshes ({kinds})")
        self.add_meshes([Path(n) for n in names])

    def add_meshes(self, paths: list[Path]) -> None:
        """Add mesh files to the library; asks for the unit where metres cannot be meant."""
        files: list[tuple[Path, operations.Unit]] = []
        for path in paths:
            try:
                unit = ask_unit(self._shell, path)
            except ToolkitError as error:
                self._controller.tell(str(error), "error")
            else:
                files += [] if unit is None else [(path, unit)]
        if files:
            operations.import_meshes(self._controller, files)

    # --- the selected object ---------------------------------------------------------------------

    def rename(self) -> None:
        c = self._controller
        if c.selected is not None:
            name, given = QInputDialog.getText(
                self._shell, "Rename", f"New name of {c.selected}:", text=c.selected
            )
            if given and name.strip() and name.strip() != c.selected:
                old = c.selected
                if c.apply(ChangeObject(object=old, name=name.strip())):
                    c.select(name.strip())

    def write_note(self) -> None:
        c = self._controller
        if c.selected is not None:
            old = c.session.object(c.selected).note
            note, given = QInputDialog.getMultiLineText(
                self._shell, "Note", f"What is to be looked at again of {c.selected}?", old
            )
            if given and note.strip() != old:
                c.apply(ChangeObject(object=c.selected, note=note.strip()))

    def set_symmetry(self) -> None:
        c = self._controller
        if c.selected is not None:
            model = c.session.state.model_of(c.selected)
            symmetry = SymmetryDialog(self._shell, c, model).ask()
            if symmetry is not None and symmetry != model.symmetry:
                c.apply(SetSymmetry(model=model.id, symmetry=symmetry))

    def show_shortcuts(self) -> None:
        sheet = ShortcutSheet(self._shell)
        sheet.show()


class ShortcutSheet(QDialog):
    """A sheet that stays open beside the work, with a field to search it."""

    def __init__(self, parent: QWidget | None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Keys and mouse")
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.search = QLineEdit()
        self.search.setPlaceholderText("Search")
        self.search.setClearButtonEnabled(True)
        self.search.textChanged.connect(self._show)
        self.columns = [QLabel() for _ in range(_COLUMNS)]
        row = QHBoxLayout()
        row.setSpacing(28)
        for column in self.columns:
            column.setTextFormat(Qt.TextFormat.RichText)
            column.setAlignment(Qt.AlignmentFlag.AlignTop)
            column.setWordWrap(True)
            row.addWidget(column, 1)
        body = QWidget()
        body.setLayout(row)
        scroll = QScrollArea()
        scroll.setWidget(body)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QScrollArea.Shape.NoFrame)
        layout = QVBoxLayout(self)
        layout.addWidget(self.search)
        layout.addWidget(scroll, 1)
        self.resize(1180, 720)
        self._show("")

    def rows(self, wanted: str = "") -> dict[str, list[tuple[str, str]]]:
        """Keys (or gestures) and what they do, by menu; those that hold `wanted`."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for menu in MENUS:
            items = [a for a in ACTIONS if a.menu == menu and a.keys]
            groups[menu] = [(keys_of(a), a.title) for a in items]
        groups["Mouse"] = [(m.gesture, m.effect) for m in MOUSE]
        wanted = wanted.lower()
        return {
            name: found
            for name, rows in groups.items()
            if (found := [r for r in rows if wanted in f"{r[0]} {r[1]}".lower()])
        }

    def _show(self, wanted: str) -> None:
        groups = self.rows(wanted)
        # Columns of about the same height, groups kept whole and in order.
        total = sum(len(rows) + 2 for rows in groups.values())
        texts = [""] * _COLUMNS
        filled, at = 0, 0
        for name, rows in groups.items():
            if filled + (len(rows) + 2) / 2 > (at + 1) * total / _COLUMNS and at < _COLUMNS - 1:
                at += 1
            texts[at] += _table(name, rows)
            filled += len(rows) + 2
        for column, text in zip(self.columns, texts, strict=True):
            column.setText(text)


def keys_of(action: Action) -> str:
    """Its keys as the system writes them."""
    native = QKeySequence.SequenceFormat.NativeText
    return " or ".join(QKeySequence(k).toString(native) for k in action.keys)


def _table(name: str, rows: list[tuple[str, str]]) -> str:
    cells = "".join(
        f"<tr><td style='color:{theme.ACCENT}; padding:1px 12px 1px 0; white-space:nowrap'>"
        f"{_escaped(key)}</td><td style='padding:1px 0'>{_escaped(what)}</td></tr>"
        for key, what in rows
    )
    return f"<p style='margin:10px 0 2px 0'><b>{name}</b></p><table>{cells}</table>"


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")


def about_box(parent: QWidget | None) -> Question:
    """Version, guide, and what draws the views."""
    text = (
        f"Version {__version__}\n\n"
        "Aligns the CAD meshes of objects to a recorded scene. The guide is docs/annotating.md.\n\n"
        f"Views are drawn by {renderer_name() or 'an unknown renderer'}."
    )
    return Question(parent, "std-annotate", text, [Answer("close", "Close")])


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
