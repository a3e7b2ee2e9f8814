"""Plug-ins by name, and lazy names of the packages of this distribution.

A plug-in is built in, installed as an entry point, or named as `package.module:attribute` or
`path/to/file.py:attribute`. CONTRIBUTING.md has an example of each kind. The four packages call
`install` when they are imported.
"""

from __future__ import annotations

import importlib
import sys
import traceback
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from std_toolkit import libraries
from std_toolkit.errors import ToolkitError, missing_extra

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")
Config = TypeVar("Config")

_TRUTHS = {"true": True, "yes": True, "on": True, "1": True}
_FALSITIES = {"false": False, "no": False, "off": False, "0": False}


_ALLOW = "if you trust it, give --allow-code, and no --plan"

# What names plug-ins now, if that is no command line: of the process, so that its threads know it.
_refused: str | None = None


@contextmanager
def names_of(document: str) -> Iterator[None]:
    """Names of plug-ins come from a document here: only those that are known are taken.

    `file.py:NAME` and `package.module:NAME` run code, which is for the user to name.

    Args:
        document: what it is, for the error.
    """
    before = naming_document()
    take_names_of(document)
    try:
        yield
    finally:
        take_names_of(before)


def naming_document() -> str | None:
    """The document of `names_of`; None if names come from the user. For `take_names_of`."""
    return _refused


def check_named(name: object, *, field: str | None = None) -> None:
    """Check that a name in a document is none of code; see `names_of`.

    Raises:
        ToolkitError: it is `file.py:NAME` or `package.module:NAME`.
    """
    document = naming_document()
    if document is not None and isinstance(name, str) and ":" in name:
        raise ToolkitError(
            f"{document} names code, which is not loaded", field=field, value=name, hint=_ALLOW
        )


def take_names_of(document: str | None) -> None:
    """As `names_of`, until the next call: a worker process takes what its starter says."""
    global _refused
    _refused = document


# Files and top-level packages of plug-ins that are loaded, by the names of their modules.
_loaded_from: dict[str, str] = {}


def error_of_plugin(error: BaseException, *, in_use: bool = False) -> ToolkitError | None:
    """The error to report for one that a plug-in raised.

    Args:
        error: unexpected, none of the toolkit's own.
        in_use: whether the plug-in loaded last is named for an error that came without it, as one
            may that its answers brought about.

    Returns:
        An error that names the file of the plug-in and the line; None without a plug-in.
    """
    if isinstance(error, ToolkitError) or not _loaded_from:
        return None
    text = " ".join(f"{type(error).__name__}: {error}".split())[:500]
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        name = str(frame.f_globals.get("__name__", ""))
        if name in _loaded_from or name.partition(".")[0] in _loaded_from:
            where = f"line {line}, {frame.f_code.co_name}"
            hint = "an error of the plug-in; --debug prints the traceback"
            return ToolkitError(text, path=frame.f_code.co_filename, field=where, hint=hint)
    if not in_use:
        return None
    file = list(_loaded_from.values())[-1]
    hint = "does the plug-in give what CONTRIBUTING.md says? --debug prints the traceback"
    return ToolkitError(text, path=file, hint=hint)


def _module_of_file(path: str) -> ModuleType:
    """The module loaded from a file; the file is executed once."""
    file, name = Path(path).resolve(), _name_of(path)
    if name not in sys.modules:
        if not file.is_file():
            raise FileNotFoundError(f"no such file: {path}")
        spec = spec_from_file_location(name, file)
        assert spec is not None and spec.loader is not None
        module = module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


def _name_of(path: str) -> str:
    return f"plug-in {Path(path).resolve()}"


# The other packages of this distribution.
SIBLINGS = frozenset({"annotator", "benchmark", "sensors"})

OWN = SIBLINGS | {"std_toolkit"}


