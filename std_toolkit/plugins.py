"""Registries of interchangeable parts: built in, installed as entry points, or named by path."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from std_toolkit.errors import ToolkitError

T = TypeVar("T")


class Registry(Generic[T]):
    """Names to plug-ins of one kind.

    A name is looked up among the built-in plug-ins first (`module:attribute` strings, imported
    when first asked for), then among the installed entry points of `group`; a name with a colon
    is imported as `package.module:attribute`.

    Args:
        group: entry-point group, such as `std_toolkit.renderers`.
        builtin: name to `package.module:attribute`.
    """

    def __init__(self, group: str, builtin: dict[str, str]) -> None:
        self.group = group
        self._targets = dict(builtin)

    def names(self) -> list[str]:
        """All known names, built-in ones first."""
        return list(
            dict.fromkeys([*self._targets, *(e.name for e in entry_points(group=self.group))])
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.names())

    def get(self, name: str) -> T:
        """Import and return the plug-in called `name`.

        Raises:
            ToolkitError: no such plug-in, or it cannot be imported.
        """
        if name in self._targets:
            return self._import(self._targets[name])
        for entry in entry_points(group=self.group):
            if entry.name == name:
                return self._loaded(entry.load, entry.value)
        if ":" in name:
            return self._import(name)
        raise ToolkitError(
            f"no plug-in of this name in {self.group}",
            value=name,
            hint=f"known: {', '.join(self.names())}; or give package.module:attribute",
        )

    def _import(self, target: str) -> T:
        module, _, attribute = target.partition(":")
        return self._loaded(lambda: getattr(importlib.import_module(module), attribute), target)

    def _loaded(self, load: Callable[[], Any], target: str) -> T:
        try:
            return load()
        except (Exception, SystemExit) as error:  # importing foreign code can raise anything
            told = " ".join(str(error).split()) or type(error).__name__
            raise ToolkitError(
                f"cannot import plug-in for {self.group}: {told}", value=target
            ) from error
