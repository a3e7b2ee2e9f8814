"""`std-annotate SCENE` in a window."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

# The library between Qt and VTK must take the same Qt as this package.
os.environ.setdefault("QT_API", "pyside6")

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication

from annotator.options import AnnotateOptions
from annotator.qt.graphics import set_surface_format
from annotator.qt.theme import apply_theme
from annotator.startup import quick_imports

if TYPE_CHECKING:
    from annotator.qt.main_window import Shell


def run(args: AnnotateOptions) -> int:
    """Open the window and work until it is closed.

    Args:
        args: `scene` (a folder, or None for the start page), `annotator`, `read_only`, `recover`.
    """
    app = make_application()
    with quick_imports():
        from annotator.qt.main_window import Shell

    shell = Shell(annotator=args.annotator)
    tell_troubles(shell)
    shell.show()
    shell.activateWindow()
    if args.scene is not None:
        scene = Path(args.scene)
        # The window stands first, so that what opening has to tell or ask has a place.
        QTimer.singleShot(
            0,
            shell,
            lambda: shell.open_scene(scene, read_only=args.read_only, recover=args.recover),
        )
    # Computations run in threads beside the views: these come to their turn five times as fast.
    sys.setswitchinterval(0.001)
    # Ctrl-C in the terminal ends the program; Python sees it when it is woken now and then.
    signal.signal(signal.SIGINT, lambda *_: app.quit())
    awake = QTimer(interval=300)
    awake.timeout.connect(lambda: None)
    awake.start()
    return int(app.exec())


def tell_troubles(shell: Shell) -> None:
    """Errors that nobody foresaw appear in the window; the traceback goes to the terminal."""

    def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        sys.__excepthook__(kind, error, trace)
        if isinstance(error, Exception):
            shell.tell_trouble(
                f"Something went wrong ({kind.__name__}: {error}). Every edit stands in the "
                "journal; the terminal shows more."
            )

    sys.excepthook = tell


def make_application() -> QApplication:
    """The Qt application of this process, in our colours."""
    set_surface_format()
    app = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(app, QApplication)
    app.setApplicationName("std-annotate")
    apply_theme(app)
    return app
