"""report.csv and frames.csv: the report's numbers for a spreadsheet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from std_toolkit.checks.result import CheckReport

_PARTS = {
    "offset_mm": ("offset_x_mm", "offset_y_mm", "offset_z_mm"),
    "elevation_deg": ("elevation_min_deg", "elevation_max_deg"),
}


def objects_csv(report: CheckReport) -> bytes:
    """One row per object; lists become one column per number."""
    from std_toolkit.checks.result import ObjectCheck

    rows = [_flat(msgspec.to_builtins(item)) for item in report.objects]
    names = [f.name for f in msgspec.structs.fields(ObjectCheck) if f.name != "frames"]
    return _csv(rows, [part for name in names for part in _PARTS.get(name, (name,))])


def frames_csv(report: CheckReport) -> bytes:
    """One row per frame of the recording."""
    from std_toolkit.checks.result import FrameCheck

    rows = [msgspec.to_builtins(frame) for frame in report.frames]
    return _csv(rows, [f.name for f in msgspec.structs.fields(FrameCheck)])


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    row.pop("frames")
    for name, parts in _PARTS.items():
        values = row.pop(name) or [None] * len(parts)
        row |= dict(zip(parts, values, strict=True))
    return row


def _csv(rows: Sequence[dict[str, Any]], columns: list[str]) -> bytes:
    import pandas as pd

    # dtype object: a column of whole numbers with a gap must not turn into floats.
    table = pd.DataFrame(list(rows), columns=columns, dtype=object)
    return str(table.to_csv(index=False, lineterminator="\n")).encode()
