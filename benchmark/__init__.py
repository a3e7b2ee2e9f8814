"""Data sets, methods, metrics and reports of the benchmark; `Restorer` for one's own camera."""

from importlib import import_module
from typing import TYPE_CHECKING

from std_toolkit.plugins import install

if TYPE_CHECKING:
    from benchmark.restoring.restorer import RestoredFrame, Restorer

__all__ = ["RestoredFrame", "Restorer"]

install()


if not TYPE_CHECKING:  # otherwise type checkers would accept misspelt names

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value: object = getattr(import_module(f"{__name__}.restoring.restorer"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
