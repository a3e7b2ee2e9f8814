"""Functions compiled to machine code; see `std_toolkit.compiled`."""

from __future__ import annotations

from std_toolkit.errors import ToolkitError

try:
    from std_toolkit.compiled import compiled
except ModuleNotFoundError as error:
    raise ToolkitError(
        f"the compiler of the sensors' inner loops is not installed: {error}",
        hint="pip install 'std-toolkit[sim]'",
    ) from error

__all__ = ["compiled"]
