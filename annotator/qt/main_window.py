"""Main window with the start page or an open scene, and the Qt runner of computations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from PySide6.QtCore import QEventLoop, QObject, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QApplication, QFileDialog, QMainWindow

from annotator.app import (
    events,
    image_cache,
    mesh_folder,
    operations,
    questions,
    tasks,
    view_options,
)
from annotator.app.controller import Controller
from annotator.qt import commands, graphics, question_dialog, settings, start_page
from annotator.session import Session
from annotator.session.session import user_name
from annotator.startup import quick_imports
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from annotator.qt.board_panel import BoardPage
    from annotator.qt.workspace import Workspace
    from std_toolkit.project.record import Project

Recover = Literal["ask", "yes", "no"]

SMALLEST = (960, 600)

USUAL = (1440, 900)


class Shell(QMainWindow):
    """Main window for one scene at a time.

    Args:
        annotator: name of the annotator; default: the user of this computer.
        meshes: folder whose meshes are in the library of every scene.
        project: whose board is shown in place of the start page.
    """

    def __init__(
        self,
        *,
        annotator: str | None = None,
        meshes: mesh_folder.MeshFolder | None = None,
        project: Project | None = None,
    ) -> None:
        super().__init__()
        self._project = project
        self._board_runner = QtRunner()
        self._meshes = meshes
        self._annotator = annotator
        self.workspace: Workspace | None = None
        self.controller: Controller | None = None
        self.start_page: start_page.StartPage | BoardPage | None = None
        self._runner: QtRunner | None = None
        graphics.prepare_window(self)
        self.setMinimumSize(*SMALLEST)
        if not settings.restore_window(self):
            screen = QApplication.primaryScreen().availableSize()
            self.resize(min(USUAL[0], screen.width()), min(USUAL[1], screen.height()))
        app = QApplication.instance()
        assert isinstance(app, QApplication)
        self._typing = commands.TypingGuard(app)
        self.show_start_page()

    # --- opening ---------------------------------------------------------------------------------

    def open_scene(
        self,
        root: Path | str,
        *,
        read_only: bool = False,
        recover: Recover = "ask",
        take_over: bool = False,
    ) -> bool:
        """Open a scene in place of the current content; False if it was not opened.

        The start page shows errors.
        """
        if not self.leave_scene():
            return False
        root = Path(root)
        try:
            session = Session.open(
                root,
                annotator=self._annotator,
                recover=recover,
                read_only=read_only,
                take_over=take_over,
            )
            try:
                if session.recovery is not None and not self._decide_recovery(session):
                    session.close()
                    self.show_start_page()
                    return False
                self._show_scene(session)
            except BaseException:
                session.close()
                raise
        except ToolkitError as error:
            self.show_start_page(error, root)
            return False
        if session.writable:
            settings.remember_scene(root)
        return True

    def browse(self) -> None:
        """Select a scene folder in a file dialog."""
        folder = QFileDialog.getExistingDirectory(self, "Open scene folder")
        if folder:
            self.open_scene(folder)

    def show_start_page(
        self, problem: ToolkitError | None = None, tried: Path | None = None
    ) -> None:
        """Show the start page."""
        if self.start_page is None:
            if self._project is None:
                self.start_page = start_page.StartPage()
                self.start_page.browse.connect(self.browse)
            else:
                from annotator.qt.board_panel import BoardPage

                who = user_name() if self._annotator is None else self._annotator
                self.start_page = BoardPage(self._project, who, self._board_runner)
            self.start_page.chosen.connect(
                lambda root, look, take: self.open_scene(root, read_only=look, take_over=take)
            )
            self.setCentralWidget(self.start_page)
        self.menuBar().clear()
        name = "" if self._project is None else f"{self._project.record.name} · "
        self.setWindowTitle(f"{name}std-annotate")
        self.start_page.refresh(problem, tried)

    def _decide_recovery(self, session: Session) -> bool:
        """Ask about unsaved edits of an earlier session; False to not open the scene."""
        assert session.recovery is not None
        answer, _ = question_dialog.QuestionDialog(
            self, questions.recovery_question(session.recovery)
        ).ask()
        if answer == "recover":
            session.recover()
        elif answer == "discard":
            session.discard_recovery()
        return answer != ""

    def _show_scene(self, session: Session) -> None:
        frames = view_options.choose_view_frames(session.scene, session)
        images = image_cache.ImageCache(session.scene)
        self._show_first_image(session, images, frames[0])
        images.prefetch(frames[1:])  # decoded while the window is built
        # 3D libraries are loaded after the first image is shown.
        with quick_imports():
            from annotator.qt.workspace import Workspace

        self._runner = QtRunner()
        self.controller = Controller(session, images, runner=self._runner, view_frames=frames)
        self.controller.mesh_folder = self._meshes
        objects = session.state.objects
        if objects:
            self.controller.select(objects[0].name)
        self.workspace = Workspace(self, self.controller)
        self.setCentralWidget(self.workspace)
        dialogs = question_dialog.WindowDialogs(
            self.workspace,
            self.controller,
            {
                "open": self.browse,
                "close": self.close_soon,
                "panels": self.workspace.next_field,
            },
        )
        self.workspace.files_dropped.connect(dialogs.add_meshes)
        who = f" · {session.annotator}" if session.annotator else ""
        how = "" if session.writable else " · read-only"
        self.setWindowTitle(f"{session.scene.info.name}{who}{how} · std-annotate[*]")
        self.controller.subscribe(self._on_event)
        self.workspace.start()
        operations.tell_opening(self.controller)

    def _show_first_image(
        self, session: Session, images: image_cache.ImageCache, frame: int
    ) -> None:
        try:
            rgb = images.image(frame).rgb
        except ToolkitError:
            rgb = None  # reported in the view
        self.start_page = None
        self.setCentralWidget(start_page.OpeningPage(session.scene.info.name, rgb))
        QApplication.processEvents(QEventLoop.ProcessEventsFlag.ExcludeUserInputEvents)

    def _on_event(self, event: events.Event) -> None:
        if event.kind == "library" and self.controller is not None:
            self._meshes = self.controller.mesh_folder  # also for the next scene
        if event.kind in ("edited", "saved") and self.controller is not None:
            self.setWindowModified(self.controller.session.unsaved)

    # --- closing ---------------------------------------------------------------------------------

    def leave_scene(self) -> bool:
        """Close the open scene; False if the user cancels.

        No edit is lost: unsaved edits stay in the journal.
        """
        if self.controller is None or self.workspace is None:
            return True
        controller, session = self.controller, self.controller.session
        if controller.task is not None and controller.task.alone:
            controller.tell(f"{controller.task.title}: wait until it is done.", "warning")
            return False
        controller.cancel_drag()
        if session.writable and session.unsaved:
            answer, _ = question_dialog.QuestionDialog(
                self, questions.closing_question(len(session.steps))
            ).ask()
            if not answer or (answer == "save" and not operations.save(controller)):
                return False
        if controller.task is not None:
            controller.task.cancel()
        workspace = self.workspace
        workspace.close_panel()
        if self._runner is not None:
            self._runner.close(timeout=2.0)
        controller.images.close()
        session.close()
        self.workspace = self.controller = self._runner = None
        self.takeCentralWidget()
        workspace.deleteLater()
        return True

    def closeEvent(self, event: QCloseEvent) -> None:
        if self.leave_scene():
            self._board_runner.close(timeout=2.0)
            event.accept()
        else:
            event.ignore()

    def tell_trouble(self, text: str) -> None:
        """Show an unexpected error in the window."""
        if self.controller is not None:
            self.controller.tell(text, "error")
        elif self.start_page is not None:
            self.start_page.refresh(ToolkitError(text))

    def close_soon(self) -> None:
        """Close after the current event, such as that of the menu entry; a project's scene leads
        back to its board."""
        QTimer.singleShot(0, self, self.close if self._project is None else self._back)

    def _back(self) -> None:
        if self.leave_scene():
            self.show_start_page()


class _Postman(QObject):
    """Calls functions in the thread that created it; thread-safe."""

    _handed_in = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self._handed_in.connect(self._call, Qt.ConnectionType.QueuedConnection)

    @Slot(object)
    def _call(self, call: Callable[[], None]) -> None:
        call()

    def deliver(self, call: Callable[[], None]) -> None:
        self._handed_in.emit(call)


class QtRunner(tasks.ThreadRunner):
    """Delivers results in the thread that created it, through its event loop."""

    def __init__(self) -> None:
        self._postman = _Postman()
        super().__init__(self._postman.deliver)
