"""Section of the report on the metric scale: all sources with their deviations."""

from __future__ import annotations

import msgspec

from std_toolkit.checks.result import CheckReport
from std_toolkit.html.table import NONE, Cell, Column, Row, Table
from std_toolkit.scene.model import ScaleReport
from std_toolkit.scene.scale_model import differences

_COLUMNS = (
    Column(heading="factor", unit="m per unit", digits=5),
    Column(heading="against the poses", unit="%", factor=100, digits=2, signed=True),
    Column(heading="spread", unit="%, IQR", factor=100, digits=2),
    Column(heading="standard error", unit="%", factor=100, digits=3),
    Column(heading="deviation", unit="%", factor=100, digits=2),
    Column(heading="measurements", digits=0),
)


def scale_table(report: CheckReport) -> Table | None:
    """All scale sources, and the sizes of the objects measured by the check; None without any."""
    scale, sizes = report.summary.scale, report.summary.sizes
    if scale is None and sizes is not None:
        scale = ScaleReport(unit="metre", chosen="given", factor=1.0)
    if scale is None or not (scale.estimates or sizes):
        return None
    applied = scale.applied_factor
    estimates = list(scale.estimates)
    if sizes is not None:
        estimates.append(msgspec.structs.replace(sizes, factor=applied * sizes.factor))
    used = {e.source for e in scale.used()}
    rows = []
    for e in estimates:
        values = (e.factor, e.factor / applied - 1, e.spread, e.standard_error, e.sigma, e.count)
        note = "used" if e.source in used else "check" if e is estimates[-1] and sizes else ""
        cells = [c.cell(v, missing=NONE) for c, v in zip(_COLUMNS, values, strict=True)]
        rows.append(Row([Cell(text=e.source, note=note), *cells, Cell(text=e.note)]))
    mean = ", the mean of the used sources, weighted by inverse variance" if len(used) > 1 else ""
    notes = [
        f"The camera poses have {applied:.6g} m per unit ({scale.chosen}), with a deviation of "
        f"{100 * scale.applied_sigma:.2f} %{mean}. Deviations include the systematic error of the "
        "kind of source.",
        *(f"{d}." for d in differences(scale.estimates)),
    ]
    if sizes is not None:
        notes.append(
            "sizes: the labelled objects' CAD sizes against the camera poses, measured here."
        )
    return Table(
        title="Sources of metric scale",
        notes=notes,
        columns=[
            Column(heading="source", numeric=False),
            *_COLUMNS,
            Column(heading="", numeric=False),
        ],
        rows=rows,
    )


def scale_fact(report: CheckReport) -> tuple[str, str]:
    """Source of the metric scale, and the largest difference of its sources."""
    scale = report.summary.scale
    if scale is None:
        return "given" if report.summary.registered else NONE, ""
    name = "unknown" if scale.unit == "unknown" else scale.chosen
    if len(scale.estimates) < 2:
        return name, f"+- {100 * scale.applied_sigma:.2f} %" if scale.unit == "metre" else ""
    worst = differences(scale.estimates)[0]
    text = f"{len(scale.estimates)} sources, differ by {100 * worst.relative:.2f} %"
    return name, f"{text} ({worst.sigma:.1f} standard deviations)"
