"""Size of the window and of its parts, kept from one day to the next."""

from __future__ import annotations

import json
from contextlib import suppress

from PySide6.QtCore import QByteArray
from PySide6.QtWidgets import QMainWindow, QSplitter

from annotator.window.recent import recent_file
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

_FILE = "window.json"


def restore_window(window: QMainWindow) -> bool:
    """Put a window where it was; False if nothing is known of it."""
    text = _read().get("window")
    return text is not None and window.restoreGeometry(QByteArray.fromBase64(text.encode()))


def restore_splitters(splitters: dict[str, QSplitter]) -> set[str]:
    """Divide the window as it was; returns the names of the parts that were known."""
    known = _read()
    found = set()
    for name, splitter in splitters.items():
        if name in known and splitter.restoreState(QByteArray.fromBase64(known[name].encode())):
            found.add(name)
    return found


def remember(window: QMainWindow, splitters: dict[str, QSplitter]) -> None:
    """Keep how the window is now; a folder that cannot be written is no trouble."""
    parts = {"window": window.saveGeometry()}
    parts |= {name: splitter.saveState() for name, splitter in splitters.items()}
    texts = _read() | {name: data.toBase64().toStdString() for name, data in parts.items()}
    with suppress(ToolkitError):
        write_bytes_atomic(recent_file().with_name(_FILE), json.dumps(texts, indent=1).encode())


def _read() -> dict[str, str]:
    try:
        known = json.loads(recent_file().with_name(_FILE).read_text())
        return {k: v for k, v in known.items() if isinstance(v, str)}
    except (OSError, ValueError, AttributeError):
        return {}
