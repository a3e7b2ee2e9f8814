"""Limits that decide whether a label, frame, match, mask, mesh or grasp is accepted.

An algorithm keeps its limits in one frozen dataclass in its own module, a subclass of `Settings`:

    @dataclass(frozen=True, kw_only=True)
    class ContourSettings(Settings):
        large_offset_mm: float = limit(3.0, unit="mm", source=NOT_RECORDED)
        '''a larger translation that all frames share brings a warning'''

The algorithm reads them where it decides: `ContourSettings.current().large_offset_mm`. A group of
limits is named after its module: `checks.gates.contour` for `std_toolkit/checks/gates/contour.py`,
`benchmark.tabletop.trial` outside `std_toolkit`.

A user changes limits with `--settings FILE` of any command, in TOML:

    [checks.gates.contour]
    large_offset_mm = 2.0

or from Python with `with override(ContourSettings(large_offset_mm=2.0)): ...`. Worker processes get
the same limits, and results record those that differ from the defaults (`changed`). What the user
chooses for each run is an option of the step, in `std_toolkit.options`.
"""

import dataclasses
import importlib
import importlib.util
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from std_toolkit.errors import ToolkitError, check_options

NOT_RECORDED = "not recorded"
"""Source of a limit of which nobody noted on what data it was set."""

_PACKAGES = ("std_toolkit", "annotator", "sensors", "benchmark")
_GROUP = re.compile(r"[a-z_][a-z0-9_]*(\.[a-z_][a-z0-9_]*)*")


def limit(value: Any, *, unit: str = "", source: str) -> Any:
    """Return the field of a limit.

    Args:
        value: default; a number, a tuple of numbers, or a dict of numbers by name.
        unit: "px", "mm", "deg", ...; "" for a ratio or a count.
        source: on what data, or by what argument, the value was set.
    """
    metadata = {"unit": unit, "source": source}
    if isinstance(value, dict):
        return dataclasses.field(default_factory=lambda: dict(value), metadata=metadata)
    return dataclasses.field(default=value, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Limits of one module; every field is made by `limit`."""

    group: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.group = cls.__module__.removeprefix("std_toolkit.")
        _KINDS[cls.group] = cls

    @classmethod
    def current(cls) -> Self:
        """Return the limits in force: those of `override`, else the defaults."""
        return _ACTIVE.get(cls) or _default(cls)  # type: ignore[return-value]


_KINDS: dict[str, type[Settings]] = {}
# Those that were set; defaults are not in it, so that reading a limit changes nothing.
_ACTIVE: dict[type[Settings], Settings] = {}
_DEFAULTS: dict[type[Settings], Settings] = {}


def _default(kind: type[Settings]) -> Settings:
    found = _DEFAULTS.get(kind)
    if found is None:
        found = _DEFAULTS[kind] = kind()
    return found


@contextmanager
def override(*limits: Settings) -> Iterator[None]:
    """Use these limits within the block, in this process and in workers that it starts."""
    before = dict(_ACTIVE)
    try:
        use(limits)
        yield
    finally:
        _ACTIVE.clear()
        _ACTIVE.update(before)


def use(limits: Iterable[Settings]) -> None:
    """Use these limits until the process ends.

    Raises:
        ToolkitError: a value is outside the range that its annotation states.
    """
    for one in limits:
        check_options(one)
        _ACTIVE[type(one)] = one


def use_only(limits: Iterable[Settings]) -> None:
    """Use these limits, and the defaults of all others: a worker may serve several jobs."""
    wanted = tuple(limits)
    if wanted != in_force():
        _ACTIVE.clear()
        use(wanted)


def in_force() -> tuple[Settings, ...]:
    """Return the groups of limits that differ from the defaults, in the order of their names."""
    found = [one for one in tuple(_ACTIVE.values()) if one != _default(type(one))]
    return tuple(sorted(found, key=lambda one: one.group))


def changed(*prefixes: str) -> dict[str, float]:
    """Return the limits that differ from the defaults, by "GROUP.FIELD"; results record them.

    Numbers of a tuple and of a mapping are named "GROUP.FIELD.INDEX" and "GROUP.FIELD.KEY".

    Args:
        prefixes: only limits whose names begin so, such as "poses."; none for all.
    """
    found = {}
    for one in in_force():
        if prefixes and not one.group.startswith(prefixes):
            continue
        default = _default(type(one))
        for field in dataclasses.fields(one):
            usual = dict(_numbers(getattr(default, field.name)))
            for part, value in _numbers(getattr(one, field.name)):
                if value != usual.get(part):
                    found[".".join((one.group, field.name, *part))] = value
    return found


def _numbers(value: Any) -> Iterator[tuple[tuple[str, ...], float]]:
    if isinstance(value, Mapping):
        yield from (((str(key),), float(number)) for key, number in value.items())
    elif isinstance(value, tuple):
        yield from (((str(index),), float(number)) for index, number in enumerate(value))
    else:
        yield (), float(value)


def settings_of(tables: Mapping[str, Any], path: Path) -> tuple[Settings, ...]:
    """Limits from the tables of a file: a table for each group, a key for each limit.

    Args:
        path: of the file, for errors.

    Raises:
        ToolkitError: a group or limit does not exist, a group is no table or given twice, or a
            value has another type than the default.
    """
    found: dict[str, Settings] = {}
    for name, table in _groups(tables):
        one = _from_table(name, table, path)
        if name in found:  # [a.b] and ["a.b"] are different keys of TOML
            raise ToolkitError("the group is given twice", path=path, field=name, hint="join both")
        found[name] = one
    return tuple(found.values())


def _groups(tables: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Tables by dotted name; a table may hold limits that are tables, such as by material."""
    for key, value in tables.items():
        name = f"{prefix}.{key}" if prefix else key
        if not isinstance(value, dict):
            yield prefix, {key: value}
        elif _kind(name) is not None:
            yield name, value
        elif _spec(name) is not None:  # a package
            yield from _groups(value, name)
        else:
            yield name, value


def _spec(group: str) -> str | None:
    """Full name of the module of a group; None if the toolkit has none."""
    if not _GROUP.fullmatch(group):
        return None
    full = group if group.partition(".")[0] in _PACKAGES else f"std_toolkit.{group}"
    try:
        return full if importlib.util.find_spec(full) is not None else None
    except ModuleNotFoundError:
        return None


def _kind(group: str) -> type[Settings] | None:
    full = _spec(group)
    if full is not None and group not in _KINDS:
        importlib.import_module(full)
    return _KINDS.get(group)


def _from_table(group: str, table: dict[str, Any], path: Path) -> Settings:
    kind = _kind(group)
    if kind is None:
        key, value = next(iter(table.items()), ("", None))
        inner = f"{group}.{key}" if group else key
        if not isinstance(value, dict) and _kind(inner) is not None:
            raise ToolkitError(
                "expected a table", path=path, field=inner, value=value, hint=f"write [{inner}]"
            )
        raise ToolkitError(
            "no group of settings has this name",
            path=path,
            field=group or next(iter(table)),
            hint="`std-curate settings` lists all",
        )
    known = {field.name: field for field in dataclasses.fields(kind)}
    values = {}
    for name, value in table.items():
        if name not in known:
            raise ToolkitError(
                f"no limit of {group}; it has {', '.join(known)}",
                path=path,
                field=f"{group}.{name}",
            )
        values[name] = _as_default(getattr(kind(), name), value, path, f"{group}.{name}")
    made = kind(**values)
    try:
        check_options(made)
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=f"{group}.{error.field}", value=error.value
        ) from error
    return made


