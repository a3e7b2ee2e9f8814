"""Tables and pictures of poses: leaderboard, breakdowns, boxes, runs."""

import math
from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Any

import pandas as pd

from benchmark.evaluation import depth_choice
from benchmark.evaluation.results import FAILED, Result
from benchmark.evaluation.tasks import pose_pictures, pose_results
from benchmark.report.leaderboard import MEASURED, PUBLISHED, is_ranked
from benchmark.report.page import MOST_PICTURED, NOTES, left_out
from benchmark.report.parts import comparisons, depth_tables
from benchmark.report.parts.pose_board import (
    DETAILS,
    FIGURES,
    MAIN,
    PROTOCOLS,
    TABLES,
    PoseBoard,
    compare_runs,
)
from benchmark.report.parts.published import address_note
from std_toolkit.errors import ToolkitError
from std_toolkit.html import page
from std_toolkit.html.plots import CAMERA, FAINT, OBJECT_COLORS, error_bars, figure
from std_toolkit.html.table import NONE, Cell, Column, Row, Table
from std_toolkit.io.documents import read_document

_RAW_COLOR, _TRUE_COLOR = FAINT, "#2b7a4b"
_MOST_COMPARED = 8  # runs in a table of all pairs: each pair is scored for every swap
_ABREAST = 4  # pictures in a row
_RUN = [Column(heading=h, numeric=False) for h in ("method", "depth", "fit")]
_COUNTS = [Column(heading=h, digits=0) for h in ("objects", "frames", "scenes")]


def pose_title(board: PoseBoard, split: str, protocol: str) -> str:
    """Return the title of a table, with the number of frames."""
    return f"{split}, protocol {protocol}: {board.counted(split)}"


def pose_tables(board: PoseBoard, split: str, protocol: str) -> list[Table]:
    """Return the tables of one split and protocol in percent, one for each set of objects."""
    tables = []
    for subset in TABLES:
        rows = board.part(split, protocol, subset)
        measured = rows[rows["kind"] == MEASURED]
        if measured.empty:
            continue
        title = f"{pose_title(board, split, protocol)}, {depth_tables.OBJECTS[subset]}, poses right"
        scenes = int(measured["scenes"].max())
        notes = [f"Bold: best without any ground truth. {depth_tables.interval_note(scenes)}"]
        if is_ranked(rows).sum() < len(measured):
            notes.append(depth_tables.LACKING)
        if (rows["kind"] == PUBLISHED).any():
            notes.append(address_note(rows["source"].dropna()))
        contests = board.contests(rows)
        best = rows[contests][[c.name for c in FIGURES]].max()
        pairs = zip(rows.to_dict("records"), contests, strict=True)
        made = [_row(row, best, contends=contends) for row, contends in pairs]
        columns = [*_RUN, *_COUNTS, *FIGURES, Column(heading=NOTES, numeric=False)]
        table = Table(columns=columns, rows=made, title=title, notes=notes, sortable=True)
        told = any(row.cells[-1].text for row in made)
        tables.append(table if told else table.without(NOTES))
    return tables


def _row(row: dict[str, Any], best: pd.Series, *, contends: bool) -> Row:
    published = row["kind"] == PUBLISHED
    note = f"published; {depth_tables.source_of(row)}" if published else ""
    cells = [Cell(text=str(row[name])) for name in ("method", "depth", "fit")]
    objects, scenes = (c.cell(row[c.heading]) for c in (_COUNTS[0], _COUNTS[2]))
    cells += [objects, depth_tables.frames_cell(row), scenes]
    nowhere = not published and row["failed"] == row["frames"]
    for column in FIGURES:
        value: float = row[column.name]
        low, high = (row.get(f"{column.name}_{end}", math.nan) for end in ("low", "high"))
        is_best = contends and value == best[column.name] and value > 0
        cells.append(
            column.cell(
                value,
                interval=(low, high),
                published=published,
                mark="best" if is_best else "",
                missing=FAILED if nowhere and column is FIGURES[0] else "",
            )
        )
    cells.append(Cell(text=note))
    return Row(cells, "published" if published else "" if contends else "bound")


def seed_tables(board: PoseBoard) -> list[Table]:
    """Return the tables over training seeds, of each split, protocol and set of objects."""
    tables = []
    for split in board.splits:
        groups = comparisons.seed_groups([r for r in board.results if r.split == split])
        for protocol in PROTOCOLS:
            for subset in TABLES:
                part = board.part(split, protocol, subset)
                of = part[is_ranked(part)].set_index(["method", "depth", "fit"]).to_dict("index")
                named = partial(_figures, dict(of))
                rows = comparisons.seed_rows(groups, named, [c.name for c in FIGURES])
                title = (
                    f"{pose_title(board, split, protocol)}, {depth_tables.OBJECTS[subset]}, "
                    "poses right over training seeds"
                )
                tables += comparisons.seed_table(rows, FIGURES, title)
    return tables


