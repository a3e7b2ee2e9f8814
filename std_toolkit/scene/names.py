"""Names that are safe as parts of file paths."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from std_toolkit.errors import ToolkitError

_SAFE = re.compile(r"^[A-Za-z0-9][A-Za-z0-9._+-]{0,127}$")


def check_name(name: str, *, path: Path | str | None = None, field: str = "name") -> str:
    """Return `name` if it may stand in a path.

    Raises:
        ToolkitError: it holds a separator, starts with a dot, is empty or too long.
    """
    if not _SAFE.match(name):
        raise ToolkitError(
            "not a safe name",
            path=path,
            field=field,
            value=name,
            hint="use letters, digits, '.', '_', '+', '-'; at most 128, first a letter or digit",
        )
    return name


def safe_name(text: str) -> str:
    """The nearest safe name to `text`: other characters become '_'."""
    name = re.sub(r"[^A-Za-z0-9._+-]+", "_", text).lstrip("._+-")[:128]
    return name or "unnamed"


def check_relative(text: str, *, path: Path | str | None = None, field: str = "path") -> str:
    """Return `text` if it is a relative path that stays inside its folder.

    Raises:
        ToolkitError: absolute, with '..' or a part that is no safe name.
    """
    parts = PurePosixPath(text).parts
    if not parts or text.startswith("/") or "\\" in text or not all(_SAFE.match(p) for p in parts):
        raise ToolkitError(
            "not a relative path inside the scene folder",
            path=path,
            field=field,
            value=text,
            hint="paths in a scene are relative, without '..'",
        )
    return text
