"""Table and figures of the smallest faults that the check catches."""

from __future__ import annotations

from typing import Any

from std_toolkit.checks.detectability import Detectability, FaultRow
from std_toolkit.checks.inject.faults import KINDS, FaultKind
from std_toolkit.html import page, plots
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

_SCENE_COLOR = plots.CAMERA
# Larger ratios would compress the part of the curve around the limit.
_LARGEST_RATIO = 4.0


def detectability_table(found: Detectability) -> Table:
    """Smallest fault caught, one row per object and one for the scene.

    A cell reads "5 mm" if 5 mm is caught and the next smaller size tried is not, "5 to 30 mm" if a
    larger size is missed, "> 50 mm" if no size is caught, and has the gates behind it.
    """
    kinds = [k for k in KINDS if any(r.fault == k.name for r in found.rows)]
    names = list(dict.fromkeys(r.name for r in found.rows))
    by_place = {(r.name, r.fault): r for r in found.rows}
    rows = [
        Row([Cell(text=name), *(_cell(by_place.get((name, kind.name))) for kind in kinds)])
        for name in names
    ]
    columns = [
        Column(heading="object", numeric=False),
        *(Column(heading=k.heading) for k in kinds),
    ]
    return Table(
        title="Smallest fault that the check catches",
        columns=columns,
        rows=rows,
        notes=_notes(found),
    )


def detectability_blocks(found: Detectability) -> list[page.Block]:
    """The section of the report."""
    blocks: list[page.Block] = [
        page.Paragraph(
            "Known faults of growing size were put into the scene in memory, and their object was "
            "judged again by all evidence. A smaller fault passes this check."
        ),
        detectability_table(found),
        page.Terms({k.heading: k.title for k in KINDS}),
        page.Paragraph(
            "Curves: gate value divided by its limit, the largest among the gates that the fault "
            "changes. Filled marks are caught. Gates that count (limit 0) catch without a curve "
            "above 1."
        ),
    ]
    for kind in KINDS:
        rows = [r for r in found.rows if r.fault == kind.name and r.trials]
        if rows:
            blocks += [
                page.Heading(kind.title[0].upper() + kind.title[1:]),
                page.Plot(f"inject-{kind.name}", detectability_figure(kind, rows)),
            ]
    return blocks


def detectability_figure(kind: FaultKind, rows: list[FaultRow]) -> str:
    """Gate value over limit against the size of the fault, one curve per object."""
    ids = [r.object for r in rows if r.object is not None]
    traces: list[dict[str, Any]] = []
    for row in rows:
        color = _SCENE_COLOR if row.object is None else plots.object_color(ids, row.object)
        points = [t for t in row.trials if t.ratio is not None]
        traces.append(
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": row.name,
                "x": [t.size for t in points],
                "y": [min(t.ratio or 0.0, _LARGEST_RATIO) for t in points],
                "line_color": color,
                "line_width": 1.5,
                "marker": {
                    "size": 9,
                    "color": color,
                    "symbol": ["circle" if t.caught else "circle-open" for t in points],
                },
                "customdata": [[t.ratio, ", ".join(t.gates) or "no gate"] for t in points],
                "hovertemplate": f"{row.name}, %{{x:g}} {row.unit}<br>%{{customdata[0]:.2f}} of "
                "the limit<br>%{customdata[1]}<extra></extra>",
            }
        )
    return plots.figure(
        traces,
        height=280,
        x=f"{kind.title} ({kind.unit})",
        y="gate value / limit",
        yaxis={"rangemode": "tozero"},
        showlegend=True,
        shapes=[
            {
                "type": "line",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "y0": 1,
                "y1": 1,
                "line": {"color": plots.BAD, "width": 1.2, "dash": "dash"},
            }
        ],
    )


def _cell(row: FaultRow | None) -> Cell:
    if row is None:
        return Cell(text="")
    if row.note:
        return Cell(text=NONE, note=row.note, mark="none")
    if row.caught_from is None:
        return Cell(text=f"> {row.trials[-1].size:g} {row.unit}", note="not caught", mark="bad")
    upto = "" if row.caught_to is None else f" to {row.caught_to:g}"
    return Cell(
        text=f"{row.caught_from:g}{upto} {row.unit}",
        note=f"({', '.join(row.gates)})",
        value=row.caught_from,
    )


def _notes(found: Detectability) -> list[str]:
    notes = [
        f"Measured in {len(found.frames)} frames; sizes are those of a ladder, and each is caught "
        "in both directions."
        + (f" Each smallest size was tried in {n} frames." if (n := found.confirmed_in) else "")
    ]
    if any(row.caught_to is not None for row in found.rows):
        notes.append(
            "Not all larger faults than a second number are caught: so far off, a label may meet "
            "nothing that speaks against it, and is unknown."
        )
    if found.camera_frame is not None and any(r.fault == "camera" for r in found.rows):
        notes.append(f"Camera pose displaced: frame {found.camera_frame}.")
    if not found.passed:
        notes.append(
            "The check fails without a fault, too: objects that do are left out, and of the "
            "scene only further gates count."
        )
    if found.left_out:
        notes.append(f"Without faults: {', '.join(found.left_out)} (--inject-objects 0 takes all).")
    return notes
