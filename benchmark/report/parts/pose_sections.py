"""The sections on poses: tables, breakdowns, pictures, what ran.

Figures of poses, as Plotly JSON.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
import pandas as pd

from benchmark.evaluation.tasks.pose_inputs import RAW, TRUE
from benchmark.evaluation.tasks.pose_pictures import PICTURES_FILE, POSE_GALLERY, PosePictures
from benchmark.evaluation.tasks.pose_results import ALL, HARD, PoseResult, RunName, heading
from benchmark.report.leaderboard import MEASURED, PAPERS_PROTOCOL, PUBLISHED
from benchmark.report.parts.pose_board import DETAILS, FIGURES, MAIN, PoseBoard
from std_toolkit.html.markup import Cell, paragraph, plot, table, words
from std_toolkit.html.plots import FAINT, OBJECT_COLORS, base_layout, figure_json
from std_toolkit.io.documents import read_document

_RAW_COLOR, _TRUE_COLOR = FAINT, "#2b7a4b"

_OBJECTS = {ALL: "All objects", HARD: "Specular and transparent"}

_FEW_SCENES = 10

_ABREAST = 4  # pictures in a row


def depth_colors(depths: list[str]) -> dict[str, str]:
    """The colour of each depth: raw grey, true green, restored ones of their own."""
    restored = [d for d in dict.fromkeys(depths) if d not in (RAW, TRUE)]
    colors = [c for c in OBJECT_COLORS if c != _TRUE_COLOR]
    found = {depth: colors[i % len(colors)] for i, depth in enumerate(restored)}
    return {RAW: _RAW_COLOR, **found, TRUE: _TRUE_COLOR}


def columns_by_depth(rows: pd.DataFrame, method: str, fit: str) -> str | None:
    """Bars of all figures of a method, one colour for each depth, with intervals.

    Args:
        rows: of one split, protocol and subset.
        method, fit: whose.
    """
    chosen = rows[(rows["kind"] == MEASURED) & (rows["method"] == method) & (rows["fit"] == fit)]
    if len(chosen) < 2:
        return None
    colors = depth_colors(rows.loc[rows["kind"] == MEASURED, "depth"].tolist())
    headings = [column.heading for column in FIGURES]
    traces = []
    for _, row in chosen.iterrows():
        values = [100 * row[c.name] for c in FIGURES]
        trace = {
            "type": "bar",
            "name": f"{row['depth']} depth",
            "x": headings,
            "y": values,
            "marker": {"color": colors[row["depth"]]},
            "hovertemplate": "%{x}: %{y:.1f} %<extra>" + row["depth"] + "</extra>",
        }
        if chosen[f"{FIGURES[0].name}_low"].notna().all():
            up = [100 * row[f"{c.name}_high"] - v for c, v in zip(FIGURES, values, strict=True)]
            down = [v - 100 * row[f"{c.name}_low"] for c, v in zip(FIGURES, values, strict=True)]
            trace["error_y"] = {
                "type": "data",
                "array": [max(0.0, x) for x in up],
                "arrayminus": [max(0.0, x) for x in down],
                "thickness": 1,
                "width": 3,
                "color": "#52606d",
            }
        traces.append(trace)
    layout = base_layout(
        height=320,
        yaxis={"title": {"text": "right [%]"}, "range": [0, 103]},
        barmode="group",
        bargap=0.25,
    )
    return figure_json(traces, layout)


def pose_tables(board: PoseBoard, split: str, protocol: str) -> str:
    """Tables and bars of one split by one protocol."""
    parts = []
    for subset, title in _OBJECTS.items():
        rows = board.part(split, protocol, subset)
        measured = rows[rows["kind"] == MEASURED]
        if measured.empty:
            continue
        scenes, objects = int(measured["scenes"].max()), int(measured["objects"].max())
        parts.append(f"<h3>{title}</h3>")
        parts.append(paragraph(f"{objects} true objects in {scenes} scenes. {_small(scenes)}"))
        if protocol != PAPERS_PROTOCOL and (rows["kind"] == PUBLISHED).any():
            parts.append(
                paragraph(
                    "Published rows were made by the paper's own evaluation, protocol `paper`, "
                    "in which what is missed costs nothing: here they tell the order of magnitude."
                )
            )
        parts.append(_table(rows))
        if protocol != PAPERS_PROTOCOL:
            for method, fit in measured[["method", "fit"]].drop_duplicates().to_numpy().tolist():
                figure = columns_by_depth(rows, method, fit)
                if figure is not None:
                    parts.append(f"<h4>{escape(method)}, fit {escape(fit)}</h4>")
                    parts.append(plot(_anchor("bars", split, subset, method, fit), figure))
    return "".join(parts)


def breakdown(board: PoseBoard, split: str) -> str:
    """The main figure by material and by class."""
    details = board.details[split]
    materials: dict[RunName, dict[str, float]] = {}
    classes: dict[RunName, dict[str, float]] = {}
    for each in details:
        if each.subset in DETAILS:
            mine = materials.setdefault(each.result.name, {})
            mine[f"{each.subset} ({each.objects})"] = each.scores.mean[MAIN]
        else:
            scores = each.scores
            classes[each.result.name] = {
                f"{name} ({count})": scores.of_class(name)[MAIN]
                for name, count in zip(scores.class_names, scores.true_objects, strict=True)
                if count
            }
    parts = [
        f"<h3>{heading(MAIN)} by {what}, protocol strict [%]</h3>{_matrix(figures)}"
        for what, figures in (("material", materials), ("class", classes))
        if figures
    ]
    if not parts:
        return ""
    return paragraph("In parentheses the number of true objects.") + "".join(parts)


def pose_gallery(board: PoseBoard) -> str:
    """The same frames for all depths of a method, side by side."""
    groups: dict[tuple[str, str, str], list[tuple[PoseResult, PosePictures]]] = {}
    for result in board.results:
        path = result.folder / POSE_GALLERY / PICTURES_FILE
        if path.exists():
            method, _, fit = result.name
            shown = (result, read_document(path, PosePictures))
            groups.setdefault((result.split, method, fit), []).append(shown)
    parts = []
    for number, ((split, method, fit), runs) in enumerate(groups.items()):
        frames: dict[str, list[str]] = {}
        for result, pictures in runs:
            for p in pictures.pictures:
                data = (result.folder / POSE_GALLERY / p.picture).read_bytes()
                caption = (
                    f"{result.name[1]} depth: {p.right} of {p.objects} within 10°5cm"
                    f"{f', {p.found} found' if p.found != p.objects else ''}"
                )
                frames.setdefault(f"{p.scene}/{p.frame}", []).append(
                    f'<figure><img class="boxes" alt="{escape(caption)}" '
                    f'src="data:image/jpeg;base64,{base64.b64encode(data).decode("ascii")}">'
                    f"<figcaption>{escape(caption)}</figcaption></figure>"
                )
        rows = "".join(
            f"<h4>{escape(name)}</h4>"
            f'<div class="sidebyside" style="--n:{min(len(figures), _ABREAST)}">'
            f"{''.join(figures)}</div>"
            for name, figures in frames.items()
        )
        title = escape(f"{method}, fit {fit}, on {split}")
        opened = " open" if number == 0 else ""
        parts.append(f"<details{opened}><summary>{title}</summary>{rows}</details>")
    if not parts:
        return ""
    legend = (
        '<div class="scalebar"><i style="width:26px;height:4px;background:#14cd4b"></i>true box'
        '<i style="width:26px;height:3px;background:#eb2d28"></i>estimated box'
        "<span>from the middle of each the half axes; the thick one is the object's y</span></div>"
    )
    return (
        paragraph("Frames spread evenly over the split; all runs show the same.")
        + legend
        + ("".join(parts))
    )


def pose_runs(results: Sequence[PoseResult]) -> str:
    """What ran, with what, on what; and what failed."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        own = {k: v for k, v in s.settings.items() if k != "fit"}
        settings = ", ".join(
            [*(f"{k}={v}" for k, v in sorted(own.items()))]
            + [f"{s.depth}.{k}={v}" for k, v in sorted(s.depth_settings.items())]
        )
        done = s.frames - result.missing
        depth = [f"depth {s.depth_preset}"] if s.depth_preset else []
        weights = [w[:12] for w in (s.weights_sha256, s.depth_weights_sha256) if w]
        rows.append(
            [
                Cell(escape(m.label)),
                Cell(escape(m.depth_label)),
                Cell(escape(m.fit)),
                Cell(escape(s.split)),
                Cell(
                    str(s.frames) if not result.missing else f"{done} of {s.frames}",
                    numeric=True,
                    over=bool(result.missing),
                ),
                Cell(str(result.failed), numeric=True, over=bool(result.failed)),
                Cell(escape(", ".join([s.preset, *depth, *([settings] if settings else [])]))),
                Cell(words(" ".join(f"`{w}`" for w in weights))),
                Cell(escape(m.hardware.get("gpus") or m.hardware.get("processor", ""))),
                Cell(escape(m.version_of_tool)),
            ]
        )
    heads = (
        "method", "depth", "fit", "split", "frames", "failed", "how", "weights", "ran on", "tool",
    )  # fmt: skip
    return table([(head, "") for head in heads], rows)


