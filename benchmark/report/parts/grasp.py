"""Report part of table clearing: rates, causes of failure, pictures, effect of depth."""

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.evaluation.depth_choice import RAW, TRUE
from benchmark.evaluation.results import INDEX
from benchmark.evaluation.tasks import grasp_results
from benchmark.evaluation.tasks.grasp import STRIPS
from benchmark.evaluation.tasks.grasp_inputs import ORACLE
from benchmark.evaluation.tasks.grasp_table import ATTEMPT, KIND, scene_name
from benchmark.report.page import MOST_PICTURED, ReportPart, left_out, table_files
from benchmark.report.parts.comparisons import (
    MOST_COMPARED,
    pair_table,
    seed_groups,
    seed_rows,
    seed_table,
)
from benchmark.report.parts.depth_tables import machine
from benchmark.report.parts.published import TASKS, published_tables
from std_toolkit.html import page
from std_toolkit.html.table import Cell, Column, Row, Table

CSV, MARKDOWN, LATEX = "grasping.csv", "grasping.md", "grasping.tex"

# Pictures per run on the page: one for each outcome of attempts.
_MOST_STRIPS = 6

_SIGNIFICANT = 0.05

_RUN = ("camera", "seed", "planner", "depth")
_COUNTS = ("rounds", "objects", "attempts", "grasped")
_SHARES = (
    "success_attempts", "success_tables", "completion_objects", "completion_tables", "cleared",
)  # fmt: skip

_DEFINITIONS = (
    "Success: attempts that ended with an object held, of all attempts; per table: the mean over "
    "rounds, a round without an attempt counts 0. Completion: objects removed (held after lifting, "
    "or over the table's edge) of those on the table, over all objects, and as the mean over "
    "tables. In brackets: 95 % intervals, resampling whole rounds."
)

_PLANNED = (
    "GraspNet's average precision of all grasps planned on the first view of each table, which is "
    "the same for every planner and depth, judged by the true meshes: of the best 50 (10 for an "
    "object at most), those fail that hit something, have nothing between the fingers, or do not "
    "hold; AP is the mean over frictions of 0.2 to 1.2. It is not defined for suction."
)


def grasp_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """See `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, or none is finished.
    """
    results = grasp_results.read_grasp_results(folders)
    rounds = max(r.rates.rounds for r in results)
    planners = ", ".join(dict.fromkeys(r.manifest.planner_label for r in results))
    depths = ", ".join(dict.fromkeys(r.manifest.depth_label for r in results))
    tables = [*_clearing_tables(results), *_seed_tables(results)]
    printed = published_tables(TASKS["grasp"]) if published else []
    return ReportPart(
        title="Grasping: table clearing",
        summary=f"{rounds} simulated tables {_of_what(results)}; "
        f"planners: {planners}; depth: {depths}",
        sections=[
            page.Section("clearing", "Table clearing", [page.Paragraph(_DEFINITIONS), *tables]),
            page.Section("clearing-pairs", "All pairs", _pair_tables(results)),
            page.Section("clearing-plans", "Planned grasps", [_plan_table(results)]),
            page.Section("clearing-causes", "How attempts ended", [_cause_table(results)]),
            page.Section("clearing-strips", "Attempts in pictures", _pictures(results)),
            page.Section("clearing-published", "Published, with real robots", printed),
            page.Section("clearing-runs", "What ran: clearing", [_run_table(results)]),
        ],
        answer=_answer(results),
        terminal=grasp_results.grasp_table(results),
        files=table_files((CSV, MARKDOWN, LATEX), tables, board_of(results)),
        latex=LATEX,
        tables=tables,
    )


def _of_what(results: Sequence[grasp_results.GraspResult]) -> str:
    """What stands on the tables."""
    if any(r.manifest.setup.scenes for r in results):
        return "with the objects of labelled scenes"
    return "of 4 to 5 specular or transparent objects"


def board_of(results: Sequence[grasp_results.GraspResult]) -> pd.DataFrame:
    """Return one row per run, rates as fractions."""
    rows = []
    for result in results:
        rates = result.rates
        row: dict[str, object] = dict(zip(_RUN, result.name, strict=True))
        row |= {name: getattr(rates, name) for name in _COUNTS} | {"off_table": rates.lost}
        shares = {name: getattr(rates, name) for name in _SHARES}
        shares |= {f"completion_{m}": r for m, r in sorted(rates.completion_of.items())}
        shares |= rates.precision
        for name, rate in shares.items():
            row |= {name: rate.value, f"{name}_low": rate.low, f"{name}_high": rate.high}
        rows.append(row)
    return pd.DataFrame(rows)