class Registry(Generic[T]):
    """Plug-ins of one kind, by name.

    `get` searches the built-in plug-ins first (`module:attribute` strings, imported on first
    use), then the installed entry points of `group`. It imports a name with a colon as
    `package.module:attribute` or `path/to/file.py:attribute`.

    Args:
        group: entry-point group, such as `std_toolkit.renderers`.
        builtin: name to `package.module:attribute`.
    """

    def __init__(self, group: str, builtin: dict[str, str]) -> None:
        self.group = group
        self._targets = dict(builtin)
        self._given: dict[str, T] = {}

    def names(self) -> list[str]:
        """All known names, built-in ones first."""
        return list(dict.fromkeys([*self._targets, *(e.name for e in self._entries())]))

    def _entries(self) -> Iterable[EntryPoint]:
        from importlib.metadata import entry_points

        return entry_points(group=self.group)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    @contextmanager
    def holding(self, plugins: Mapping[str, T]) -> Iterator[None]:
        """Know these objects by name, too, in this process until the block ends."""
        self._given |= plugins
        try:
            yield
        finally:
            for name in plugins:
                del self._given[name]

    def get(self, name: str) -> T:
        """Import and return the plug-in called `name`.

        Raises:
            ToolkitError: no such plug-in, or it cannot be imported.
        """
        if name in self._given:
            return self._given[name]
        if name in self._targets:
            return self._import(self._targets[name])
        for entry in self._entries():
            if entry.name == name:
                module = entry.value.partition(":")[0].partition(".")[0]
                if module not in OWN:
                    _loaded_from[module] = module
                return self._loaded(entry.load, entry.value)
        if ":" in name:
            check_named(name)
            return self._import(name)
        raise ToolkitError(
            f"no plug-in with this name in {self.group}",
            value=name,
            hint=f"known: {', '.join(self.names())}; or give package.module:NAME or file.py:NAME",
        )

    def _import(self, target: str) -> T:
        module, _, attribute = target.rpartition(":")
        load = _module_of_file if module.endswith(".py") else importlib.import_module
        if module.endswith(".py"):
            _loaded_from[_name_of(module)] = module
        elif module.partition(".")[0] not in OWN:
            _loaded_from[module.partition(".")[0]] = module
        return self._loaded(lambda: getattr(load(module), attribute), target)

    def _loaded(self, load: Callable[[], Any], target: str) -> T:
        try:
            return load()
        except (Exception, SystemExit) as error:  # importing foreign code can raise anything
            if (missing := missing_extra(error)) is not None:
                raise ToolkitError(missing.problem, value=target, hint=missing.hint) from error
            reason = " ".join(str(error).split()) or type(error).__name__
            if isinstance(error, SystemExit):
                reason = f"it ends the program (SystemExit: {reason})"
            raise ToolkitError(
                f"cannot import plug-in for {self.group}: {reason}", value=target
            ) from error


def setting_of(text: str) -> tuple[str, str]:
    """Name and value of `NAME=VALUE`, a plug-in's own setting.

    Raises:
        ToolkitError: the text has no name or no value.

    >>> setting_of("reach=30")
    ('reach', '30')
    """
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ToolkitError("expected NAME=VALUE", field="settings", value=text)
    return name, value


def configured(config: Config, settings: Mapping[str, str], *, of: str = "method") -> Config:
    """`config`, a dataclass, with the fields named in `settings` set.

    Fields may be bool, int, float, str, literals, tuples of one of them (`96,192,384`), and any
    of these or None (`none`).

    Args:
        of: kind of the plug-in, for errors.

    Raises:
        ToolkitError: no such field, or text that is no value for it.
    """
    hints = typing.get_type_hints(type(config))
    known = [field.name for field in fields(config)]  # type: ignore[arg-type]
    changes: dict[str, Any] = {}
    for name, text in settings.items():
        if name not in known:
            raise ToolkitError(
                f"the {of} has no such setting", field=name, hint=f"it has {', '.join(known)}"
            )
        try:
            changes[name] = _value(hints[name], text.strip())
        except ValueError as error:
            raise ToolkitError(str(error), field=name, value=text) from error
    return replace(config, **changes)  # type: ignore[type-var]


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


def lazy_names(package: str, modules: Mapping[str, str]) -> Callable[[str], object]:
    """Return the `__getattr__` of a package whose names are imported on first use.

    Args:
        package: name of the package.
        modules: submodule that defines each name, relative to the package.

    >>> lazy_names("std_toolkit", {"SE3": "geometry.se3"})("SE3").__name__
    'SE3'
    """

    def attribute(name: str) -> object:
        module = modules.get(name)
        if module is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(importlib.import_module(f"{package}.{module}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute


class _Finder(MetaPathFinder):
    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,  # noqa: ARG002 (Python passes both)
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        """A package of this distribution, not a folder of the user with its name; else None."""
        if fullname not in SIBLINGS:
            return None
        init = Path(__file__).parent.parent / fullname / "__init__.py"
        if not init.is_file():
            return None
        return spec_from_file_location(
            fullname, init, submodule_search_locations=[str(init.parent)]
        )


_FINDER = _Finder()


def install() -> None:
    """Find the packages of this distribution before folders of the user with their names.

    Libraries do not report their use; see `std_toolkit.libraries`.
    """
    libraries.prepare()
    if _FINDER not in sys.meta_path:
        sys.meta_path.insert(0, _FINDER)
