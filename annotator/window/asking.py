"""The dialogs that actions ask for, and what becomes of their answers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QFileDialog, QInputDialog

from annotator.desk import alignment
from annotator.desk.controller import Controller
from annotator.desk.events import Event
from annotator.session import ChangeObject, SetSymmetry
from annotator.window.dialogs.about import about_box
from annotator.window.dialogs.mesh_unit import ask_unit
from annotator.window.dialogs.propagate import PropagateDialog
from annotator.window.dialogs.saving import conflict_question
from annotator.window.dialogs.shortcuts import ShortcutSheet
from annotator.window.dialogs.symmetry import SymmetryDialog
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import MESH_SUFFIXES

if TYPE_CHECKING:
    from annotator.window.shell import Shell
    from annotator.window.workspace import Workspace


class Asking(QObject):
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
        return alignment.save(self._controller)

    def resolve_conflict(self) -> None:
        """Others changed the same objects: ask whose version to keep, and save again."""
        answer = conflict_question(self._shell, self._controller.conflict).ask()
        if answer in ("mine", "theirs"):
            alignment.save(self._controller, on_conflict="mine" if answer == "mine" else "theirs")

    def propagate(self) -> None:
        options = PropagateDialog(self._shell, self._controller).ask()
        if options is not None:
            alignment.propagate(self._controller, options)

    # --- meshes ----------------------------------------------------------------------------------

    def browse_meshes(self) -> None:
        """Choose mesh files and add them to the library."""
        kinds = " ".join(f"*{s}" for s in MESH_SUFFIXES)
        names, _ = QFileDialog.getOpenFileNames(self._shell, "Add mesh", "", f"Meshes ({kinds})")
        self.add_meshes([Path(n) for n in names])

    def add_meshes(self, paths: list[Path]) -> None:
        """Add mesh files to the library; asks for the unit where metres cannot be meant."""
        files: list[tuple[Path, alignment.Unit]] = []
        for path in paths:
            try:
                unit = ask_unit(self._shell, path)
            except ToolkitError as error:
                self._controller.tell(str(error), "error")
            else:
                files += [] if unit is None else [(path, unit)]
        if files:
            alignment.import_meshes(self._controller, files)

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