def _as_default(default: Any, value: Any, path: Path, field: str) -> Any:
    """The value in the type of the default: whole numbers may stand for others."""

    def refuse(expected: str) -> ToolkitError:
        return ToolkitError(f"expected {expected}", path=path, field=field, value=value)

    if isinstance(default, tuple):
        if not isinstance(value, list) or len(value) != len(default):
            raise refuse(f"{len(default)} numbers")
        return tuple(_as_default(d, v, path, field) for d, v in zip(default, value, strict=True))
    if isinstance(default, dict):
        if not isinstance(value, dict) or not set(value) <= set(default):
            raise refuse(f"a table with {', '.join(map(str, default))}")
        parts = {k: _as_default(default[k], v, path, f"{field}.{k}") for k, v in value.items()}
        return {**default, **parts}
    number = isinstance(value, int | float) and not isinstance(value, bool)
    number = number and math.isfinite(value)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise refuse("true or false")
        return value
    if number and value < 0 <= default:
        raise refuse("a number of at least 0")
    if isinstance(default, int):
        if not number or value != int(value):
            raise refuse("a whole number")
        return int(value)
    if not number:
        raise refuse("a finite number")
    return float(value)


def every_group() -> tuple[type[Settings], ...]:
    """Import all modules that have limits and return their groups in the order of their names."""
    root = Path(__file__).resolve().parent.parent
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            if "(Settings):" in path.read_text(encoding="utf-8"):
                importlib.import_module(".".join(path.relative_to(root).with_suffix("").parts))
    return tuple(_KINDS[name] for name in sorted(_KINDS))


def settings_text(kind: type[Settings]) -> str:
    """Return the limits in force of a group as TOML, with meaning, unit and source as comments."""
    from docstring_parser import parse_from_object

    meanings = {
        m.arg_name: " ".join((m.description or "").split()) for m in parse_from_object(kind).params
    }
    lines = [f"# {(kind.__doc__ or '').splitlines()[0]}", f"[{kind.group}]"]
    for field in dataclasses.fields(kind):
        unit = f" ({field.metadata['unit']})" if field.metadata["unit"] else ""
        lines += [
            f"# {meanings[field.name]}{unit}. Source: {field.metadata['source']}",
            f"{field.name} = {_toml(getattr(kind.current(), field.name))}",
        ]
    return "\n".join(lines)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(v)}" for name, v in value.items()) + " }"
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value if isinstance(value, int) else float(value))
