"""Names that are safe as parts of file paths."""

from __future__ import annotations

import re
from pathlib import Path

from std_toolkit.errors import ToolkitError

_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,127}")
_LONGEST_PATH = 512


def check_name(name: str, *, path: Path | str | None = None, field: str = "name") -> str:
    """Return `name` if it may stand in a path.

    Raises:
        ToolkitError: it holds a separator, starts with a dot, is empty or too long.
    """
    if not _SAFE.fullmatch(name):
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
        ToolkitError: absolute, too long, with '..' or a part that is no safe name.
    """
    # Splitting by hand: a path library would forgive "a//b" and "./a", and two spellings of one
    # file make duplicates that nobody sees.
    if len(text) > _LONGEST_PATH or not all(_SAFE.fullmatch(part) for part in text.split("/")):
        raise ToolkitError(
            "not a relative path inside the scene folder",
            path=path,
            field=field,
            value=text,
            hint="paths in a scene are relative, without '..'",
        )
    return text
