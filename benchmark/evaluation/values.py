"""Values of options by method and by split, and the labels of methods."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from std_toolkit.errors import ToolkitError
from std_toolkit.plugins import setting_of

# Before the label and an id of a method that is an object of this process.
OBJECT = "object:"

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")

_LONGEST_LABEL = 120  # file systems stop at 255 bytes


def roots_of(texts: Sequence[str]) -> dict[str | None, Path]:
    """Return data folders by split; the key None is for splits without an entry.

    Args:
        texts: `SPLIT=ROOT`, or `ROOT`.
    """
    found: dict[str | None, Path] = {}
    for text in texts:
        split, equals, root = text.partition("=")
        # The name of a folder may contain "=".
        named = bool(equals) and not Path(text).exists()
        found[split if named else None] = Path(root if named else text)
    return found


def data_of(split: str, roots: Mapping[str | None, Path]) -> Path:
    """Return the data folder of a split.

    Raises:
        ToolkitError: the split has no data folder.
    """
    root = roots.get(split, roots.get(None))
    if root is None:
        raise ToolkitError("no data for this split", field="data", value=split, hint="give ROOT")
    return root


def weights_by_method(texts: Sequence[str], methods: Sequence[str]) -> dict[str, Path]:
    """Return weight files by method.

    Args:
        texts: `METHOD=FILE`, or `FILE` if there is one method.
        methods: names of all methods.

    Raises:
        ToolkitError: weights without a method.
    """
    return {m: Path(text) for m, text in _by_method(texts, methods, "weights", "=")}


def settings_by_method(
    texts: Sequence[str], methods: Sequence[str], has: Callable[[str, str], bool]
) -> dict[str, dict[str, str]]:
    """Return settings by method, with an entry for each of `methods`.

    Args:
        texts: `METHOD.NAME=VALUE`, or `NAME=VALUE` if one method alone has it.
        methods: names of all methods.
        has: whether a method has a setting.

    Raises:
        ToolkitError: a setting of no or several methods, or without a value.
    """
    settings: dict[str, dict[str, str]] = {method: {} for method in methods}
    for method, text in _by_method(texts, methods, "settings", ".", has):
        name, value = setting_of(text)
        settings[method][name] = value
    return settings


def _by_method(
    texts: Sequence[str],
    methods: Sequence[str],
    field_name: str,
    separator: str,
    has: Callable[[str, str], bool] = lambda _method, _name: False,
) -> list[tuple[str, str]]:
    """Pairs of a method and the text that applies to it."""
    found = []
    for text in texts:
        method = next((m for m in methods if text.startswith(m + separator)), None)
        if method is not None:
            found.append((method, text.removeprefix(method + separator)))
            continue
        named = methods
        if len(methods) > 1:
            named = [m for m in dict.fromkeys(methods) if has(m, text.partition("=")[0])]
        if len(named) != 1:
            raise ToolkitError(
                "does not say which method it is for",
                field=field_name,
                value=text,
                hint=f"METHOD{separator}..., with one of {', '.join(named or methods)}",
            )
        found.append((named[0], text))
    return found


def labels_by_method(texts: Sequence[str], methods: Sequence[str]) -> dict[str, str]:
    """Return names in tables by method.

    Args:
        texts: `METHOD=NAME`, or `NAME` if there is one method.
        methods: names of all methods.

    Raises:
        ToolkitError: a name without a method, two for one, or one that no folder can have.
    """
    found: dict[str, str] = {}
    for text in texts:
        # The longest first: a method's own name may hold "=".
        named = sorted((m for m in methods if text.startswith(f"{m}=")), key=len)
        if not named and len(methods) != 1:
            raise ToolkitError(
                "names one method, not several",
                field="label",
                value=text,
                hint=f"METHOD=NAME, with one of {', '.join(methods)}" if methods else None,
            )
        method = named[-1] if named else methods[0]
        if method in found:
            raise ToolkitError("two names for one method", field="label", value=text)
        found[method] = checked_label(text.removeprefix(f"{method}=") if named else text)
    return found


def is_folder(method: str) -> bool:
    """Whether a method is predictions in a folder, NAME=DIR.

    >>> is_folder("mine=out"), is_folder("command:run --a=b"), is_folder("raw")
    (True, False, False)
    """
    name, equals, _ = method.partition("=")
    return bool(equals) and ":" not in name


def folders_by_name(methods: Sequence[str], taken: Sequence[str]) -> dict[str, tuple[str, Path]]:
    """Return name and folder of each method that is NAME=DIR, by its text.

    Args:
        methods: as given.
        taken: names of methods that run.

    Raises:
        ToolkitError: the name of another method, or one that cannot be the name of a folder.
    """
    found = {}
    for text in methods:
        if not is_folder(text):
            continue
        name, _, folder = text.partition("=")
        if name in taken:
            raise ToolkitError(
                "predictions in a folder need a name of their own", field="--method", value=text
            )
        found[text] = (checked_label(name), Path(folder))
    return found


def check_folders(folders: Sequence[Path], labels: Sequence[str]) -> None:
    """Refuse two runs in one folder.

    Args:
        folders, labels: of all runs.

    Raises:
        ToolkitError: two methods have one name.
    """
    for place, label in enumerate(labels):
        if folders[place] in folders[:place]:
            raise ToolkitError("two methods have this name", field="--method", value=label)


def plain_label(name: str) -> str:
    """Return the label of a method or planner given by location, or as a command.

    >>> plain_label("my/file.py:Class")
    'file.py.Class'
    >>> plain_label("command:docker run megapose")
    'command.docker'
    >>> plain_label("object:Mine:0f3a")
    'Mine'
    """
    if name.startswith(OBJECT):
        return name.split(":")[1]
    if name.startswith("command:"):
        words = name.removeprefix("command:").split()
        return f"command.{Path(words[0]).name}" if words else "command"
    return name.rpartition("/")[2].replace(":", ".")


def checked_label(text: str) -> str:
    """Return `text` if it is usable as the name of a method in tables and folders.

    Raises:
        ToolkitError: it cannot be the name of a folder.
    """
    if len(text) > _LONGEST_LABEL:
        raise ToolkitError(
            f"must have at most {_LONGEST_LABEL} characters",
            field="label",
            value=f"{text[:40]}...",
        )
    if not _LABEL.fullmatch(text):
        raise ToolkitError(
            "must be usable as a folder's name",
            field="label",
            value=text,
            hint="letters, digits and . _ + -",
        )
    return text