def _figures(of: dict[Any, dict[Any, Any]], result: Result[Any]) -> dict[Any, Any] | None:
    assert isinstance(result, pose_results.PoseResult)
    return of.get(result.name)


def pair_tables(board: PoseBoard, split: str) -> list[Table]:
    """Return the table of p of all pairs of the best runs that compete, by the main figure."""
    part = board.part(split, PROTOCOLS[0], pose_results.ALL)
    ranked = part[board.contests(part)].sort_values(MAIN, ascending=False, kind="stable")
    names = list(ranked[["method", "depth", "fit"]].itertuples(index=False, name=None))
    scored = {s.result.name: s for s in board.details[split] if s.subset == pose_results.ALL}
    names = [n for n in names if n in scored][:_MOST_COMPARED]
    found: list[tuple[float, float] | None] = []
    for first, second in combinations(names, 2):
        try:
            difference = compare_runs(scored[first], scored[second], samples=1).of(MAIN)
        except ToolkitError:  # not over the same frames
            found.append(None)
        else:
            found.append((difference[0], difference[3]))
    column = next(c for c in FIGURES if c.name == MAIN)
    return comparisons.pair_table(
        [f"{method}, {depth}, {fit}" for method, depth, fit in names],
        found,
        column,
        title=f"All pairs, {pose_title(board, split, PROTOCOLS[0])}",
        test="How often swapping the two at random in each scene differs as much.",
    )


def bar_blocks(board: PoseBoard, split: str, protocol: str) -> list[page.Block]:
    """Return bar plots of every method and fit by depth; none for the paper protocol."""
    blocks: list[page.Block] = []
    for subset in TABLES if protocol == PROTOCOLS[0] else ():
        rows = board.part(split, protocol, subset)
        measured = rows[rows["kind"] == MEASURED]
        for method, fit in measured[["method", "fit"]].drop_duplicates().to_numpy().tolist():
            figure = columns_by_depth(rows, method, fit)
            if figure is not None:
                blocks.append(
                    page.Heading(f"{method}, fit {fit}, {depth_tables.OBJECTS[subset]}", 4)
                )
                blocks.append(page.Plot("-".join(("bars", split, subset, method, fit)), figure))
    return blocks


def breakdown_tables(board: PoseBoard, split: str) -> list[Table]:
    """Return tables of the main figure by material and by class."""
    materials: dict[pose_results.RunName, dict[str, float]] = {}
    classes: dict[pose_results.RunName, dict[str, float]] = {}
    for each in board.details[split]:
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
    return [
        _matrix(
            figures,
            f"{pose_results.heading(MAIN)} by {what}, {pose_title(board, split, 'strict')} [%]",
        )
        for what, figures in (("material", materials), ("class", classes))
        if figures
    ]


def _matrix(figures: dict[pose_results.RunName, dict[str, float]], title: str) -> Table:
    """Fractions, shaded from 0 (white) to 1 (green)."""
    names = list(dict.fromkeys(column for mine in figures.values() for column in mine))
    columns = [Column(heading=n, factor=100, lower_is_better=False) for n in names]
    rows = []
    for run, mine in figures.items():
        cells = [Cell(text=text) for text in run]
        for column in columns:
            value = mine.get(column.heading, math.nan)
            shade = "" if math.isnan(value) else f"rgba(43,122,75,{0.3 * value:.2f})"
            cells.append(Cell(text=column.text(value) or NONE, value=value, shade=shade))
        rows.append(Row(cells))
    notes = ["In parentheses the number of true objects."]
    return Table(columns=[*_RUN, *columns], rows=rows, title=title, notes=notes)


