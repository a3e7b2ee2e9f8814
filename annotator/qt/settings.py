"""User settings: recent scenes, and size and layout of the window."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QByteArray
from PySide6.QtWidgets import QMainWindow, QSplitter

from annotator.app.mesh_folder import settings_folder
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

MOST = 12

_FILE = "window.json"


def recent_file() -> Path:
    """Return the path of the list of recent scenes."""
    return settings_folder() / "recent-scenes.json"


def recent_scenes() -> list[Path]:
    """Return the existing recent scenes, latest first; empty if the list is unreadable."""
    try:
        names = json.loads(recent_file().read_text())
        return [Path(n) for n in names if (Path(n) / "scene.json").is_file()][:MOST]
    except (OSError, ValueError, TypeError):
        return []


def remember_scene(root: Path) -> None:
    """Put a scene at the head of the list; ignores a read-only folder."""
    root = root.resolve()
    others = [p for p in recent_scenes() if p != root]
    path = recent_file()
    names = [str(p) for p in [root, *others][:MOST]]
    with suppress(ToolkitError):
        write_bytes_atomic(path, json.dumps(names, indent=1).encode())


def restore_window(window: QMainWindow) -> bool:
    """Restore position and size of a window; False if nothing is stored."""
    text = _read().get("window")
    return text is not None and window.restoreGeometry(QByteArray.fromBase64(text.encode()))


def restore_splitters(splitters: dict[str, QSplitter]) -> set[str]:
    """Restore the splitters; returns the names of those that were stored."""
    known = _read()
    found = set()
    for name, splitter in splitters.items():
        if name in known and splitter.restoreState(QByteArray.fromBase64(known[name].encode())):
            found.add(name)
    return found


def remember(window: QMainWindow, splitters: dict[str, QSplitter]) -> None:
    """Store the layout of the window; ignores a read-only folder."""
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
