"""Files of clicked 2D-3D correspondences: CSV or JSON of u, v, x, y, z."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import UNITS_IN_M
from std_toolkit.io.documents import read_document

COLUMNS = ("u", "v", "x", "y", "z")


def read_correspondences(
    path: Path | str, *, unit: str = "m"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (N, 3) in metres, mesh frame, and pixels (N, 2) of a correspondence file.

    CSV: a header with the columns u, v, x, y, z in any order (further columns are ignored), or
    five numbers per line without a header. JSON: a list of [u, v, x, y, z] or of objects with
    those keys.

    Args:
        unit: of x, y, z: "m", "cm" or "mm".

    Raises:
        ToolkitError: unreadable, a column missing, or a value that is not a finite number.
    """
    path = Path(path)
    if unit not in UNITS_IN_M:
        raise ToolkitError("unknown unit", path=path, value=unit, hint="one of m, cm, mm")
    rows = _json_rows(path) if path.suffix.lower() == ".json" else _csv_rows(path)
    if not rows:
        raise ToolkitError("the file holds no correspondences", path=path)
    table = np.array(rows, dtype=np.float64)
    if not np.isfinite(table).all():
        raise ToolkitError("a correspondence holds a number that is not finite", path=path)
    return table[:, 2:] * UNITS_IN_M[unit], table[:, :2]


def _csv_rows(path: Path) -> list[list[float]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ToolkitError(f"cannot read the correspondences: {error}", path=path) from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        return []
    columns = [c.strip().lower() for c in next(csv.reader(lines[:1]))]
    if set(COLUMNS) <= set(columns):
        order, lines, first = [columns.index(c) for c in COLUMNS], lines[1:], 2
    elif len(columns) == len(COLUMNS) and _is_number(columns[0]):
        order, first = list(range(5)), 1
    else:
        raise ToolkitError(
            "a correspondence file has the columns u, v, x, y, z", path=path, value=columns
        )
    return [
        _numbers([row[i] for i in order] if len(row) > max(order) else row, path, f"row {n}")
        for n, row in enumerate(csv.reader(lines), start=first)
    ]


def _json_rows(path: Path) -> list[list[float]]:
    document = read_document(path, list[list[float] | dict[str, float]])
    rows = []
    for i, row in enumerate(document):
        if isinstance(row, dict):
            missing = [c for c in COLUMNS if c not in row]
            if missing:
                raise ToolkitError("a key is missing", path=path, field=f"[{i}]", value=missing)
            row = [row[c] for c in COLUMNS]
        rows.append(_numbers(row, path, f"[{i}]"))
    return rows


def _numbers(row: list, path: Path, field: str) -> list[float]:
    if len(row) != len(COLUMNS) or not all(_is_number(x) for x in row):
        raise ToolkitError(
            "a correspondence is five numbers: u, v, x, y, z", path=path, field=field, value=row
        )
    return [float(x) for x in row]


def _is_number(text: object) -> bool:
    try:
        float(text)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True
