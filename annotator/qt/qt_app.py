"""Entry point of the Qt window of `std-annotate SCENE`."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

# pyvistaqt must use the same Qt binding as this package.
os.environ.setdefault("QT_API", "pyside6")

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication

from annotator.app.mesh_folder import choose_folder
from annotator.options import AnnotateOptions
from annotator.qt.graphics import set_surface_format
from annotator.qt.settings import remembered_look
from annotator.qt.theme import apply_theme
from annotator.startup import quick_imports
from std_toolkit.jobs.interrupt import whole_imports

if TYPE_CHECKING:
    from annotator.qt.main_window import Shell


def run(args: AnnotateOptions) -> int:
    """Open the window and run the event loop until it is closed.

    Args:
        args: `scene` (a folder, or None for the start page), `annotator`, `read_only`,
            `recover`, `meshes`.

    Raises:
        ToolkitError: the folder of meshes does not exist or contains none, or the project is
            damaged.
        KeyboardInterrupt: SIGINT or SIGTERM closed the window.
    """
    meshes = choose_folder(args.meshes)
    app = make_application()
    with whole_imports(), quick_imports():
        from annotator.qt.main_window import Shell

    project = None
    if args.scene is not None and (args.scene / "project.json").is_file():
        from std_toolkit.project.record import Project

        project = Project.open(args.scene.resolve())
    shell = Shell(annotator=args.annotator, meshes=meshes, project=project)
    tell_troubles(shell)
    shell.show()
    shell.activateWindow()
    if args.scene is not None and project is None:
        scene = Path(args.scene)
        # The window is shown first, to display messages and questions of opening.
        QTimer.singleShot(
            0,
            shell,
            lambda: shell.open_scene(
                scene, read_only=args.read_only, recover=args.recover, take_over=args.take_over
            ),
        )
    # Computations run in other threads: a shorter interval lets the views run five times as often.
    sys.setswitchinterval(0.001)
    # Ctrl-C in the terminal ends the program; Python handles it when a timer wakes it.
    interrupted: list[int] = []

    def quit_by_signal(number: int, _: FrameType | None) -> None:
        interrupted.append(number)
        app.exit()  # `quit` would close the window, which asks whether to save

    signal.signal(signal.SIGINT, quit_by_signal)
    awake = QTimer(interval=300)
    awake.timeout.connect(lambda: None)
    awake.start()
    status = int(app.exec())
    if interrupted:
        raise KeyboardInterrupt
    return status


def tell_troubles(shell: Shell) -> None:
    """Show unexpected errors in the window; the traceback goes to the terminal."""

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)
        if isinstance(error, Exception):
            shell.tell_trouble(
                f"Something went wrong ({kind.__name__}: {error}). Every edit is in the "
                "journal; the terminal shows the traceback."
            )

    sys.excepthook = tell


def make_application() -> QApplication:
    """Return the Qt application of this process with the theme applied."""
    set_surface_format()
    app = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(app, QApplication)
    app.setApplicationName("std-annotate")
    light, text = remembered_look()
    apply_theme(app, light=light, text=text)
    return app
