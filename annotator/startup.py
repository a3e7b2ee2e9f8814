"""Starting quickly: the libraries of the views import far more than they need."""

from __future__ import annotations

import gc
import importlib
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Imported by pyvista for its charts and its example data, which nothing here uses: 0.3 s.
LATER = ("matplotlib.pyplot", "pooch")
# Where mypy is installed, pyvista imports a plug-in for it: 0.1 s.
ABSENT = ("mypy",)


@contextmanager
def quick_imports() -> Iterator[None]:
    """Within it, heavy libraries are imported in two thirds of their time.

    No garbage is looked for: imports make thousands of objects and hardly any garbage. What was
    imported is also kept out of later searches, whose pauses would show while dragging. Modules
    that are needed only for what is not used here are loaded when they are used.
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
        if imported:  # otherwise it would keep garbage of the program's work for ever
            gc.freeze()
        if was_enabled:
            gc.enable()


class _Later(types.ModuleType):
    """Stands for a module until something of it is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked for by the import system itself
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)
