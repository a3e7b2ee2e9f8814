"""Report part of the order of points: scores that never stand beside errors of metric depth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from benchmark.evaluation.results import unanswered
from benchmark.evaluation.tasks.order_run import (
    ALL,
    OrderResult,
    order_record,
    order_table,
    read_order_results,
)
from benchmark.report.page import ReportPart, table_files, terminal_text
from benchmark.report.parts.depth_tables import counted, machine, run_columns
from std_toolkit.html import page
from std_toolkit.html.table import Cell, Row, Table

CSV, MARKDOWN, LATEX = "order.csv", "order.md", "order.tex"


def order_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:  # noqa: ARG001
    """See `ReportTask`; `std-bench list published` has what papers print.

    Raises:
        ToolkitError: a run is damaged, or none is finished.
    """
    groups: dict[tuple[str, str], list[OrderResult]] = {}
    for result in read_order_results(folders):
        groups.setdefault((result.place, result.manifest.setup.subset), []).append(result)
    tables, best = [], []
    for (place, subset), mine in groups.items():
        table = order_table(order_record(subset, mine))
        tables.append(replace(table, title=f"{table.title} ({place})", sortable=True))
        missing = unanswered(mine)
        shares = {r.manifest.label: _main(r) for r in mine if not missing[r.title]}
        if shares:
            name = max(shares, key=lambda n: shares[n])
            best.append(f"{name} on {place}, {subset} ({100 * shares[name]:.2f} %)")
    summary = f"Most pairs in order: {'; '.join(best)}." if best else "None answers every photo."
    every = [result for mine in groups.values() for result in mine]
    return ReportPart(
        title="Order of points",
        summary=summary,
        sections=[
            page.Section("order", "Order of points", tables),
            page.Section("order-runs", "What ran: order of points", [_run_table(every)]),
        ],
        terminal=terminal_text(tables),
        files=table_files((CSV, MARKDOWN, LATEX), tables, _rows(groups)),
    )


def _main(result: OrderResult) -> float:
    return result.shares(samples=1).get(("pairs", ALL), (0.0,))[0]


def _rows(groups: dict[tuple[str, str], list[OrderResult]]) -> pd.DataFrame:
    """A row for each run, tuple size and layer, as fractions."""
    rows = []
    for (place, subset), mine in groups.items():
        missing = unanswered(mine)
        for result in mine:
            about = {
                "data": place, "subset": subset, "method": result.manifest.label,
                "photos": result.frames, "unanswered": missing[result.title],
            }  # fmt: skip
            for (size, layer), (value, low, high) in result.shares().items():
                found = {"tuples": size, "layer": layer, "right": value}
                rows.append(about | found | {"right_low": low, "right_high": high})
    return pd.DataFrame(rows)


def _run_table(results: Sequence[OrderResult]) -> Table:
    rows = [
        Row(
            [
                Cell(text=r.manifest.label),
                Cell(text=f"{r.place}, {r.manifest.setup.subset}"),
                *counted(r.frames, r.missing, r.failed),
                Cell(text=f"layers {r.manifest.setup.layers}, .npy {r.manifest.setup.npy}"),
                *machine("", r.manifest.hardware, r.manifest.version_of_tool),
            ]
        )
        for r in results
    ]
    return Table(columns=run_columns("predictions", "data, subset"), rows=rows)
