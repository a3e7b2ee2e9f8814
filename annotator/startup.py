"""Imports of the front ends: what is missing, and faster imports of the view libraries.

Those import many unused modules.
"""

from __future__ import annotations

import gc
import importlib
import importlib.util
import os
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs.interrupt import whole_imports

# Imported by pyvista for charts and example data, both unused: 0.3 s.
LATER = ("matplotlib.pyplot", "pooch")
# If mypy is installed, pyvista imports a plug-in for it: 0.1 s.
ABSENT = ("mypy",)


@contextmanager
def quick_imports() -> Iterator[None]:
    """Context manager in which heavy libraries import in two thirds of the time.

    Garbage collection is off: imports create thousands of objects and hardly any garbage. Imported
    objects are also excluded from later collections, whose pauses are visible while dragging.
    Modules for unused features are loaded on first use.
    """
    stand_ins: dict[str, types.ModuleType | None] = {
        **{name: _Later(name) for name in LATER if name not in sys.modules},
        **{name: None for name in ABSENT if name not in sys.modules},
    }
    sys.modules.update(stand_ins)  # type: ignore[arg-type]
    before = len(sys.modules)
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        imported = len(sys.modules) > before
        for name, stand_in in stand_ins.items():
            if sys.modules.get(name, stand_in) is stand_in:
                sys.modules.pop(name, None)
        if imported:  # otherwise garbage of the program would be kept forever
            gc.freeze()
        if was_enabled:
            gc.enable()


def front_end(module: str, extra: str, needs: tuple[str, ...], what: str) -> types.ModuleType:
    """Import a front end.

    Raises:
        ToolkitError: its libraries are not installed or do not load, or there is no display.
    """
    missing = [name for name in needs if importlib.util.find_spec(name) is None]
    if missing:
        raise ToolkitError(
            f"annotating in {what} needs {', '.join(missing)}",
            hint=f"pip install 'std-toolkit[{extra}]'",
        )
    if extra == "gui":
        _require_display()
    try:
        with whole_imports(), quick_imports():
            return importlib.import_module(module)
    except ImportError as error:
        # For example a missing system library of Qt or VTK.
        raise ToolkitError(
            f"annotating in {what} cannot start: {error}",
            hint=f"pip install 'std-toolkit[{extra}]' and the system libraries that it names",
        ) from error


def _require_display() -> None:
    """Raise an error without a display, where Qt would abort the process with a long message."""
    known = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in known):
        raise ToolkitError(
            "there is no display for a window here",
            hint="use --web PORT and a browser (remotely: ssh -L PORT:127.0.0.1:PORT), "
            "or --script FILE",
        )


class _Later(types.ModuleType):
    """Placeholder of a module that is imported on first attribute access."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # requested by the import system itself
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)
