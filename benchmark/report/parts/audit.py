"""Report part of audits: how far the labels of data sets are from their images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from benchmark.evaluation.audit.record import PICTURES, Audit, AuditedLabel, AuditedScene, Size
from benchmark.evaluation.audit.run import flat
from benchmark.evaluation.query_options import AUDIT_FILE
from benchmark.report.page import MOST_PICTURED, ReportPart, table_files, terminal_text
from std_toolkit.html import page
from std_toolkit.html.table import NONE, Cell, Column, Row, Table
from std_toolkit.io.documents import read_document

CSV, MARKDOWN, LATEX = "labels.csv", "labels.md", "labels.tex"
_ORDER = ("wrong", "doubtful", "unknown", "fits")
_MARKS = {"wrong": "bad", "doubtful": "bad", "unknown": "none", "fits": ""}
# Rows of one scene on the page; the others are in the CSV files.
_MOST_ROWS = 400
_MM = Column(heading="error", unit="mm")
_ACROSS = Column(heading="across the view", unit="mm")
_DEG = Column(heading="error", unit="deg")
_NOTES = (
    "Error: from the label to where contour, texture and sensor depth put the object. In brackets: "
    "the smallest and largest error in the 95 % region of that measurement.",
    "Verdicts are those of `std-curate check`: unknown is no evidence, and no good news.",
)


def audit_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:  # noqa: ARG001
    """See `ReportTask`; papers state no such figures.

    Raises:
        ToolkitError: an audit is damaged.
    """
    places = [path.parent for folder in folders for path in sorted(folder.rglob(AUDIT_FILE))]
    audits = [(place, read_document(place / AUDIT_FILE, Audit)) for place in places]
    tables, sections, summaries = [], [], []
    for k, (place, audit) in enumerate(audits):
        objects, table = _objects_table(audit), _labels_table(audit)
        tables += [objects, table]
        summaries.append(_summary(audit))
        sections += [
            page.Section(f"objects-{k}", f"Objects of {audit.set}", [objects]),
            page.Section(f"labels-{k}", f"Labels of {audit.set}", [table]),
            page.Section(f"frames-{k}", f"Frames that disagree: {audit.set}", _frames(audit)),
            page.Section(f"pictures-{k}", f"Labels in the images: {audit.set}",
                         _pictures(place, audit)),
            page.Section(f"scenes-{k}", f"Scenes of {audit.set}", [_scenes_table(audit)]),
            page.Section(f"unseen-{k}", f"What this audit cannot see: {audit.set}",
                         [page.Bullets([page.Paragraph(text) for text in audit.unseen])]),
        ]  # fmt: skip
    rows = [{"set": a.set, **flat(x)} for _, a in audits for x in a.labels]
    return ReportPart(
        title="Labels of data sets",
        summary=" ".join(summaries),
        sections=sections,
        terminal=terminal_text(tables),
        files=table_files((CSV, MARKDOWN, LATEX), tables, pd.DataFrame(rows)),
    )


def _summary(audit: Audit) -> str:
    counts = audit.counts()
    known = [x.error_mm.value for x in audit.labels if x.error_mm is not None]
    deg = [x.error_deg.value for x in audit.labels if x.error_deg is not None]
    typical = ""
    if known:
        mm, angle = float(pd.Series(known).median()), float(pd.Series(deg).median())
        typical = f" Typical error: {mm:.1f} mm and {angle:.1f} deg ({len(known)} measured)."
    words = ", ".join(f"{counts[name]} {name}" for name in _ORDER)
    return f"{audit.set}: {len(audit.labels)} labels judged: {words}.{typical}"


def _objects_table(audit: Audit) -> Table:
    rows = [
        Row(
            [
                Cell(text=x.scene),
                Cell(text=x.object),
                Cell(text=x.material),
                Cell(text=str(x.labels), value=x.labels),
                Cell(text=str(x.measured), value=x.measured),
                Cell(text=str(x.refused), value=x.refused, mark="bad" if x.refused else ""),
                _size(_MM, x.error_mm),
                _size(_DEG, x.error_deg),
            ]
        )
        for x in audit.objects()
    ]
    return Table(
        columns=[
            *(Column(heading=h, numeric=False) for h in ("scene", "object", "material")),
            *(Column(heading=h, digits=0) for h in ("judged", "measured", "refused")),
            _MM, _DEG,
        ],
        rows=rows,
        title=f"Objects of {audit.set}: {len(rows)}",
        notes=(
            "Judged: labels of frames that were judged alone, or of all frames together. Errors: "
            "medians over those that were measured, and of their bounds.",
        ),
        sortable=True,
    )  # fmt: skip


def _labels_table(audit: Audit) -> Table:
    shown = sorted(audit.labels, key=lambda x: _ORDER.index(x.verdict))[:_MOST_ROWS]
    left = len(audit.labels) - len(shown)
    notes = [*_NOTES, *([f"{left} more rows are in {CSV}."] if left else [])]
    headings = ("scene", "frame", "object", "material")
    return Table(
        columns=[
            *(Column(heading=h, numeric=False) for h in headings),
            Column(heading="frames", digits=0), _MM, _ACROSS, _DEG,
            Column(heading="verdict", numeric=False), Column(heading="why", numeric=False),
        ],
        rows=[_label_row(x) for x in shown],
        title=f"Labels of {audit.set}: {len(audit.labels)}",
        notes=notes,
        sortable=True,
    )  # fmt: skip


def _label_row(label: AuditedLabel) -> Row:
    mark = _MARKS[label.verdict]
    return Row(
        [
            Cell(text=label.scene),
            Cell(text=label.frame or "all"),
            Cell(text=label.object),
            Cell(text=label.material),
            Cell(text=str(label.frames), value=label.frames),
            _size(_MM, label.error_mm),
            _size(_ACROSS, label.across_mm),
            _size(_DEG, label.error_deg),
            Cell(text=label.verdict, mark=mark),  # type: ignore[arg-type]
            Cell(text=label.reason),
        ]
    )


def _size(column: Column, size: Size | None) -> Cell:
    if size is None:
        return Cell(text=NONE, value=math.nan)
    return column.cell(size.value, interval=(size.low, size.high))


def _frames(audit: Audit) -> list[page.Block]:
    if not audit.disagreements:
        return []
    headings = ("scene", "frame", "object", "what disagrees")
    rows = [
        Row([Cell(text=d.scene), Cell(text=d.frame or "all"), Cell(text=d.object or "(frame)"),
             Cell(text=d.what)])
        for d in audit.disagreements[:_MOST_ROWS]
    ]  # fmt: skip
    table = Table(
        columns=[Column(heading=h, numeric=False) for h in headings],
        rows=rows,
        title=f"Frames in which labels and images disagree: {len(audit.disagreements)}",
        sortable=True,
    )
    return [table]


def _pictures(place: Path, audit: Audit) -> list[page.Block]:
    shown = [x for x in audit.labels if x.picture][:MOST_PICTURED]
    if not shown:
        return []
    figures = [
        page.Figure(
            page.Picture.read(place / PICTURES, x.picture, width=480),
            f"{x.scene} {x.frame} {x.object}: {x.reason}",
        )
        for x in shown
    ]
    entries = (("#d62728", "label"), ("#2ca02c", "where the evidence puts the object"))
    legend = page.Legend([page.LegendEntry(color, text) for color, text in entries])
    return [legend, page.Gallery(figures, layout="small")]


def _scenes_table(audit: Audit) -> Table:
    columns = [
        Column(heading="scene", numeric=False),
        Column(heading="frames read", numeric=False),
        Column(heading="camera poses", numeric=False),
        Column(heading="labels", digits=0),
        Column(heading="between frames, median", numeric=False),
        Column(heading="largest", numeric=False),
        Column(heading="rotations off", numeric=False),
        Column(heading="overlaps", digits=0),
        Column(heading="unreadable", digits=0),
    ]
    return Table(
        columns=columns,
        rows=[_scene_row(s, audit) for s in audit.scenes],
        title=f"Scenes of {audit.set}",
        notes=(
            "Between frames: how far labels of one object that stands still lie from each other. "
            "Rotations off: those that are not orthonormal, and the largest entry of R R^T - I.",
        ),
        sortable=True,
    )


def _scene_row(scene: AuditedScene, audit: Audit) -> Row:
    overlaps = sum(x.scene == scene.scene and x.overlap_mm is not None for x in audit.labels)
    rough = f"{scene.rough} (up to {scene.rough_most:.1e})" if scene.rough else "0"
    return Row(
        [
            Cell(text=scene.scene),
            Cell(text=f"{scene.looked_at} of {scene.frames}"),
            Cell(text=scene.cameras),
            Cell(text=str(scene.labels), value=scene.labels),
            Cell(text=_apart(scene.off_mm, scene.off_deg)),
            Cell(text=_apart(scene.off_most_mm, scene.off_most_deg)),
            Cell(text=rough),
            Cell(text=str(overlaps), value=overlaps),
            Cell(text=str(len(scene.problems)), value=len(scene.problems)),
        ]
    )


def _apart(mm: float | None, deg: float | None) -> str:
    return NONE if mm is None or deg is None else f"{mm:.2f} mm, {deg:.2f} deg"
