"""Reports of a comparison: text, CSV, JSON, and images of every disagreement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from annotator.compare.merge_labels import Merge
from std_toolkit import __version__
from std_toolkit.checks.measure.contours import Contour, LabelCaster, trace_contour
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io import atomic, documents, images
from std_toolkit.labels.agreement.annotated_scene import LabelledObject
from std_toolkit.labels.agreement.comparison import Comparison, ObjectAgreement, _row

# Columns of `object_table` shown in the terminal, with their headings.
_SHOWN = {
    "object": "object",
    "frame": "frame",
    "mssd_mm": "mssd mm",
    "rotation_deg": "turn deg",
    "translation_mm": "shift mm",
    "along_ray_mm": "along mm",
    "sideways_mm": "across mm",
    "shift_px": "px",
    "frames": "frames",
    "median_mm": "median mm",
    "max_mm": "max mm",
    "verdict": "verdict",
    "judged_a": "judged A",
    "judged_b": "judged B",
}

PANEL = (640, 480)

CAPTION_PX = 58

# Blue and orange: distinguishable with colour blindness, and visible on most tables.
COLORS = ((60, 150, 255), (255, 140, 0))

_HALO = (10, 12, 16)

_PAPER = (247, 248, 250)

_INK = (31, 41, 51)

_MARGIN = 0.35

_SMALLEST_CROP_PX = 64

_SPREAD = 40

_ID = 1


def comparison_lines(comparison: Comparison) -> list[str]:
    """Return the terminal output: objects to review, table, notes, summary."""
    c = comparison
    threshold = f"{c.options.threshold_mm:g} mm"
    lines = [
        f"{x.name}: {x.mostly if x.difference is None else describe_difference(x)}"
        for x in c.disagreements
    ]
    if lines:
        lines = [f"to review (above {threshold}, or not comparable):", *_indented(lines), ""]
    if c.objects:
        table = c.table[list(_SHOWN)].rename(columns=_SHOWN)
        if all(x.judged.grade == "unknown" for row in c.objects for x in (row.a, row.b)):
            table = table.drop(columns=["judged A", "judged B"])
        table["frame"] = table["frame"].astype("Int64").astype(str).replace("<NA>", "-")
        lines += table.to_string(index=False, float_format="%.1f", na_rep="-").splitlines()
        lines.append("")
    for name, alone in ((c.a.name, c.only_a), (c.b.name, c.only_b)):
        if alone:
            lines.append(f"labelled in {name} only: {', '.join(alone)}")
    refused = [
        f"{x.owner.name}: {x.judged.line()}"
        for row in c.objects
        for x in (row.a, row.b)
        if x.judged.grade in ("doubtful", "wrong")
    ]
    if refused:
        # Two annotators may make the same mistake, such as half a turn.
        lines += ["labels that the images speak against:", *_indented(refused)]
    lines += [f"note: {note}" for note in c.notes]
    lines.append(summary_line(c))
    return lines


def describe_difference(x: ObjectAgreement) -> str:
    """Return the distance of two labels and their main difference as text."""
    return f"{1000 * x.worst_m:.1f} mm apart; {x.mostly}"


def summary_line(c: Comparison) -> str:
    """Return the result in one sentence."""
    compared = [x for x in c.objects if x.difference is not None]
    if not compared:
        return "no object could be compared"
    apart = sum(x.verdict == "disagree" for x in compared)
    unknown = len(c.objects) - len(compared)
    return (
        f"{len(compared)} objects compared: MSSD median {c.median_mm:.1f} mm, "
        f"largest {c.max_mm:.1f} mm; {apart} above {c.options.threshold_mm:g} mm"
        + (f"; {unknown} not comparable" if unknown else "")
    )


def merge_lines(merge: Merge, root: Path) -> list[str]:
    """Return the terminal output of a merge: table, unresolved objects, summary."""
    rows = [
        {
            "object": x.object.name,
            "labelled by": " ".join(y.owner.name for y in x.labelled),
            "apart mm": 1000 * x.apart_m,
            "label": {
                "merged": f"mean of {' '.join(y.owner.name for y in x.used)}",
                "taken": f"that of {' '.join(y.owner.name for y in x.used)}",
                "open": "OPEN",
            }[x.outcome],
        }
        for x in merge.objects
    ]
    table = pd.DataFrame(rows)
    lines = table.to_string(index=False, float_format="%.1f", na_rep="-").splitlines()
    lines.append("")
    if merge.open:
        lines.append("left open, without a label:")
        lines += _indented([f"{x.object.name}: {x.note}" for x in merge.open])
    lines += [f"{x.object.name}: {x.note}" for x in merge.objects if x.note and x.used]
    lines += [f"note: {note}" for note in merge.notes]
    labelled = len(merge.objects) - len(merge.open)
    lines.append(f"{root}: {labelled} of {len(merge.objects)} objects labelled")
    return lines


def write_csv(comparison: Comparison, path: Path) -> None:
    """Write the table of objects as CSV."""
    atomic.write_bytes_atomic(path, comparison.table.to_csv(index=False).encode())


_TABLES = ("agreement.csv", "frames.csv", "agreement.json")


def file_names(comparison: Comparison) -> list[str]:
    """Names of the files that `write_tables` and `write_pictures` write."""
    shown = [row.name for row in comparison.disagreements if row.frame is not None]
    return [*_TABLES, *(f"pictures/{name}.png" for name in shown)]


def write_tables(comparison: Comparison, folder: Path) -> list[Path]:
    """Write agreement.csv, frames.csv and agreement.json to `folder`; returns their paths."""
    paths = [folder / name for name in _TABLES]
    write_csv(comparison, paths[0])
    atomic.write_bytes_atomic(paths[1], comparison.frame_table.to_csv(index=False).encode())
    documents.write_document(paths[2], comparison_document(comparison))
    return paths


def comparison_document(c: Comparison) -> dict[str, Any]:
    return {
        "version": __version__,
        "a": str(c.a.scene.root),
        "b": str(c.b.scene.root),
        "threshold_mm": c.options.threshold_mm,
        "as_annotated": c.options.as_annotated,
        "objects": [{key: _plain(value) for key, value in _row(c, x).items()} for x in c.objects],
        "only_a": list(c.only_a),
        "only_b": list(c.only_b),
        "notes": list(c.notes),
        "median_mm": _plain(c.median_mm),
        "max_mm": _plain(c.max_mm),
    }


def _plain(value: Any) -> Any:
    """Replace NaN by null, because JSON has no NaN."""
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _indented(lines: list[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def write_pictures(comparison: Comparison, folder: Path) -> list[Path]:
    """Write `pictures/OBJECT.png` for every disagreement; returns their paths.

    Left is the annotated frame in which the poses differ most. Right, if there is one, is the frame
    in which they differ most in the image: a difference along the viewing ray of one frame is
    visible from the side in another.
    """
    written = []
    for row in comparison.disagreements:
        if row.frame is None:
            continue
        frames = [row.frame]
        side = _telling_frame(row)
        if side is not None and side != row.frame:
            frames.append(side)
        panels = [_panel(comparison, row, frame) for frame in frames]
        path = folder / "pictures" / f"{row.name}.png"
        images.write_color(path, _sheet(row, panels))
        written.append(path)
    return written


def _sheet(row: ObjectAgreement, panels: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    gap = np.full((panels[0].shape[0], 8, 3), _PAPER, np.uint8)
    body = panels[0] if len(panels) == 1 else np.hstack([panels[0], gap, panels[1]])
    caption = Image.new("RGB", (body.shape[1], CAPTION_PX), _PAPER)
    draw = ImageDraw.Draw(caption)
    large, small = (ImageFont.load_default(size) for size in (17, 14))
    draw.text((12, 8), row.name, fill=_INK, font=large)
    x = 12 + draw.textlength(row.name, font=large) + 22
    for owner, color in zip((row.a.owner, row.b.owner), COLORS, strict=True):
        who = {m.label.annotator for m in (row.a, row.b) if m.owner is owner} - {""}
        text = f"{owner.name} ({who.pop()})" if who else owner.name
        draw.line([(x, 19), (x + 26, 19)], fill=color, width=4)
        draw.text((x + 33, 8), text, fill=_INK, font=large)
        x += 33 + draw.textlength(text, font=large) + 24
    summary = f"{1000 * row.worst_m:.1f} mm apart; {row.mostly}"
    draw.text((12, 34), _cut(draw, summary, body.shape[1] - 24, small), fill=_INK, font=small)
    return np.vstack([np.asarray(caption), body])


def _panel(comparison: Comparison, row: ObjectAgreement, frame: int) -> NDArray[np.uint8]:
    """Return the image around the object, with both outlines."""
    outlines = [_outline(x, frame) for x in (row.a, row.b)]
    image = _image(row, frame)
    height, width = image.shape[:2]
    points = np.concatenate([o.points for o in outlines if o is not None] or [np.zeros((1, 2))])
    low, high = points.min(axis=0), points.max(axis=0)
    size = (high - low) * (1 + 2 * _MARGIN)
    w = max(size[0], size[1] * PANEL[0] / PANEL[1], _SMALLEST_CROP_PX)
    w = min(w, width, height * PANEL[0] / PANEL[1])
    h = w * PANEL[1] / PANEL[0]
    x = float(np.clip((low[0] + high[0] - w) / 2, -0.5, width - 0.5 - w))
    y = float(np.clip((low[1] + high[1] - h) / 2, -0.5, height - 0.5 - h))
    scale = PANEL[0] / w
    # Pixel centres at integers: the panel's pixel (0, 0) shows half a panel pixel inside the crop.
    shift = 0.5 / scale - 0.5
    M = np.array([[scale, 0, -scale * (x + 0.5 + shift)], [0, scale, -scale * (y + 0.5 + shift)]])
    interpolation = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    view = cv2.warpAffine(image, M, PANEL, flags=interpolation, borderMode=cv2.BORDER_REPLICATE)
    for pen, thickness in (("halo", 5), ("color", 2)):
        for outline, color in zip(outlines, COLORS, strict=True):
            if outline is None:
                continue
            for loop in outline.loops:
                drawn = loop @ M[:, :2].T + M[:, 2]
                fixed = np.round(drawn * 16).astype(np.int32).reshape(-1, 1, 2)
                cv2.polylines(
                    view, [fixed], True, _HALO if pen == "halo" else color, thickness,
                    cv2.LINE_AA, shift=4,
                )  # fmt: skip
    name = comparison.a.scene.frame(frame).name
    drawn_panel = Image.fromarray(np.asarray(view, dtype=np.uint8))
    draw = ImageDraw.Draw(drawn_panel)
    font = ImageFont.load_default(14)
    text = f"frame {name}: {1000 * row.mssd_by_frame[frame]:.1f} mm"
    box = draw.textbbox((10, PANEL[1] - 26), text, font=font)
    draw.rectangle([box[0] - 5, box[1] - 3, box[2] + 5, box[3] + 4], fill=_HALO)
    draw.text((10, PANEL[1] - 26), text, fill=(255, 255, 255), font=font)
    return np.asarray(drawn_panel)


def _outline(x: LabelledObject, frame: int) -> Contour | None:
    """Return the unoccluded outline of an object; None if it is out of view or too small."""
    mesh = x.owner.scene.mesh(x.model.id)
    vertices = x.poses[frame] @ np.asarray(mesh.vertices)
    caster = LabelCaster({_ID: (vertices, np.asarray(mesh.faces))})
    camera, here = x.owner.camera(frame), SE3.identity()
    window = caster.window(_ID, camera, here)
    if window is None:
        return None
    x0, y0, x1, y1 = window
    u, v = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
    hits = caster.cast(camera, here, np.stack([u, v], axis=-1).astype(np.float64))
    return trace_contour(caster, camera, here, _ID, hits.object_id == _ID, origin=(x0, y0))


def _image(row: ObjectAgreement, frame: int) -> NDArray[np.uint8]:
    """Return the frame's image from either scene; grey if none can be read."""
    for owner in (row.a.owner, row.b.owner):
        try:
            return owner.scene.read_color(owner.scene.frame(owner.own_frame[frame]))
        except ToolkitError:
            continue
    camera = row.a.owner.camera(frame)
    return np.full((camera.height, camera.width, 3), 128, np.uint8)


