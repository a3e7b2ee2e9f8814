"""Scenes opened last, kept in the user's configuration folder."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic

MOST = 12


def recent_file() -> Path:
    """Where the list is kept."""
    home = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(home) / "std-toolkit" / "recent-scenes.json"


def recent_scenes() -> list[Path]:
    """Scenes that are still there, the latest first; nothing if the list cannot be read."""
    try:
        names = json.loads(recent_file().read_text())
        return [Path(n) for n in names if (Path(n) / "scene.json").is_file()][:MOST]
    except (OSError, ValueError, TypeError):
        return []


def remember_scene(root: Path) -> None:
    """Put a scene at the head of the list; a folder that cannot be written is no trouble."""
    root = root.resolve()
    others = [p for p in recent_scenes() if p != root]
    path = recent_file()
    names = [str(p) for p in [root, *others][:MOST]]
    with suppress(ToolkitError):
        write_bytes_atomic(path, json.dumps(names, indent=1).encode())
