"""A comparison as tables for people, spreadsheets and programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from annotator.agreement.agreement import Comparison, ObjectAgreement
from annotator.agreement.merge import Merge
from std_toolkit import __version__
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.documents import write_document

_DIGITS = 4
# What the terminal shows of `object_table`, and under which heading.
_SHOWN = {
    "object": "object",
    "frame": "frame",
    "mssd_mm": "mssd mm",
    "rotation_deg": "turn deg",
    "translation_mm": "shift mm",
    "along_ray_mm": "along mm",
    "sideways_mm": "across mm",
    "shift_px": "px",
    "frames": "frames",
    "median_mm": "median mm",
    "max_mm": "max mm",
    "verdict": "verdict",
}


def object_table(comparison: Comparison) -> pd.DataFrame:
    """One row per object labelled by both, in the order of review."""
    return pd.DataFrame([_row(comparison, x) for x in comparison.objects], columns=list(_COLUMNS))


def frame_table(comparison: Comparison) -> pd.DataFrame:
    """One row per object and common frame."""
    frames = {f.id: f.name for f in comparison.a.scene.frames}
    rows = [
        (x.name, frame, frames[frame], round(1000 * apart, _DIGITS))
        for x in comparison.objects
        for frame, apart in x.mssd_by_frame.items()
    ]
    return pd.DataFrame(rows, columns=["object", "frame", "frame_name", "mssd_mm"])


_COLUMNS = (
    "object",
    "object_b",
    "matched_by",
    "model",
    "verdict",
    "frame",
    "frame_name",
    "mssd_mm",
    "rotation_deg",
    "translation_mm",
    "along_ray_mm",
    "sideways_mm",
    "shift_px",
    "frames",
    "median_mm",
    "max_mm",
    "mostly",
)


def _row(comparison: Comparison, x: ObjectAgreement) -> dict[str, Any]:
    row: dict[str, Any] = {
        "object": x.a.name,
        "object_b": x.b.name,
        "matched_by": x.by,
        "model": x.a.model.id,
        "verdict": x.verdict,
        "frames": len(x.mssd_by_frame),
        "mostly": x.mostly,
    }
    d = x.difference
    if d is None or x.frame is None:
        return row
    numbers = {
        "mssd_mm": 1000 * d.mssd_m,
        "rotation_deg": float(np.rad2deg(d.rotation_rad)),
        "translation_mm": 1000 * d.translation_m,
        "along_ray_mm": 1000 * d.along_ray_m,
        "sideways_mm": 1000 * d.sideways_m,
        "shift_px": d.shift_px,
        "median_mm": 1000 * x.median_m,
        "max_mm": 1000 * x.max_m,
    }
    return {
        **row,
        "frame": x.frame,
        "frame_name": comparison.a.scene.frame(x.frame).name,
        **{key: round(value, _DIGITS) for key, value in numbers.items()},
    }


def comparison_lines(comparison: Comparison) -> list[str]:
    """What the terminal shows: what to review, the table, the rest, a summary."""
    c = comparison
    threshold = f"{c.options.threshold_mm:g} mm"
    lines = [f"{x.name}: {x.mostly if x.difference is None else told(x)}" for x in c.disagreements]
    if lines:
        lines = [f"to review (above {threshold}, or not comparable):", *_indented(lines), ""]
    if c.objects:
        table = c.table[list(_SHOWN)].rename(columns=_SHOWN)
        table["frame"] = table["frame"].astype("Int64").astype(str).replace("<NA>", "-")
        lines += table.to_string(index=False, float_format="%.1f", na_rep="-").splitlines()
        lines.append("")
    for name, alone in ((c.a.name, c.only_a), (c.b.name, c.only_b)):
        if alone:
            lines.append(f"labelled in {name} only: {', '.join(alone)}")
    lines += [f"note: {note}" for note in c.notes]
    lines.append(summary_line(c))
    return lines


def told(x: ObjectAgreement) -> str:
    """How far two labels are apart and what differs mostly."""
    return f"{1000 * x.worst_m:.1f} mm apart; {x.mostly}"


def summary_line(c: Comparison) -> str:
    """The outcome in one sentence."""
    compared = [x for x in c.objects if x.difference is not None]
    if not compared:
        return "no object could be compared"
    apart = sum(x.verdict == "disagree" for x in compared)
    unknown = len(c.objects) - len(compared)
    return (
        f"{len(compared)} objects compared: MSSD median {c.median_mm:.1f} mm, "
        f"largest {c.max_mm:.1f} mm; {apart} above {c.options.threshold_mm:g} mm"
        + (f"; {unknown} not comparable" if unknown else "")
    )


def merge_lines(merge: Merge, root: Path) -> list[str]:
    """What the terminal shows of a merge: a table, what is open, a summary."""
    rows = [
        {
            "object": x.object.name,
            "labelled by": " ".join(y.owner.name for y in x.labelled),
            "apart mm": 1000 * x.apart_m,
            "label": {
                "merged": f"mean of {' '.join(y.owner.name for y in x.used)}",
                "taken": f"that of {' '.join(y.owner.name for y in x.used)}",
                "open": "OPEN",
            }[x.outcome],
        }
        for x in merge.objects
    ]
    table = pd.DataFrame(rows)
    lines = table.to_string(index=False, float_format="%.1f", na_rep="-").splitlines()
    lines.append("")
    if merge.open:
        lines.append("left open, without a label:")
        lines += _indented([f"{x.object.name}: {x.note}" for x in merge.open])
    lines += [f"{x.object.name}: {x.note}" for x in merge.objects if x.note and x.used]
    lines += [f"note: {note}" for note in merge.notes]
    labelled = len(merge.objects) - len(merge.open)
    lines.append(f"{root}: {labelled} of {len(merge.objects)} objects labelled")
    return lines


def write_csv(comparison: Comparison, path: Path) -> None:
    """The table of objects as CSV."""
    write_bytes_atomic(path, comparison.table.to_csv(index=False).encode())


def write_tables(comparison: Comparison, folder: Path) -> list[Path]:
    """Write agreement.csv, frames.csv and agreement.json to `folder`; returns their paths."""
    paths = [folder / name for name in ("agreement.csv", "frames.csv", "agreement.json")]
    write_csv(comparison, paths[0])
    write_bytes_atomic(paths[1], comparison.frame_table.to_csv(index=False).encode())
    write_document(paths[2], _document(comparison))
    return paths


def _document(c: Comparison) -> dict[str, Any]:
    return {
        "version": __version__,
        "a": str(c.a.scene.root),
        "b": str(c.b.scene.root),
        "threshold_mm": c.options.threshold_mm,
        "as_annotated": c.options.as_annotated,
        "objects": [{key: _plain(value) for key, value in _row(c, x).items()} for x in c.objects],
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "notes": list(c.notes),
        "median_mm": _plain(c.median_mm),
        "max_mm": _plain(c.max_mm),
    }


def _plain(value: Any) -> Any:
    """JSON has no NaN: what is not known is null."""
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _indented(lines: list[str]) -> list[str]:
    return [f"  {line}" for line in lines]
