"""Tables of the report on instance-level poses (BOP), with published figures."""

import math
from collections.abc import Sequence
from pathlib import Path

from benchmark.evaluation.tasks.bop_results import BopFigures, BopObject
from benchmark.published.load import published_bop
from std_toolkit.html.page import Section
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

_FIGURES = ("ar", "ar_vsd", "ar_mssd", "ar_mspd", "ap", "ap_mssd", "ap_mspd")
_HEADINGS = ("AR", "VSD", "MSSD", "MSPD", "mAP", "AP MSSD", "AP MSPD")


def summary(results: Sequence[BopFigures]) -> str:
    """One sentence on the best file."""
    for figure, title in (("ar", "AR"), ("ap", "mAP"), ("ar_mssd", "AR of MSSD")):
        known = [r for r in results if getattr(r, figure) is not None]
        if known:
            best = max(known, key=lambda r: getattr(r, figure))
            value = 100 * getattr(best, figure)
            return f"Highest {title}: {best.results}, {value:.1f} % on {_data(best)}."
    return f"{len(results)} result files."


def sections(results: Sequence[BopFigures], *, published: bool) -> list[Section]:
    """The table of the files, and the tables of their objects."""
    found = [Section("bop", "Poses of known objects (BOP)", [_table(results, published=published)])]
    objects = [_object_table(r.objects, f"{r.results} on {_data(r)}") for r in results if r.objects]
    if objects:
        found.append(Section("bop-objects", "Poses of known objects, by object", objects))
    return found


def _percent_columns() -> list[Column]:
    return [Column(heading=h, unit="%", factor=100, lower_is_better=False) for h in _HEADINGS]


def _table(results: Sequence[BopFigures], *, published: bool) -> Table:
    columns = [
        Column(heading="results", numeric=False),
        Column(heading="data", numeric=False),
        Column(heading="targets", digits=0),
        Column(heading="estimates", digits=0),
        *_percent_columns(),
        Column(heading="time", unit="s/image", digits=2, lower_is_better=True),
    ]
    names = ("targets", "estimates", *_FIGURES, "seconds_per_image")
    rows = []
    for r in sorted(results, key=lambda r: -(r.ar or r.ap or 0)):
        cells = [
            c.cell(getattr(r, n), interval=r.intervals.get(n, (math.nan, math.nan)), missing=NONE)
            for c, n in zip(columns[2:], names, strict=True)
        ]
        rows.append(Row([Cell(text=r.results), Cell(text=_data(r)), *cells]))
    notes = [
        "AR is the mean of the average recalls of VSD, MSSD and MSPD (BOP Challenge 2019 to 2023); "
        "mAP that of the average precisions of MSSD and MSPD in detection (2024)."
    ]
    drawn = sorted({r.intervals_over for r in results if r.intervals_over})
    notes += [f"Brackets: 95 % intervals over {' or '.join(drawn)}."] if drawn else []
    if published:
        data = {Path(r.data).resolve().name for r in results if r.split.startswith("test")}
        printed = published_bop()
        for row in printed[printed["dataset"].isin(data)].itertuples():
            values = (None, None, *(getattr(row, n) for n in (*_FIGURES, "seconds_per_image")))
            cells = [c.cell(v, missing=NONE) for c, v in zip(columns[2:], values, strict=True)]
            name = Cell(text=row.method, note="published")
            rows.append(Row([name, Cell(text=f"{row.dataset}, test"), *cells]))
        sources = sorted(set(printed.loc[printed["dataset"].isin(data), "source"]))
        notes += [f"Published: {'; '.join(sources)}."] if sources else []
    return Table(columns=columns, rows=rows, notes=notes, sortable=True)


def _object_table(objects: Sequence[BopObject], title: str) -> Table:
    columns = [
        Column(heading="object", numeric=False),
        Column(heading="targets", digits=0),
        Column(heading="instances", digits=0),
        *_percent_columns(),
    ]
    rows = [
        Row(
            [
                Cell(text=str(o.obj_id)),
                *(
                    c.cell(getattr(o, n), missing=NONE)
                    for c, n in zip(columns[1:], ("targets", "instances", *_FIGURES), strict=True)
                ),
            ]
        )
        for o in objects
    ]
    return Table(columns=columns, rows=rows, title=title, sortable=True)


def _data(result: BopFigures) -> str:
    return f"{Path(result.data).resolve().name}, {result.split}"