def _clearing_tables(results: Sequence[grasp_results.GraspResult]) -> list[Table]:
    tables = []
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        mine = [r for r in results if r.name[:2] == (camera, seed)]
        rows = [Row([_figure(cell) for cell in grasp_results.cells(r)]) for r in mine]
        rounds = max(r.rates.rounds for r in mine)
        title = f"Table clearing, {camera} camera, seed {seed}: {rounds} tables"
        columns = _columns(grasp_results.HEADINGS)
        tables.append(Table(columns=columns, rows=rows, title=title))
    return tables


_COMPLETION = Column(heading="completion per table", unit="%", name="completion_tables", factor=100)
_SEEDED = (
    Column(heading="success of attempts", unit="%", name="success_attempts", factor=100),
    Column(heading="completion of objects", unit="%", name="completion_objects", factor=100),
    _COMPLETION,
)


def _seed_tables(results: Sequence[grasp_results.GraspResult]) -> list[Table]:
    """Means over training seeds, of each camera and seed of the tables."""
    tables = []
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        groups = seed_groups([r for r in results if r.name[:2] == (camera, seed)])
        rows = seed_rows(groups, _seeded, [c.name for c in _SEEDED])
        title = f"Table clearing, {camera} camera, seed {seed}, over training seeds"
        tables += seed_table(rows, _SEEDED, title)
    return tables


def _seeded(result: Any) -> dict[str, float]:
    return {c.name: getattr(result.rates, c.name).value for c in _SEEDED}


def _pair_tables(results: Sequence[grasp_results.GraspResult]) -> list[Table]:
    """p of all pairs of planner and depth on the same tables, by the completion of a table."""
    tables = []
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        mine = [r for r in results if r.name[:2] == (camera, seed)]
        mine.sort(key=lambda r: -r.rates.completion_tables.value)
        mine = mine[:MOST_COMPARED]
        gains = [grasp_results.completion_gain(a.table, b.table) for a, b in combinations(mine, 2)]
        tables += pair_table(
            [f"{r.name[2]}, {r.name[3]}" for r in mine],
            [(g.rate.value, g.p) if g.rate.total else None for g in gains],
            _COMPLETION,
            title=f"All pairs, {camera} camera, seed {seed}",
            test="Sign-flip test over the tables that both cleared.",
        )
    return tables


def _plan_table(results: Sequence[grasp_results.GraspResult]) -> Table:
    rows = [_with_place(r, grasp_results.plan_cells(r)[2:]) for r in results]
    return Table(columns=_columns(grasp_results.PLAN_HEADINGS), rows=rows, notes=[_PLANNED])


def _cause_table(results: Sequence[grasp_results.GraspResult]) -> Table:
    names = sorted({name for r in results for name in r.rates.outcomes})
    rows = [_with_place(r, [str(r.rates.outcomes.get(n, 0)) for n in names]) for r in results]
    heads = [*_columns(("planner", "depth")), *(Column(heading=n, unit="views") for n in names)]
    return Table(columns=heads, rows=rows)


def _with_place(result: grasp_results.GraspResult, figures: Sequence[str]) -> Row:
    """A row of planner, depth, camera and seed, followed by figures."""
    place = f"{result.name[0]} camera, seed {result.name[1]}"
    names = [
        Cell(text=result.manifest.planner_label),
        Cell(text=result.manifest.depth_label, note=place),
    ]
    return Row([*names, *map(_figure, figures)])


def _columns(headings: Sequence[str]) -> list[Column]:
    """Columns for planner, depth and figures."""
    found = []
    for i, title in enumerate(headings):
        heading, percent, of = title.partition(" %")
        found.append(Column(heading=heading, unit=(percent + of).strip(), numeric=i > 1))
    return found


def _figure(text: str) -> Cell:
    """A figure, with its interval as a note."""
    value, bracket, interval = text.partition(" [")
    return Cell(text=value, note=bracket.strip() + interval)


