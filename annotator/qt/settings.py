"""User settings: recent scenes, look of the window, its size and layout."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from PySide6.QtCore import QByteArray
from PySide6.QtWidgets import QMainWindow, QSplitter

from annotator.app.mesh_folder import settings_folder
from annotator.app.palette import USUAL_TEXT, stepped
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


def remembered_look() -> tuple[bool, int]:
    """Return whether the theme is light, and the text size in percent; what is wrong is usual."""
    known = _read()
    text = known.get("text", "")
    percent = int(text) if text.isdecimal() and len(text) < 4 else USUAL_TEXT
    return known.get("theme") == "light", stepped(percent, 0)


def remember_look(*, light: bool, text: int) -> None:
    """Store the theme, and the text size in percent; ignores a read-only folder."""
    _write({"theme": "light" if light else "dark", "text": str(text)})


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
    _write({name: data.toBase64().toStdString() for name, data in parts.items()})


def _write(texts: dict[str, str]) -> None:
    data = json.dumps(_read() | texts, indent=1).encode()
    with suppress(ToolkitError):
        write_bytes_atomic(recent_file().with_name(_FILE), data)


def _read() -> dict[str, str]:
    try:
        known = json.loads(recent_file().with_name(_FILE).read_text())
        return {k: v for k, v in known.items() if isinstance(v, str)}
    except (OSError, ValueError, AttributeError):
        return {}
