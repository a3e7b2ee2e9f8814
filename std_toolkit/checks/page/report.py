"""The report as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from std_toolkit import __version__
from std_toolkit.checks import result
from std_toolkit.checks.page import figures, inject_report, label_sections, overlay
from std_toolkit.html import page
from std_toolkit.html.plots import MATERIAL_COLORS
from std_toolkit.html.table import MINUS, NONE, Cell, Column, Row, Table, number
from std_toolkit.scene.model import ScaleReport
from std_toolkit.scene.scale_model import differences


@dataclass(frozen=True)
class PageParts:
    """Figures and images of the page besides the numbers of the report.

    Attributes:
        view3d: figure JSON of the 3D view.
        sky: figure JSON of the view directions.
        pictures: images of each frame, in order.
        shapes: figures of the objects that differ from their meshes.
    """

    view3d: str | None
    sky: str | None
    pictures: Sequence[overlay.FramePictures]
    shapes: Sequence[page.Block] = ()


_TEXT = Column(heading="", numeric=False)
_SCALE_COLUMNS = (
    Column(heading="factor", unit="m per unit", digits=5),
    Column(heading="against the poses", unit="%", factor=100, digits=2, signed=True),
    Column(heading="spread", unit="%, IQR", factor=100, digits=2),
    Column(heading="standard error", unit="%", factor=100, digits=3),
    Column(heading="deviation", unit="%", factor=100, digits=2),
    Column(heading="measurements", digits=0),
)


def render_page(report: result.CheckReport, parts: PageParts) -> str:
    """The report as HTML."""
    word, _, rest = report.verdict.partition(": ")
    return page.Page(
        kind="Label check",
        title=report.scene,
        tab_title=f"{report.scene}: {word}",
        verdicts=[page.Verdict(rest, word, "pass" if report.passed else "fail")],
        facts=_facts(report),
        outlines=True,
        sections=[
            page.Section("gates", "Gates", [_gates(report)]),
            page.Section("warnings", "Warnings", [_warnings(report)]),
            page.Section("labels", "Labels", label_sections.label_blocks(report)),
            page.Section("shape", "Shape and mesh", list(parts.shapes)),
            page.Section(
                "inject",
                "Smallest faults caught",
                inject_report.detectability_blocks(report.detectability)
                if report.detectability
                else [],
            ),
            page.Section(
                "overlays", "Overlays", label_sections.overlay_blocks(report, parts.pictures)
            ),
            page.Section("scene", "Scene", _scene(report, parts)),
            page.Section("coverage", "Coverage", _coverage(report, parts)),
            page.Section("depth", "Sensor depth", _depth(report, parts)),
            page.Section(
                "missing",
                "Not in this report",
                [page.Bullets([page.Paragraph(m) for m in report.missing])],
            ),
        ],
        footer=f"std-toolkit {__version__}, `std-curate check`. The same numbers: `report.json`, "
        "`report.csv` (objects), `frames.csv` (frames).",
    ).html()


def _facts(report: result.CheckReport) -> list[page.Fact]:
    s = report.summary
    edges = sorted(e for o in report.objects if (e := o.value("edge_px")) is not None)
    gates = [g for g in report.gates if g.status != "open"]
    reprojection = number(s.reprojection_px, 2)
    return [
        page.Fact("gates passed", f"{len(gates) - len(report.failed_gates())} of {len(gates)}"),
        page.Fact("frames registered", f"{s.registered} of {s.frames}", f"{s.looked_at} checked"),
        page.Fact("reprojection", reprojection if reprojection == NONE else f"{reprojection} px"),
        page.Fact("objects labelled", f"{s.labelled} of {s.objects}"),
        page.Fact(
            "contour to edge", f"{edges[len(edges) // 2]:.2f} px", f"worst {edges[-1]:.2f} px"
        )
        if edges
        else page.Fact("contour to edge", NONE),
        page.Fact("scale from", *_scale_fact(report)),
    ]


def _gates(report: result.CheckReport) -> Table:
    rows = [
        [
            Cell(text={"open": "not measured"}.get(g.status, g.status), tag=g.status),
            Cell(text=g.title, note=g.detail),
            Cell(text=_with_unit(g, g.value), mark="bad" if g.status == "fail" else ""),
            Cell(text=f"{g.rule} {_with_unit(g, g.limit)}"),
            Cell(text=g.advice if g.status == "fail" else ""),
        ]
        for g in report.gates
    ]
    columns = [
        _TEXT,
        Column(heading="gate", numeric=False),
        Column(heading="measured"),
        Column(heading="limit"),
        Column(heading="what to do", numeric=False),
    ]
    shown = len(columns) if report.failed_gates() else len(columns) - 1
    return Table(columns=columns[:shown], rows=[Row(row[:shown]) for row in rows])


def _warnings(report: result.CheckReport) -> page.Block:
    rows = [
        Row([Cell(text=w.severity, tag=w.severity), *_texts(w.about, w.problem, w.advice)])
        for w in report.warnings
        if not w.gate
    ]
    if not rows:
        return page.Paragraph("None besides the gates.")
    heads = ("about", "problem", "what to do")
    return Table(columns=[_TEXT, *(Column(heading=h, numeric=False) for h in heads)], rows=rows)


def _scene(report: result.CheckReport, parts: PageParts) -> list[page.Block]:
    blocks: list[page.Block] = []
    if parts.view3d is not None:
        blocks += [
            page.Paragraph(
                "Drag to rotate, scroll to zoom, click a name to hide it. The vertical axis is up; "
                "lengths are metres."
            ),
            page.Plot("scene", parts.view3d),
        ]
    sources = _scale_table(report)
    if sources is not None:
        blocks.append(sources)
    figure = figures.registration_figure(report, limit_px=report.gate("reprojection").limit)
    if figure is not None:
        blocks += [page.Heading("Camera poses over frames"), page.Plot("registration", figure)]
    return blocks


def _scale_table(report: result.CheckReport) -> Table | None:
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
        cells = [c.cell(v, missing=NONE) for c, v in zip(_SCALE_COLUMNS, values, strict=True)]
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
            *_SCALE_COLUMNS,
            Column(heading="", numeric=False),
        ],
        rows=rows,
    )


def _scale_fact(report: result.CheckReport) -> tuple[str, str]:
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


def _coverage(report: result.CheckReport, parts: PageParts) -> list[page.Block]:
    if parts.sky is None:
        return []
    columns = [
        Column(heading="object", numeric=False),
        Column(heading="views", unit="frames", digits=0),
        Column(heading="azimuth span", unit="degrees", digits=0),
        Column(heading="elevation", unit="degrees"),
        Column(heading="widest pair", unit="degrees", digits=0),
        Column(heading="largest step", unit="degrees", digits=0),
    ]
    rows = []
    for o in report.objects:
        span = o.value("azimuth_span_deg")
        if span is None:
            continue
        low, high = o.value("elevation_min_deg"), o.value("elevation_max_deg")
        cells = [
            label_sections.name_cell(report, o),
            *_cells(columns[1:3], (o.frames_seen, span)),
            Cell(text=f"{number(low, 0)} to {number(high, 0)}"),
            *_cells(columns[4:], (o.value("parallax_deg"), o.value("largest_step_deg"))),
        ]
        rows.append(Row(cells))
    return [
        page.Paragraph(
            "Each dot is a frame that shows the object. The centre is a view from above, the rim a "
            "horizontal view; the angle is the azimuth, 0 degrees for the first frame. Paler dots "
            "show less of the object; the star is the annotated frame."
        ),
        page.Plot("sky", parts.sky),
        Table(columns=columns, rows=rows),
    ]


def _depth(report: result.CheckReport, parts: PageParts) -> list[page.Block]:
    if not report.materials:
        return []
    source = {
        "rendered maps": "the rendered ground truth",
        "labels cast here": "the labels themselves (no ground truth is rendered)",
    }.get(report.summary.truth_source, "the labels")
    columns = [
        Column(heading="material", numeric=False),
        Column(heading="objects", digits=0),
        Column(heading="measured", unit="% of the pixels", factor=100),
        Column(heading="within 10 mm", unit="% of the pixels", factor=100),
        Column(heading="median", unit="mm", signed=True),
        Column(heading="MAE", unit="mm"),
        Column(heading="RMSE", unit="mm"),
        Column(heading="5 % to 95 %", unit="mm"),
    ]
    rows = []
    for m in report.materials:
        values = (m.objects, m.completeness, m.within_10mm, m.median_mm, m.mae_mm, m.rmse_mm)
        bounds = Cell(text=f"{number(m.p05_mm, 0)} to {number(m.p95_mm, 0)}")
        texture = "original texture (`raw`)" if m.material == "raw" else m.material
        name = Cell(text=texture, color=MATERIAL_COLORS[m.material])
        rows.append(Row([name, *_cells(columns[1:-1], values), bounds]))
    blocks: list[page.Block] = [
        page.Paragraph(
            f"Raw sensor depth minus {source}: negative if the sensor measured in front of the "
            "object, positive if behind it, for example through glass. Errors are over the pixels "
            "with sensor depth."
        ),
        Table(columns=columns, rows=rows),
        page.Plot("errors", figures.error_figure(report.materials)),
    ]
    panels = [(p.frame, p.depth) for p in parts.pictures if p.depth is not None]
    if panels:
        gradient = "linear-gradient(90deg,#2166ac,#92c5de,#fafafa,#f4a582,#b2182b)"
        blocks += [
            page.Heading("Missing and wrong sensor depth"),
            page.Legend(
                [
                    page.LegendEntry(gradient, "raw minus truth, −20 to +20 mm", 180),
                    page.LegendEntry("#3a3a40", "no reading"),
                ]
            ),
        ]
    for frame, depth in panels:
        span = f"{depth.near_m:.2f} m (bright) to {depth.far_m:.2f} m"
        shown = (
            page.Figure(depth.sensor, f"frame {frame}: sensor, {span}"),
            page.Figure(depth.truth, "labels"),
            page.Figure(depth.error, "raw minus truth"),
        )
        blocks.append(page.Gallery(shown, abreast=3))
    return blocks


def _texts(*texts: str) -> list[Cell]:
    return [Cell(text=text) for text in texts]


def _cells(columns: Sequence[Column], values: Sequence[float | None]) -> list[Cell]:
    return [c.cell(v, missing=NONE) for c, v in zip(columns, values, strict=True)]


def _with_unit(gate: result.CheckGate, value: float | None) -> str:
    return NONE if value is None else f"{value:.4g} {gate.unit}".rstrip().replace("-", MINUS)
