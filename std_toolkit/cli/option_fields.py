"""The fields of a dataclass as options of a command line, and the dataclass of their values."""

import dataclasses
import functools
import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args, get_origin, get_type_hints

from std_toolkit.errors import ToolkitError

MAPPINGS = (dict, Mapping)


@dataclass(frozen=True)
class OptionField:
    """An option or positional argument of a command.

    Attributes:
        field: of the dataclass.
        name: on the command line; "" for a positional argument.
        type: with annotations.
        default: `dataclasses.MISSING` for none.
        help: its text.
        metadata: of the field.
    """

    field: str
    name: str
    type: Any
    default: Any
    help: str
    metadata: Mapping[str, Any]

    @property
    def title(self) -> str:
        return f"--{self.name}" if self.name else self.field.upper()


def option_fields(kind: type[Any], given: Any = dataclasses.MISSING) -> Iterator[OptionField]:
    """Options of a dataclass, with those of nested ones; `given` holds other defaults."""
    texts = _help_texts(kind)  # type: ignore[arg-type]  # classes are hashable
    for field, hint, default in shown_fields(kind, given):
        if _is_record(hint):
            yield from option_fields(hint, default)
            continue
        plain = "" if default is dataclasses.MISSING else field.name.replace("_", "-")
        name = field.metadata.get("off", field.metadata.get("option", plain))
        yield OptionField(
            field.name, name, hint, default, texts.get(field.name, ""), field.metadata
        )


@functools.cache  # reading sources takes a fifth of the time of a help page
def _help_texts(kind: type[Any]) -> dict[str, str]:
    from docstring_parser import parse_from_object

    return {
        text.arg_name: " ".join((text.description or "").split())
        for c in reversed(kind.__mro__[:-1])
        for text in parse_from_object(c).params
    }


def shown_fields(kind: type[Any], given: Any) -> Iterator[tuple[dataclasses.Field[Any], Any, Any]]:
    """Fields on the command line, their types and defaults.

    Those of base classes follow, nested dataclasses are last.
    """
    hints = get_type_hints(kind, include_extras=True)
    owners: dict[str, int] = {}
    for place, owner in enumerate(kind.__mro__):
        owners |= {name: place for name in inspect.get_annotations(owner) if name not in owners}
    for field in sorted(
        dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else _struct_fields(kind, hints),
        key=lambda field: (_is_record(hints[field.name]), owners[field.name]),
    ):
        if not field.init or field.metadata.get("option", "") is None:
            continue
        default = field.default
        if given is not dataclasses.MISSING:
            default = getattr(given, field.name)
        elif callable(field.default_factory):
            default = field.default_factory()
        yield field, hints[field.name], default


def build_options(
    kind: type[Any], values: Mapping[str, Any], given: Any = dataclasses.MISSING
) -> Any:
    """The dataclass of the values of its options."""
    found = {}
    for field, hint, default in shown_fields(kind, given):
        value: Any = values.get(field.name)
        if _is_record(hint):
            value = build_options(hint, values, default)
        elif get_origin(hint) in MAPPINGS:
            value = _pairs(field.name, value, get_args(hint)[1])
        elif "off" in field.metadata:
            value = not value
        elif "factor" in field.metadata:
            value = value and value / field.metadata["factor"]
        elif "size" in field.metadata and isinstance(value, str):
            value = _size(field.name, value)
        elif value == () and default is None:
            value = None
        found[field.name] = value
    if given is dataclasses.MISSING:
        return kind(**found)
    if dataclasses.is_dataclass(kind):
        return dataclasses.replace(given, **found)
    from msgspec import structs

    return structs.replace(given, **found)


def _is_record(hint: Any) -> bool:
    """Whether a type is a dataclass or a `msgspec.Struct` of options."""
    return dataclasses.is_dataclass(hint) or hasattr(hint, "__struct_fields__")


def _struct_fields(kind: type[Any], hints: Mapping[str, Any]) -> Iterator[dataclasses.Field[Any]]:
    """Fields of a Struct as dataclass fields; their metadata are the `extra` of a `Meta`."""
    from msgspec import NODEFAULT, structs

    for info in structs.fields(kind):
        extras = (
            getattr(meta, "extra", None) for meta in getattr(hints[info.name], "__metadata__", ())
        )
        default = dataclasses.MISSING if info.default is NODEFAULT else info.default
        field: Any = dataclasses.field(default=default, metadata=next(filter(None, extras), {}))
        field.name = info.name
        yield field


def _pairs(name: str, words: Sequence[str], kind: type[Any]) -> dict[str, Any]:
    """A mapping from `NAME=VALUE`."""
    found = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not (key and equals):
            raise ToolkitError("expected NAME=VALUE", field=name, value=word)
        if key in found:
            raise ToolkitError("given twice", field=name, value=key)
        try:
            found[key] = kind(value)
        except ValueError:
            problem = f"expected NAME={kind.__name__.upper()}"
            raise ToolkitError(problem, field=name, value=word) from None
    return found


def _size(name: str, word: str) -> tuple[int, int]:
    width, _, height = word.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) and int(height)):
        raise ToolkitError("expected a size such as 1280x720", field=name, value=word)
    return int(width), int(height)