def _run_table(results: Sequence[grasp_results.GraspResult]) -> Table:
    """The table of runs."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        how = [f"planner {s.planner_preset}"] if s.planner_weights_sha256 else []
        how += [f"depth {s.depth_preset}"] if s.depth_preset else []
        trained = (m.planner_training_data, m.depth_training_data)
        how += [f"trained on {text}" for text in trained if text]
        how += [f"saved depth {result.saved_depth[:12]}"] if result.saved_depth else []
        how += [f"{s.planner}.{k}={v}" for k, v in sorted(s.planner_settings.items())]
        how += [f"{s.depth}.{k}={v}" for k, v in sorted(s.depth_settings.items())]
        digests = [w[:12] for w in (s.planner_weights_sha256, s.depth_weights_sha256) if w]
        names = (m.planner_label, m.depth_label, s.camera, str(s.seed), str(result.rates.rounds))
        texts = [Cell(text=text) for text in (*names, ", ".join(how))]
        rows.append(Row([*texts, *machine(" ".join(digests), m.hardware, m.version_of_tool)]))
    heads = ("planner", "depth", "camera", "seed", "tables", "settings", "weights", "ran on",
             "version")  # fmt: skip
    columns = [Column(heading=h, numeric=h in ("seed", "tables")) for h in heads]
    return Table(columns=columns, rows=rows)


def _pictures(results: Sequence[grasp_results.GraspResult]) -> list[page.Block]:
    with_strips = [result for result in results if (result.folder / STRIPS).is_dir()]
    blocks: list[page.Block] = [*left_out(len(with_strips), STRIPS)]
    if blocks:  # the best ones
        with_strips.sort(key=lambda result: -result.rates.completion_tables.value)
    for result in with_strips[:MOST_PICTURED]:
        views = result.table[result.table[KIND] == ATTEMPT]
        first = views.drop_duplicates("outcome").head(_MOST_STRIPS)
        shown = []
        for index, number, outcome in zip(
            first[INDEX], first["attempt"], first["outcome"], strict=True
        ):
            folder, name = result.folder / STRIPS, strip_name(int(index), int(number))
            if (folder / name).is_file():
                picture = page.Picture.read(folder, name)
                shown.append(page.Figure(picture, f"{scene_name(int(index))}: {outcome}"))
        if shown:
            title = f"{result.manifest.planner_label} on {result.manifest.depth_label} depth"
            blocks += [page.Heading(title), page.Gallery(shown)]
    return blocks


def strip_name(index: int, attempt: int) -> str:
    """Return the file name of the pictures of an attempt."""
    return f"{scene_name(index)}-attempt-{attempt:02d}.png"


def _answer(results: Sequence[grasp_results.GraspResult]) -> list[page.Block]:
    """Gain in completion and success per table of each depth over raw depth."""
    found = []
    for result in results:
        camera, seed, planner, depth = result.name
        raw = next((r for r in results if r.name == (camera, seed, planner, RAW)), None)
        if raw is None or depth == RAW or planner == ORACLE:
            continue
        gain = grasp_results.completion_gain(result.table, raw.table)
        if not gain.rate.total:
            continue
        what = "True depth" if depth == TRUE else f"Depth by {depth}"
        parts = [
            f"{material} ones {points(part)}"
            for material in sorted(result.rates.completion_of)
            if (part := grasp_results.completion_gain(result.table, raw.table, material=material))
            and part.rate.total
        ]
        success = grasp_results.success_gain(result.table, raw.table)
        found.append(
            page.Paragraph(
                f"{what} with {planner}: {points(gain)} of a table's objects removed than with raw "
                f"depth, over the same {gain.rate.total} tables "
                f"({grasp_results.share(result.rates.completion_tables)} % against "
                f"{grasp_results.share(raw.rates.completion_tables)} %; {'; '.join(parts)}); "
                f"{verdict(gain)}. Attempts that succeeded: {points(success)}."
            )
        )
    return [page.Bullets(found)] if found else []


def points(gain: grasp_results.Gain) -> str:
    """Format a difference of fractions in percentage points.

    >>> from benchmark.evaluation.tasks.grasp_results import Gain, Rate
    >>> points(Gain(Rate(0.25, 0.1, 0.4, 2, 8), 0.0123))
    '25.0 points [10.0, 40.0] more (p = 0.012)'
    """
    rate = gain.rate
    word = "more" if rate.value >= 0 else "fewer"
    interval = f"[{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
    return f"{100 * abs(rate.value):.1f} points {interval} {word} (p = {gain.p:.2g})"


def verdict(gain: grasp_results.Gain) -> str:
    """Return the conclusion that the paired test and the interval support."""
    if math.isnan(gain.rate.low):
        return "one table is too few to say"
    if gain.p >= _SIGNIFICANT:
        return "not statistically significant"
    return "it helps" if gain.rate.value > 0 else "it harms"