def _telling_frame(row: ObjectAgreement) -> int | None:
    """Return the frame showing the object in which the two outlines differ most, or None."""
    frames = sorted(row.mssd_by_frame)
    spread = {frames[int(i)] for i in np.linspace(0, len(frames) - 1, _SPREAD).round()}
    best: tuple[float, int] | None = None
    for frame in sorted(spread):
        camera = row.a.owner.camera(frame)
        shown = camera.project(row.a.poses[frame] @ row.a.outline)
        other = row.b.owner.camera(frame).project(row.b.poses[frame] @ row.b.outline)
        # Skip frames in which most of the object is outside the image.
        inside = (shown > 0).all(axis=1) & (shown < camera.size).all(axis=1)
        if inside.mean() < 0.7:
            continue
        # Symmetric variants look the same: compare the silhouettes' boxes, not the points.
        apart = max(
            float(np.abs(shown.min(axis=0) - other.min(axis=0)).max()),
            float(np.abs(shown.max(axis=0) - other.max(axis=0)).max()),
        )
        if np.isfinite(apart) and (best is None or apart > best[0]):
            best = apart, frame
    return None if best is None else best[1]


def _cut(
    draw: ImageDraw.ImageDraw,
    text: str,
    width: float,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
) -> str:
    while draw.textlength(text, font=font) > width and len(text) > 4:
        text = text[:-4].rstrip() + "..."
    return text
