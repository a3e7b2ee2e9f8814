"""A method's own settings: from text, as a user gives them, to the fields of its configuration."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

from std_toolkit.errors import ToolkitError

Config = TypeVar("Config")

_TRUTHS = {"true": True, "yes": True, "on": True, "1": True}
_FALSITIES = {"false": False, "no": False, "off": False, "0": False}


def configured(config: Config, settings: Mapping[str, str]) -> Config:
    """`config`, a dataclass, with the fields named in `settings` set.

    Fields may be bool, int, float, str, literals, tuples of one of them (`96,192,384`), and any
    of these or None (`none`).

    Raises:
        ToolkitError: no such field, or text that is no value for it.
    """
    hints = typing.get_type_hints(type(config))
    known = [field.name for field in fields(config)]  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for name, text in settings.items():
        if name not in known:
            raise ToolkitError(
                "the method has no such setting", field=name, hint=f"it has {', '.join(known)}"
            )
        try:
            changes[name] = _value(hints[name], text.strip())
        except ValueError as error:
            raise ToolkitError(str(error), field=name, value=text) from error
    return replace(config, **changes)  # type: ignore[type-var]


def preset_of(presets: Mapping[str, Config], name: str) -> Config:
    """One of a method's presets.

    Raises:
        ToolkitError: it has no such preset.
    """
    if name not in presets:
        raise ToolkitError(
            "the method has no such preset", value=name, hint=f"it has {', '.join(presets)}"
        )
    return presets[name]


def _value(kind: Any, text: str) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is typing.Literal:
        if text not in arguments:
            raise ValueError(f"expected one of {', '.join(arguments)}")
        return text
    if origin in (types.UnionType, typing.Union):
        if text.lower() == "none" and type(None) in arguments:
            return None
        (kind,) = (a for a in arguments if a is not type(None))
        return _value(kind, text)
    if origin is tuple:
        parts = text.split(",")
        if arguments[-1] is not Ellipsis and len(parts) != len(arguments):
            raise ValueError(f"expected {len(arguments)} values with commas between them")
        return tuple(_value(arguments[0], part.strip()) for part in parts)
    if kind is bool:
        if (truth := {**_TRUTHS, **_FALSITIES}.get(text.lower())) is None:
            raise ValueError("expected true or false")
        return truth
    try:
        return kind(text)
    except ValueError:
        raise ValueError(f"expected {'a whole number' if kind is int else 'a number'}") from None
