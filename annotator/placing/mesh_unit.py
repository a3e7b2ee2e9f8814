"""In which unit a mesh file is written, as far as its size tells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import UNITS_IN_M, load_mesh, mesh_extents

Unit = Literal["m", "cm", "mm"]
UNITS: tuple[Unit, ...] = ("m", "mm", "cm")
# What lies on a table is about so large; it decides which of two plausible units comes first.
_USUAL_SIZE_M = 0.15


@dataclass(frozen=True)
class MeshSize:
    """Size of a mesh, and the units in which a table-top object has it.

    Attributes:
        extents: (x, y, z) of the bounding box in the numbers of the file.
        units: plausible ones, the likeliest first; metres alone where they are plausible.
    """

    extents: tuple[float, float, float]
    units: tuple[Unit, ...]

    def in_mm(self, unit: Unit) -> tuple[float, float, float]:
        """Extents in millimetres if the file is in `unit`."""
        factor = 1000 * UNITS_IN_M[unit]
        x, y, z = self.extents
        return x * factor, y * factor, z * factor


def measure_mesh(path: Path) -> MeshSize:
    """Size and plausible units of a mesh file.

    Raises:
        ToolkitError: unreadable, without faces, or of a size that no table-top object has in any
            unit.
    """
    found: dict[Unit, np.ndarray] = {}
    first: ToolkitError | None = None
    for unit in UNITS:
        try:
            found[unit] = mesh_extents(load_mesh(path, unit=unit)) / UNITS_IN_M[unit]
        except ToolkitError as error:
            first = first or error
            if "implausibly" not in error.problem:
                raise
        else:
            if unit == "m":
                break
    if not found:
        assert first is not None
        raise ToolkitError(
            "the mesh has a size that no object on a table has, in metres, centimetres or "
            "millimetres",
            path=path,
            value=first.value,
            hint="scale it in the program that made it",
        )
    x, y, z = (float(v) for v in next(iter(found.values())))
    size = max(x, y, z)
    order = sorted(found, key=lambda u: abs(np.log(size * UNITS_IN_M[u] / _USUAL_SIZE_M)))
    return MeshSize((x, y, z), tuple(order))