def pose_summary(board: PoseBoard) -> str:
    """One sentence on what is right most often, true depth aside."""
    said = []
    for split in board.splits:
        rows = board.part(split, "strict", ALL)
        rows = rows[(rows["kind"] == MEASURED) & (rows["depth"] != TRUE)].dropna(subset=[MAIN])
        if not rows.empty:
            best = rows.loc[rows[MAIN].idxmax()]
            said.append(
                f"{best['method']} with {best['depth']} depth on {split} "
                f"({100 * best[MAIN]:.1f} % within {heading(MAIN)}, strict)"
            )
    if not said:
        return words("Poses were fitted to true depth only.")
    return words("Most poses right: " + "; ".join(said) + ".")


def _small(scenes: int) -> str:
    if scenes < 2:
        return "With one scene there are no intervals."
    few = ", too narrow with so few of them" if scenes < _FEW_SCENES else ""
    return f"Small: 95 % intervals over scenes{few}. Bold: best, true depth aside."


def _table(rows: pd.DataFrame) -> str:
    heads = "".join(
        f'<th class="n" data-less="0">{escape(c.heading)}<small>{escape(c.unit)}</small></th>'
        for c in FIGURES
    )
    contest = rows[(rows["kind"] == MEASURED) & (rows["depth"] != TRUE)]
    best = contest[[c.name for c in FIGURES]].max()
    body = []
    for row in rows.to_dict("records"):
        printed = row["kind"] == PUBLISHED
        contends = not printed and row["depth"] != TRUE
        note = f"<small>published; {escape(_where(row))}</small>" if printed else ""
        cells = [f"<td>{escape(row['method'])}{note}</td>"]
        cells += [f"<td>{escape(row[name])}</td>" for name in ("depth", "fit")]
        for column in FIGURES:
            value = row[column.name]
            text = column.text(value, printed=printed)
            if contends and value == best[column.name] and value > 0:
                text = f"<b>{text}</b>"
            low, high = (row[f"{column.name}_{end}"] for end in ("low", "high"))
            span = "" if pd.isna(low) else f"<small>{column.text(low)}–{column.text(high)}</small>"
            order = "" if pd.isna(value) else repr(float(value))
            cells.append(f'<td class="n" data-v="{order}">{text}{span}</td>')
        kind = " class=published" if printed else "" if contends else " class=bound"
        body.append(f"<tr{kind}>{''.join(cells)}</tr>")
    return (
        '<div class="scroll"><table class="sortable"><thead><tr><th>method</th><th>depth</th>'
        f"<th>fit</th>{heads}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def _where(row: dict[str, Any]) -> str:
    training = row["training_data"]
    return f"{row['table']}; trained on {training}" if training else str(row["table"])


def _matrix(figures: dict[RunName, dict[str, float]]) -> str:
    """A table of shares, shaded from none (white) to all (green)."""
    columns = list(dict.fromkeys(column for mine in figures.values() for column in mine))
    head = "".join(
        f"<th{' class=n' if i > 2 else ''}>{escape(text)}</th>"
        for i, text in enumerate(("method", "depth", "fit", *columns))
    )
    body = []
    for name, mine in figures.items():
        cells = [f"<td>{escape(text)}</td>" for text in name]
        for column in columns:
            value = mine.get(column, float("nan"))
            there = not np.isnan(value)
            tint = f"background:rgba(43,122,75,{0.3 * value:.2f})" if there else ""
            text = f"{100 * value:.1f}" if there else "–"
            cells.append(f'<td class="n" style="{tint}">{text}</td>')
        body.append(f"<tr>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def _anchor(*names: str) -> str:
    return "-".join(re.sub(r"[^A-Za-z0-9]+", "-", name) for name in names)