def pose_gallery(board: PoseBoard, wanted: Sequence[str] = ()) -> list[page.Block]:
    """Return pictures of the same frames for all depths of a method, side by side.

    Args:
        board: of the runs.
        wanted: SCENE/FRAME of the frames to show, if runs have pictures of any; empty for all.
    """
    groups: dict[
        tuple[str, str, str], list[tuple[pose_results.PoseResult, pose_pictures.PosePictures]]
    ] = {}
    index = f"{pose_pictures.POSE_GALLERY}/{pose_pictures.PICTURES_FILE}"
    pictured = [result for result in board.results if (result.folder / index).exists()]
    for result in pictured[:MOST_PICTURED]:
        method, _, fit = result.name
        shown = (result, read_document(result.folder / index, pose_pictures.PosePictures))
        groups.setdefault((result.split, method, fit), []).append(shown)
    if not groups:
        return []
    blocks: list[page.Block] = [
        page.Paragraph("Frames evenly spaced over the split, the same for all runs."),
        *left_out(len(pictured), pose_pictures.POSE_GALLERY),
        page.Legend(
            [
                page.LegendEntry("#14cd4b", "true box", 26),
                page.LegendEntry("#eb2d28", "estimated box", 26),
                page.LegendEntry("none", "from the centre the half axes; the thick one is y", 0),
            ]
        ),
    ]
    for number, ((split, method, fit), runs) in enumerate(groups.items()):
        frames: dict[str, list[page.Figure]] = {}
        for result, pictures in runs:
            for p in pictures.pictures:
                found = f", {p.found} found" if p.found != p.objects else ""
                caption = f"{result.name[1]} depth: {p.right} of {p.objects} within 10°5cm{found}"
                picture = page.Picture.read(
                    result.folder / pose_pictures.POSE_GALLERY, p.picture, width=640
                )
                frames.setdefault(f"{p.scene}/{p.frame}", []).append(page.Figure(picture, caption))
        inside: list[page.Block] = []
        for name in [n for n in wanted if n in frames] or list(frames):
            figures = frames[name]
            inside.append(page.Heading(name, 4))
            inside.append(page.Gallery(figures, abreast=max(2, min(len(figures), _ABREAST))))
        of = board.counted(split)
        blocks.append(page.Details(f"{method}, fit {fit}, on {split}: {of}", inside, number == 0))
    return blocks


def run_table(results: Sequence[pose_results.PoseResult]) -> Table:
    """Return the table of runs: weights, hardware and failures."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        settings = [f"{k}={v}" for k, v in sorted(s.settings.items()) if k != "fit"]
        settings += [f"{s.depth}.{k}={v}" for k, v in sorted(s.depth_settings.items())]
        depth = [f"depth {s.depth_preset}"] if s.depth_preset else []
        trained = [f"trained on {t}" for t in (result.training_data, m.depth_training_data) if t]
        weights = [w[:12] for w in (s.weights_sha256, s.depth_weights_sha256) if w]
        cells = [
            *(Cell(text=text) for text in (m.label, m.depth_label, m.fit, result.split)),
            Cell(text=str(result.data.provenance)),
            *depth_tables.counted(s.frames, result.missing, result.failed),
            Cell(text=", ".join(word for word in (s.preset, *depth, *settings, *trained) if word)),
            *depth_tables.machine(" ".join(weights), m.hardware, m.version_of_tool),
        ]
        rows.append(Row(cells))
    return Table(
        columns=depth_tables.run_columns("method", "depth", "fit", "split", "data"), rows=rows
    )


def depth_colors(depths: list[str]) -> dict[str, str]:
    """Return the colour of each depth: raw grey, true green, restored ones all different."""
    restored = [d for d in dict.fromkeys(depths) if d not in (depth_choice.RAW, depth_choice.TRUE)]
    colors = [c for c in OBJECT_COLORS if c != _TRUE_COLOR]
    found = {depth: colors[i % len(colors)] for i, depth in enumerate(restored)}
    return {depth_choice.RAW: _RAW_COLOR, **found, depth_choice.TRUE: _TRUE_COLOR}


def columns_by_depth(rows: pd.DataFrame, method: str, fit: str) -> str | None:
    """Plot bars of all figures of a method, one colour for each depth, with intervals.

    Args:
        rows: rows of one split, protocol and subset.
        method, fit: method and fit to plot.
    """
    chosen = rows[(rows["kind"] == MEASURED) & (rows["method"] == method) & (rows["fit"] == fit)]
    if len(chosen) < 2:
        return None
    colors = depth_colors(rows.loc[rows["kind"] == MEASURED, "depth"].tolist())
    headings = [column.heading for column in FIGURES]
    traces = []
    for _, row in chosen.iterrows():
        values, low, high = (
            [100 * row[f"{c.name}{end}"] for c in FIGURES] for end in ("", "_low", "_high")
        )
        trace = {
            "type": "bar",
            "error_y": error_bars(values, low, high, color=CAMERA),
            "name": f"{row['depth']} depth",
            "x": headings,
            "y": values,
            "marker": {"color": colors[row["depth"]]},
            "hovertemplate": "%{x}: %{y:.1f} %<extra>" + row["depth"] + "</extra>",
        }
        traces.append(trace)
    return figure(
        traces,
        height=320,
        y="right [%]",
        yaxis={"range": [0, 103]},
        barmode="group",
        bargap=0.25,
    )
