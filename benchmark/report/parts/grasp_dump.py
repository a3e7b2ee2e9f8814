"""Report part of grasp dumps: GraspNet's average precision of grasps of other programs."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from benchmark.evaluation.results import unanswered
from benchmark.evaluation.tasks.grasp_dump import DumpResult, read_dump_results
from benchmark.metrics.grasp.ap import TOP
from benchmark.report.page import ReportPart, table_files, terminal_text
from benchmark.report.parts.depth_tables import counted, machine, run_columns
from std_toolkit.html import page
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

CSV, MARKDOWN, LATEX = "graspnet.csv", "graspnet.md", "graspnet.tex"

_FIGURES = ("ap", "ap08", "ap04", "seen", "similar", "novel")
_COLUMNS = tuple(
    Column(name=name, heading=heading, unit="%", digits=2, lower_is_better=False)
    for name, heading in zip(
        _FIGURES, ("AP", "AP0.8", "AP0.4", "seen", "similar", "novel"), strict=True
    )
)
_NOTES = (
    f"Means over images and frictions of 0.2 to 1.2, best {TOP} grasps. In brackets: 95 % "
    "intervals over scenes. An image without grasps counts 0.",
    "Published figures need `--contacts sdf`.",
)


def dump_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:  # noqa: ARG001
    """See `ReportTask`; no paper's figures are known here.

    Raises:
        ToolkitError: a run is damaged, or none is finished.
    """
    results = read_dump_results(folders)
    groups: dict[str, list[DumpResult]] = {}
    for result in results:
        setup = result.manifest.setup
        name = f"GraspNet {result.place}, {setup.camera}, {setup.contacts} contacts"
        groups.setdefault(name, []).append(result)
    tables, best = [], []
    for name, mine in groups.items():
        table, first = _table(name, mine)
        tables.append(table)
        best += [f"{first.figures.label} on {name} ({first.figures.ap[0]:.2f} %)"] if first else []
    summary = f"Highest AP: {'; '.join(best)}." if best else "No dump answers every image."
    return ReportPart(
        title="Grasps in GraspNet's files",
        summary=summary,
        sections=[
            page.Section("dumps", "Grasps in GraspNet's files", tables),
            page.Section("dump-runs", "What ran: grasps in files", [_run_table(results)]),
        ],
        terminal=terminal_text(tables),
        files=table_files((CSV, MARKDOWN, LATEX), tables, _rows(groups)),
    )


def _table(name: str, results: Sequence[DumpResult]) -> tuple[Table, DumpResult | None]:
    """The table of one data set, and the best dump that answers every image."""
    missing = unanswered(results)
    ordered = sorted(results, key=lambda r: (missing[r.title] > 0, -r.figures.ap[0]))
    ranked = [r for r in ordered if not missing[r.title]]
    best = {n: max((_value(r, n) for r in ranked), default=0.0) for n in _FIGURES}
    rows = []
    for result in ordered:
        count = missing[result.title]
        more = f" ({count} unanswered)" if count else ""
        cells = [
            Cell(text=result.manifest.label),
            Cell(text=f"{result.figures.images}{more}", mark="bad" if count else ""),
        ]
        for column in _COLUMNS:
            figure = getattr(result.figures, column.name)
            if figure is None:
                cells.append(Cell(text=NONE))
                continue
            value, low, high = figure
            is_best = not count and value == best[column.name] > 0
            mark = "best" if is_best else ""
            cells.append(column.cell(value, interval=(low, high), mark=mark))  # type: ignore[arg-type]
        rows.append(Row(cells))
    columns = [Column(heading="grasps", numeric=False), Column(heading="images", digits=0)]
    images = max(r.frames for r in results)
    table = Table(
        columns=[*columns, *_COLUMNS],
        rows=rows,
        title=f"{name}: {images:,} images",
        notes=_NOTES,
        sortable=True,
    )
    return table, ranked[0] if ranked else None


def _value(result: DumpResult, name: str) -> float:
    figure = getattr(result.figures, name)
    return 0.0 if figure is None else float(figure[0])


def _rows(groups: dict[str, list[DumpResult]]) -> pd.DataFrame:
    """A row for each dump, as fractions."""
    rows = []
    for results in groups.values():
        missing = unanswered(results)
        for result in results:
            setup, figures = result.manifest.setup, result.figures
            row: dict[str, object] = {
                "split": result.place,
                "camera": setup.camera,
                "contacts": setup.contacts,
                "grasps": result.manifest.label,
                "images": figures.images,
                "unanswered": missing[result.title],
            }
            for name in _FIGURES:
                figure = getattr(figures, name) or (float("nan"),) * 3
                ends = (name, f"{name}_low", f"{name}_high")
                row |= {n: v / 100 for n, v in zip(ends, figure, strict=True)}
            rows.append(row)
    return pd.DataFrame(rows)


def _run_table(results: Sequence[DumpResult]) -> Table:
    rows = [
        Row(
            [
                Cell(text=r.manifest.label),
                Cell(text=f"{r.place}, {r.manifest.setup.camera}"),
                *counted(r.frames, r.missing, r.failed),
                Cell(text=", ".join([f"{r.manifest.setup.contacts} contacts", *_told(r)])),
                *machine("", r.manifest.hardware, r.manifest.version_of_tool),
            ]
        )
        for r in results
    ]
    return Table(columns=run_columns("grasps", "split, camera"), rows=rows)


def _told(result: DumpResult) -> list[str]:
    """What the author of the grasps says of them."""
    hardware = result.said.hardware if result.said else ""
    trained = f"trained on {result.training_data}" if result.training_data else ""
    return [text for text in (trained, hardware) if text]
