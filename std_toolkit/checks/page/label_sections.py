"""Report sections on labels: numbers, overlays, close-ups."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

from std_toolkit.checks import result
from std_toolkit.checks.page import figures, overlay
from std_toolkit.html import page
from std_toolkit.html.plots import object_color
from std_toolkit.html.table import NONE, Cell, Column, Row, Table, number

_MEANINGS = {
    "edge distance": "distance from the contour of the label, along its normal, to the nearest "
    "image edge; p90 is over the frames",
    "by chance": "edge distance of displaced contours; the image supports a label only if its own "
    "distance is clearly smaller",
    "shift": "shift of the whole contour that fits the image best, if one is clear",
    "depth residual": "label minus sensor depth on diffuse objects; positive if the label is "
    "behind the measured surface",
    "without bias": "depth residual without the part that all diffuse objects share",
    "seems off by": "length of the translation in the world that fits the label best to the edges "
    "of all frames",
    "drift": "shift that remains in single frames after this translation; caused by camera poses, "
    "scale, or an object that moved",
}


# Columns of values, each with its key and the gate on it.
_VALUES = (
    (Column(heading="edge distance", unit="px, median", digits=2), "edge_px", "edges"),
    (Column(heading="p90", unit="px, frames", digits=2), "edge_p90_px", ""),
    (Column(heading="by chance", unit="px", digits=2), "edge_chance_px", ""),
    (Column(heading="shift", unit="px", digits=2), "shift_px", "shift"),
    (Column(heading="depth residual", unit="mm, ± MAD", signed=True), "depth_mm", "depth"),
    (Column(heading="without bias", unit="mm", signed=True), "depth_unscaled_mm", ""),
    (Column(heading="seems off by", unit="mm"), "offset_mm", ""),
    (Column(heading="drift", unit="px", digits=2), "drift_px", "drift"),
    (Column(heading="drift", unit="mm"), "drift_mm", ""),
    (Column(heading="label std", unit="mm"), "label_std_mm", "covariance"),
    (Column(heading="visible", unit="%, median", factor=100, digits=0), "visible_fraction", ""),
)
_NAMED = (Column(heading="object", numeric=False), Column(heading="verdict", numeric=False))
_TEXTURE = Column(heading="texture", numeric=False)


def label_blocks(report: result.CheckReport) -> list[page.Block]:
    """Table of the objects and figures over frames."""
    if not report.objects:
        return [page.Paragraph("The scene has no objects (`objects.json`).")]
    if any(o.frames_seen for o in report.objects):
        columns = (*_NAMED, *(column for column, _, _ in _VALUES), _TEXTURE)
        blocks: list[page.Block] = [
            Table(columns=columns, rows=[_label_row(report, o) for o in report.objects]),
            page.Terms(_MEANINGS),
        ]
    else:
        rows = [
            Row([name_cell(report, o), Cell(text=o.verdict, tag=o.verdict), Cell(text=o.label)])
            for o in report.objects
        ]
        blocks = [Table(columns=(*_NAMED, Column(heading="label", numeric=False)), rows=rows)]
    return blocks + _label_figures(report)


def _label_figures(report: result.CheckReport) -> list[page.Block]:
    depth_limit = report.gate("depth").limit
    bias = report.summary.depth_bias
    residual_title = "Depth residual over frames, diffuse objects"
    if bias is not None:
        residual_title += f", common bias of {number(100 * bias, 2)} % removed"
    found = {
        "Edge distance over frames": figures.frames_figure(
            report.objects,
            lambda f: f.edge_px,
            title="contour to edge",
            unit="px",
            limits=[report.gate("edges").limit],
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
            limits=[-depth_limit, depth_limit],
            from_zero=False,
        ),
        "Visible fraction over frames": figures.visibility_figure(report.objects),
    }
    blocks: list[page.Block] = []
    for place, (title, figure) in enumerate(found.items()):
        if figure is not None:
            blocks += [page.Heading(title), page.Plot(f"frames-{place}", figure)]
    return blocks


def _label_row(report: result.CheckReport, item: result.ObjectCheck) -> Row:
    bad = {f.gate for f in item.gates if f.verdict == "wrong"}
    cells = [name_cell(report, item), Cell(text=item.verdict, tag=item.verdict)]
    for column, name, gate in _VALUES:
        text = column.text(item.value(name)) or NONE
        mad = item.value("depth_mad_mm")
        if name == "depth_mm" and mad is not None:
            text += f" ± {mad:.1f}"
        cells.append(Cell(text=text, mark="bad" if gate in bad else ""))
    texture = item.text("texture")
    shown = item.text("texture_rival") if texture == "turned" else texture
    cells.append(Cell(text=shown or NONE, mark="bad" if "texture" in bad else ""))
    return Row(cells)


def overlay_blocks(
    report: result.CheckReport, pictures: Sequence[overlay.FramePictures]
) -> list[page.Block]:
    """Whole frames with all outlines, then the close-ups of every object."""
    colors = _colors(report)
    names = {f.frame: f.name for f in report.frames}
    whole = [
        page.Figure(p.overview, f"frame {p.frame} ({names[p.frame]})", colors)
        for p in pictures
        if p.overview is not None
    ]
    if not whole:
        return []
    labelled = [o for o in report.objects if o.is_labelled]
    about = (
        "Outlines of the labels over the image; the outline of a correct label follows the edge of "
        "the object. Click an image to enlarge it; press o to hide the outlines."
        if labelled
        else "Frames spread over the recording; the scene has no labels to draw."
    )
    legend = page.Legend([page.LegendEntry(colors[o.object], o.name) for o in labelled])
    blocks: list[page.Block] = [page.Paragraph(about), legend, page.Gallery(whole, layout="wide")]
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
                cards.append(page.Figure(p.closeups[item.object], ", ".join(notes), colors))
        if cards:
            blocks.append(page.Heading(item.name, color=colors[item.object]))
            blocks.append(page.Gallery(cards, layout="small"))
    return blocks


def name_cell(report: result.CheckReport, item: result.ObjectCheck) -> Cell:
    """The name of an object in its colour, with material and label state below."""
    note = f"{item.material}, {item.label}"
    return Cell(text=item.name, note=note, color=_colors(report)[item.object])


def _colors(report: result.CheckReport) -> dict[int, str]:
    ids = [o.object for o in report.objects]
    return {i: object_color(ids, i) for i in ids}
