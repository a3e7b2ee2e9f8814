"""The sections of the report that judge labels: numbers, overlays, close-ups."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from math import hypot

from std_toolkit.checks import figures
from std_toolkit.checks.gates import depth_excess_mm, scale_share, shift_px
from std_toolkit.checks.options import CheckOptions
from std_toolkit.checks.overlay import FramePictures
from std_toolkit.checks.result import CheckReport, ObjectCheck
from std_toolkit.html import markup
from std_toolkit.html.markup import Cell, amount, number, percent, tag, text
from std_toolkit.html.plots import object_color

_MEANINGS = {
    "edge distance": "from the contour of the label, along its normal, to the nearest edge of the "
    "image; p90 is over the frames",
    "by chance": "the same for contours put beside it: the label is confirmed only where it does "
    "clearly better",
    "shift": "the shift of the whole contour that fits the image best, where one stands out",
    "depth residual": "label minus sensor on diffuse objects, positive where the label lies behind "
    "the measured surface",
    "without bias": "what is left of it after the part that all diffuse objects share",
    "seems off by": "length of the one shift in the world that best moves the label onto the edges "
    "of all frames",
    "drift": "what that shift leaves in the single frames and no pose of the object can mend: "
    "camera poses, scale, or an object that moved",
}


def labels_section(report: CheckReport, options: CheckOptions) -> str:
    """Table of the objects and figures over frames."""
    if not report.objects:
        return markup.paragraph("The scene has no objects (objects.json).")
    heads = [
        ("object", ""), ("verdict", ""), ("edge distance", "px, median"), ("p90", "px, frames"),
        ("by chance", "px"), ("shift", "px"), ("depth residual", "mm, ± MAD"),
        ("without bias", "mm"),
        ("seems off by", "mm"), ("drift", "px"), ("drift", "mm"), ("label std", "mm"),
        ("visible", "median"),
    ]  # fmt: skip
    share = scale_share(report.summary)
    body = ""
    if any(o.frames_seen for o in report.objects):
        body += markup.table(heads, [_label_row(report, o, share, options) for o in report.objects])
        body += markup.definitions(_MEANINGS)
    else:
        rows = [[name_cell(report, o), tag(o.verdict), text(o.label)] for o in report.objects]
        body += markup.table([("object", ""), ("verdict", ""), ("label", "")], rows)
    return body + _label_figures(report, options)


def _label_figures(report: CheckReport, options: CheckOptions) -> str:
    bias = report.summary.depth_bias
    residual_title = "Depth residual over frames, diffuse objects"
    if bias is not None:
        residual_title += f", common bias of {number(100 * bias, 2)} % taken out"
    found = {
        "Edge distance over frames": figures.frames_figure(
            report.objects,
            lambda f: f.edge_px,
            title="contour to edge",
            unit="px",
            limits=[options.max_edge_px],
        ),
        "Best shift of the contour over frames": figures.frames_figure(
            report.objects,
            lambda f: None if f.shift_px is None else hypot(*f.shift_px),
            title="shift",
            unit="px",
        ),
        residual_title: figures.frames_figure(
            report.objects,
            lambda f: f.depth_mm if bias is None else f.depth_unscaled_mm,
            title="label minus sensor",
            unit="mm",
            limits=[-options.max_depth_mm, options.max_depth_mm],
            from_zero=False,
        ),
        "Visible part over frames": figures.visibility_figure(report.objects),
    }
    return "".join(
        f"<h3>{escape(title)}</h3>{markup.plot(f'frames-{place}', figure)}"
        for place, (title, figure) in enumerate(found.items())
        if figure is not None
    )


def _label_row(
    report: CheckReport, item: ObjectCheck, share: float, options: CheckOptions
) -> list[Cell]:
    excess = depth_excess_mm(item, share)
    residual = number(item.depth_mm, 1, sign=True)
    if item.depth_mad_mm is not None:
        residual += f" ± {item.depth_mad_mm:.1f}"
    return [
        name_cell(report, item),
        tag(item.verdict),
        amount(item.edge_px, 2, over=(item.edge_px or 0) > options.max_edge_px),
        amount(item.edge_p90_px, 2),
        amount(item.edge_chance_px, 2),
        amount(item.shift_px, 2, over=(shift_px(item, options) or 0) > options.max_shift_px),
        Cell(residual, numeric=True, over=(excess or 0) > options.max_depth_mm),
        amount(item.depth_unscaled_mm, 1, sign=True),
        amount(item.offset_norm_mm, 1),
        amount(item.drift_px, 2, over=(item.drift_px or 0) > options.max_drift_px),
        amount(item.drift_mm, 1),
        amount(item.label_std_mm, 1, over=(item.label_std_mm or 0) > options.max_label_std_mm),
        percent(item.visible_fraction),
    ]


def overlays_section(report: CheckReport, pictures: Sequence[FramePictures]) -> str:
    """Whole frames with all outlines, then the close-ups of every object."""
    colors = _colors(report)
    shown = [p for p in pictures if p.overview is not None]
    if not shown:
        return ""
    names = {f.frame: f.name for f in report.frames}
    labelled = [o for o in report.objects if o.label in ("propagated", "refined")]
    body = markup.paragraph(
        "Outlines of the labels over the image; where the label is right the line runs along the "
        "object's edge. Click a picture to enlarge it; the key o hides the outlines."
        if labelled
        else "Frames spread over the recording; there are no labels to draw over them."
    )
    body += (
        '<div class="legend">'
        + "".join(markup.chip(colors[o.object], o.name) for o in labelled)
        + "</div>"
    )
    cards = [
        markup.picture(p.overview, colors, f"frame {p.frame} ({escape(names[p.frame])})")
        for p in shown
        if p.overview is not None
    ]
    body += f'<div class="gallery wide">{"".join(cards)}</div>'
    for item in labelled:
        rows = {f.frame: f for f in item.frames}
        cards = []
        for p in pictures:
            if item.object in p.closeups:
                edge = rows[p.frame].edge_px if p.frame in rows else None
                notes = [f"frame {p.frame}"]
                if p.frame == item.annotated_frame:
                    notes.append("annotated here")
                if edge is not None:
                    notes.append(f"edge {edge:.2f} px")
                caption = escape(", ".join(notes))
                cards.append(markup.picture(p.closeups[item.object], colors, caption))
        if cards:
            body += f"<h3>{markup.chip(colors[item.object], item.name)}</h3>"
            body += f'<div class="gallery small">{"".join(cards)}</div>'
    return body


def name_cell(report: CheckReport, item: ObjectCheck) -> Cell:
    """An object's name in its colour, material and state of its label below."""
    color = _colors(report)[item.object]
    note = f"<small>{escape(item.material)}, {escape(item.label)}</small>"
    return Cell(markup.chip(color, item.name) + note)


def _colors(report: CheckReport) -> dict[int, str]:
    ids = [o.object for o in report.objects]
    return {i: object_color(ids, i) for i in ids}
