"""The page: one HTML file that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from std_toolkit import __version__
from std_toolkit.checks import figures
from std_toolkit.checks.label_sections import labels_section, name_cell, overlays_section
from std_toolkit.checks.options import CheckOptions
from std_toolkit.checks.overlay import FramePictures
from std_toolkit.checks.result import CheckGate, CheckReport
from std_toolkit.html import markup
from std_toolkit.html.markup import CSS, SCRIPT, Cell, amount, number, percent, tag, text
from std_toolkit.html.plots import MATERIAL_COLORS


@dataclass(frozen=True)
class PageParts:
    """What the page shows besides the numbers of the report.

    Attributes:
        view3d: figure JSON of the 3D view.
        sky: figure JSON of the view directions.
        pictures: per frame, in order.
    """

    view3d: str | None
    sky: str | None
    pictures: Sequence[FramePictures]


def render_page(report: CheckReport, parts: PageParts, options: CheckOptions) -> str:
    """The report as HTML."""
    from plotly.offline import get_plotlyjs

    sections = [
        ("gates", "Gates", _gates(report)),
        ("warnings", "Warnings", _warnings(report)),
        ("labels", "Labels", labels_section(report, options)),
        ("overlays", "Overlays", overlays_section(report, parts.pictures)),
        ("scene", "Scene", _scene(report, parts, options)),
        ("coverage", "Coverage", _coverage(report, parts)),
        ("depth", "Sensor depth", _depth(report, parts)),
        ("missing", "Not in this report", _missing(report)),
    ]
    links = "".join(f'<a href="#{k}">{t}</a>' for k, t, body in sections if body)
    state = "pass" if report.passed else "fail"
    word, _, rest = report.verdict.partition(": ")
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(report.scene)}: {escape(word)}</title>"
        '<link rel="icon" href="data:,">'
        f"<style>{CSS}</style></head><body>"
        f'<header><div class="inner"><div class="kind">Label check</div>'
        f"<h1>{escape(report.scene)}</h1>"
        f'<div class="verdict {state}"><b>{escape(word)}</b><span>{escape(rest)}</span></div>'
        f"{_facts(report)}</div></header>"
        f'<nav><div class="inner">{links}<label title="key: o">'
        '<input type="checkbox" id="outlines" checked> outlines</label></div></nav>'
        f"<main>{''.join(markup.section(k, t, body) for k, t, body in sections)}"
        f"<footer>std-toolkit {__version__}, std-curate check. The same numbers: report.json, "
        "report.csv (objects), frames.csv (frames).</footer></main>"
        '<dialog id="large"></dialog>'
        f"<script>{get_plotlyjs()}</script><script>{SCRIPT}</script></body></html>\n"
    )


def _facts(report: CheckReport) -> str:
    s = report.summary
    edges = [o.edge_px for o in report.objects if o.edge_px is not None]
    gates = [g for g in report.gates if g.status != "open"]
    rows = [
        ("gates passed", f"{len(gates) - len(report.failed_gates())} of {len(gates)}", ""),
        ("frames registered", f"{s.registered} of {s.frames}", f"{s.looked_at} looked at"),
        (
            "reprojection",
            f"{number(s.reprojection_px, 2)} px" if s.reprojection_px is not None else "–",
            "",
        ),
        ("objects labelled", f"{s.labelled} of {s.objects}", ""),
        (
            "contour to edge",
            f"{sorted(edges)[len(edges) // 2]:.2f} px" if edges else "–",
            f"worst {max(edges):.2f} px" if edges else "",
        ),
        ("metres from", _scalename_cell(report), _scale_note(report)),
    ]
    return (
        '<div class="facts">'
        + "".join(
            f"<div><span>{escape(a)}</span><b>{b}</b><i>{escape(c)}</i></div>" for a, b, c in rows
        )
        + "</div>"
    )


def _gates(report: CheckReport) -> str:
    rows = [
        [
            tag(g.status, {"open": "not measured"}.get(g.status, g.status)),
            text(g.title, small=g.detail),
            Cell(_with_unit(g, g.value), numeric=True, over=g.status == "fail"),
            Cell(f"{g.rule} {_with_unit(g, g.limit)}", numeric=True),
        ]
        for g in report.gates
    ]
    heads = [("", ""), ("gate", ""), ("measured", ""), ("limit", "")]
    if report.failed_gates():
        heads.append(("what to do", ""))
        for row, gate in zip(rows, report.gates, strict=True):
            row.append(text(gate.advice) if gate.status == "fail" else Cell(""))
    return markup.table(heads, rows)


def _warnings(report: CheckReport) -> str:
    rows = [
        [tag(w.severity), text(w.about), text(w.problem), text(w.advice)]
        for w in report.warnings
        if not w.gate
    ]
    if not rows:
        return markup.paragraph("None besides the gates.")
    return markup.table([("", ""), ("about", ""), ("what", ""), ("what to do", "")], rows)


def _scene(report: CheckReport, parts: PageParts, options: CheckOptions) -> str:
    body = ""
    if parts.view3d is not None:
        body += markup.paragraph(
            "Drag to turn, scroll to zoom, click a name to hide it. The view is turned upright; "
            "lengths are metres."
        )
        body += markup.plot("scene", parts.view3d)
    scale = report.summary.scale
    if scale is not None and scale.estimates:
        rows = [
            [
                text(e.source, small="used" if e.source == scale.chosen else ""),
                amount(e.factor, 5),
                amount(100 * (e.factor / _chosen_factor(report) - 1), 2, sign=True),
                amount(100 * e.spread, 2),
                amount(100 * e.standard_error, 3),
                amount(e.count, 0),
                text(e.note),
            ]
            for e in scale.estimates
        ]
        body += "<h3>Sources of metres</h3>" + markup.table(
            [("source", ""), ("factor", "m per unit"), ("against the used one", "%"),
             ("spread", "%, IQR"), ("standard error", "%"), ("measurements", ""), ("", "")],
            rows,
        )  # fmt: skip
    figure = figures.registration_figure(report, limit_px=options.max_reprojection_px)
    if figure is not None:
        body += "<h3>Camera poses over frames</h3>" + markup.plot("registration", figure)
    return body


def _coverage(report: CheckReport, parts: PageParts) -> str:
    if parts.sky is None:
        return ""
    shown = [o for o in report.objects if o.azimuth_span_deg is not None]
    rows = [
        [
            name_cell(report, o),
            amount(o.frames_seen, 0),
            amount(o.azimuth_span_deg, 0),
            Cell(
                f"{number(o.elevation_deg[0], 0)} to {number(o.elevation_deg[1], 0)}"
                if o.elevation_deg
                else markup.DASH,
                numeric=True,
            ),
            amount(o.parallax_deg, 0),
            amount(o.largest_step_deg, 0),
        ]
        for o in shown
    ]
    heads = [
        ("object", ""), ("views", "frames"), ("azimuth span", "degrees"),
        ("elevation", "degrees"), ("widest pair", "degrees"), ("largest step", "degrees"),
    ]  # fmt: skip
    return (
        markup.paragraph(
            "Each dot is a frame that sees the object: the centre is straight from above, the rim "
            "level with it, and the angle the side it was seen from, 0 degrees being the side of "
            "the first frame. Paler dots see less of it; the star is the annotated frame."
        )
        + markup.plot("sky", parts.sky)
        + markup.table(heads, rows)
    )


def _depth(report: CheckReport, parts: PageParts) -> str:
    if not report.materials:
        return ""
    source = {
        "rendered maps": "the rendered ground truth",
        "labels cast here": "the labels themselves (no rendered ground truth is there)",
    }.get(report.summary.truth_source, "the labels")
    rows = [
        [
            Cell(markup.chip(MATERIAL_COLORS[m.material], m.material)),
            amount(m.objects, 0),
            percent(m.completeness, 1),
            percent(m.within_10mm, 1),
            amount(m.median_mm, 1, sign=True),
            amount(m.mae_mm, 1),
            amount(m.rmse_mm, 1),
            Cell(f"{number(m.p05_mm, 0)} to {number(m.p95_mm, 0)}", numeric=True),
        ]
        for m in report.materials
    ]
    heads = [
        ("material", ""), ("objects", ""), ("measured", "of the pixels"),
        ("within 10 mm", "of the pixels"), ("median", "mm"), ("MAE", "mm"), ("RMSE", "mm"),
        ("5 % to 95 %", "mm"),
    ]  # fmt: skip
    body = markup.paragraph(
        f"Raw sensor depth minus {source}: negative where the sensor reads in front of the object, "
        "positive where it reads behind it, through glass for instance. Errors are over the pixels "
        "that have a reading."
    )
    body += markup.table(heads, rows) + markup.plot(
        "errors", figures.error_figure(report.materials)
    )
    panels = [p for p in parts.pictures if p.depth is not None]
    if panels:
        body += (
            '<h3>Where it is missing or wrong</h3><div class="scalebar">'
            '<span>raw minus truth:</span><span>−20 mm</span><i style="background:linear-gradient('
            '90deg,#2166ac,#92c5de,#fafafa,#f4a582,#b2182b)"></i><span>+20 mm</span>'
            '<i class="chip" style="background:#3a3a40;width:12px"></i>'
            "<span>no reading</span></div>"
        )
    for p in panels:
        assert p.depth is not None
        near, far = p.depth.near_m, p.depth.far_m
        body += (
            '<div class="gallery three">'
            + "".join(
                markup.picture(image, {}, escape(caption))
                for image, caption in (
                    (
                        p.depth.sensor,
                        f"frame {p.frame}: sensor, {near:.2f} m (bright) to {far:.2f} m",
                    ),
                    (p.depth.truth, "labels"),
                    (p.depth.error, "raw minus truth"),
                )
            )
            + "</div>"
        )
    return body


def _missing(report: CheckReport) -> str:
    if not report.missing:
        return ""
    return (
        '<ul class="missing">'
        + "".join(f"<li>{markup.words(m)}</li>" for m in report.missing)
        + "</ul>"
    )


def _with_unit(gate: CheckGate, value: float | None) -> str:
    if value is None:
        return markup.DASH
    return f"{value:.4g} {gate.unit}".rstrip().replace("-", markup.MINUS)


def _chosen_factor(report: CheckReport) -> float:
    scale = report.summary.scale
    assert scale is not None
    return next(
        (e.factor for e in scale.estimates if e.source == scale.chosen), scale.estimates[0].factor
    )


def _scalename_cell(report: CheckReport) -> str:
    scale = report.summary.scale
    if scale is None:
        return "given" if report.summary.registered else "–"
    return "unknown" if scale.unit == "unknown" else escape(scale.chosen)


def _scale_note(report: CheckReport) -> str:
    scale = report.summary.scale
    if scale is None or len(scale.estimates) < 2:
        return ""
    return f"{len(scale.estimates)} sources, differ by {100 * scale.disagreement:.2f} %"
