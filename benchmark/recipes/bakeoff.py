"""`std-bench bakeoff`: which depth restorer to use for a camera, by a user's labelled recordings.

Plans runs of `std-bench depth` on copied frames, has `bakeoff_verdict` judge their rows, and writes
the conclusion above the usual report.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from benchmark.evaluation.config import DepthConfig
from benchmark.evaluation.evaluate import score_config
from benchmark.evaluation.query_options import BakeoffOptions
from benchmark.evaluation.tasks.depth import Run
from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.evaluation.tasks.depth_speed import STANDARD, standard_calls
from benchmark.evaluation.values import is_folder
from benchmark.methods.registry import COMPACT, restorers, shipped_file
from benchmark.metrics.depth import harm
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.recipes.bakeoff_scenes import SCENES, StagedScenes, stage_scenes
from benchmark.recipes.bakeoff_verdict import RAW, Cost, Value, Verdict, judge
from benchmark.recipes.bakeoff_words import MATERIALS, by_material, conclusion, counted
from benchmark.report.leaderboard import METRICS, make_board
from benchmark.report.parts.depth import board_sections
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.page import Block, Bullets, Page, Paragraph, Section
from std_toolkit.html.page import Verdict as Head
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.io.atomic import write_bytes_atomic

PAGE, RESULTS = "bakeoff.html", "results"
PROTOCOL = "strict"
_FILLING = ("nearest", "colorization")
# Calls that are timed, and seconds after which none begins.
_CALLS, _LONGEST_S = 4, 2.0


@dataclass(frozen=True)
class Bakeoff:
    """Outcome of `bakeoff`.

    Attributes:
        verdict: which method to use.
        page: the page.
        failed: an error line for each run that has no results, by title.
        notes: what the frames are and what the conclusion rests on.
    """

    verdict: Verdict
    page: Path
    failed: dict[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def lines(self) -> list[str]:
        """The conclusion and what it rests on, for a terminal."""
        return [
            conclusion(self.verdict),
            *by_material(self.verdict),
            *self.notes,
            str(self.page),
        ]

    @property
    def record(self) -> dict[str, Any]:
        """All figures, in metres and shares, with the words."""
        return {**asdict(self.verdict), "conclusion": conclusion(self.verdict), "notes": self.notes}


def methods_at_hand() -> list[str]:
    """Return the methods that need nothing of the user: filling, and networks with weights."""
    networks = [name for name in restorers.names() if shipped_file(name, COMPACT).is_file()]
    return [*_FILLING, *networks, "std-restore"]


def bakeoff(options: BakeoffOptions) -> Bakeoff:
    """Score what is not scored yet, decide, and write the page.

    Raises:
        ToolkitError: a recording without truth, a method that does not exist, or no method ran.
    """
    scenes = stage_scenes(options.recordings, options.out, options.limit, options.sprayed)
    scored = score_config(_config(options, scenes))
    results: list[RunResult] = list(scored.results)
    failed = dict(scored.campaign.failed)
    if not results:
        raise ToolkitError(next(iter(failed.values())), path=options.out / RESULTS)
    grid, _ = get_protocol(PROTOCOL).main
    tables = pd.concat([result.table for result in results], ignore_index=True)
    costs = costs_of(results, scored.campaign.finished, measure=options.speed)
    verdict = judge(tables[tables["grid"] == grid], scenes.views, costs)
    done = Bakeoff(verdict, options.out / PAGE, failed, _notes(verdict, scenes))
    write_bytes_atomic(done.page, _html(done, results).encode())
    return done


def _config(options: BakeoffOptions, scenes: StagedScenes) -> DepthConfig:
    """The runs as `std-bench depth` has them."""
    methods = [RAW, *(methods_at_hand() if options.at_hand else ()), *options.methods]
    vendor = {f"vendor.{name}": where for name, where in scenes.vendor.items()}
    folders = [m.partition("=")[0] for m in options.methods if is_folder(m)]
    units = list(options.depth_units)
    if folders:  # those without a name are of the user's folders, not of the vendor's
        named = [u for u in units if "=" in u]
        plain = [u for u in units if "=" not in u]
        units = [*(f"{name}={u}" for u in plain for name in folders), *named]
    return DepthConfig(
        methods=tuple(dict.fromkeys([*methods, *(f"{n}={w[0]}" for n, w in vendor.items())])),
        splits=(SCENES,),
        data=(str(scenes.root),),
        protocols=(PROTOCOL,),
        out=options.out / RESULTS,
        preset=options.preset,
        weights=options.weights,
        settings=options.settings,
        devices=options.devices,
        precision=options.precision,
        compile=options.compile,
        gallery=options.gallery,
        depth_units=(*units, *(f"{name}={unit!r}" for name, (_, unit) in vendor.items())),
        speed=False,  # measured apart, in much less time
        jobs=options.jobs,
    )


def costs_of(
    results: Sequence[RunResult], runs: Sequence[Run], *, measure: bool
) -> dict[str, Cost]:
    """Return the time that each method takes, by its name, where it was measured or is said.

    Args:
        results: of the finished runs.
        runs: the same runs.
        measure: time the methods, on a frame of their data.
    """
    found: dict[str, Cost] = {}
    for result, run in zip(results, runs, strict=True):
        said = result.said
        if run.depth_from is not None:
            if said is not None and said.seconds_per_frame:
                found[run.label] = Cost(Value(said.seconds_per_frame), "a frame, says its author")
        elif measure:
            frame = run.load(data := run.open(), run.chosen(data)[0])
            calls = standard_calls(run.make(), frame, most=_CALLS, longest_s=_LONGEST_S)
            found[run.label] = _cost(calls, on_gpu=run.devices[0] != "cpu")
    return found


def _cost(calls: Sequence[tuple[float, float]], *, on_gpu: bool) -> Cost:
    """Processor time, which other programs hardly change; on a GPU time by the clock.

    The first call compiles and fills caches, and counts only if it is the only one.
    """
    kept = [clock if on_gpu else processor for clock, processor in calls[1:] or calls]
    what = "by the clock" if on_gpu else "of processor time"
    size = f"{STANDARD[0]}x{STANDARD[1]}"
    return Cost(Value(sum(kept) / len(kept), min(kept), max(kept)), f"{what} a frame of {size}")


def _notes(verdict: Verdict, scenes: StagedScenes) -> list[str]:
    notes = [f"{counted(verdict.frames, 'frame')} of {counted(verdict.scenes, 'scene')}."]
    if verdict.unit == "view":
        notes.append(
            f"Intervals are over {counted(verdict.units, 'view')}: they hold for these objects in "
            "these scenes, seen from elsewhere, not for other objects."
        )
    else:
        notes.append(f"Intervals are over {verdict.units} scenes.")
    agree = "the median of other views, where at least three agree within max(3 mm, 1 %)"
    if scenes.sprayed:
        notes.append(f"Truth is of the sprayed scene: {agree}; errors of the camera count as true.")
    elif scenes.around:
        notes.append(
            f"Truth of what is around the objects ({scenes.around:.0%} of its pixels): {agree}."
        )
    notes += [f"{name} does not compete: {why}." for name, why in verdict.left_out.items()]
    return notes


def _html(done: Bakeoff, results: Sequence[RunResult]) -> str:
    verdict = done.verdict
    blocks: list[Block] = [
        Bullets([Paragraph(text) for text in by_material(verdict)]),
        _table(verdict),
        *(Paragraph(text) for text in done.notes),
    ]
    state = {"use": "pass", "undecided": ""}.get(verdict.kind, "fail")
    word = {"use": "use", "undecided": "undecided"}.get(verdict.kind, "with care")
    board = make_board(results, published=False)
    return Page(
        kind="Bake-off",
        title="Which restorer for this camera?",
        verdicts=[Head(conclusion(verdict), word, state)],
        sections=[Section("answer", "What the frames tell", blocks), *board_sections(board)],
        footer=f"std-toolkit {__version__}, `std-bench bakeoff`.",
    ).html()


def _table(verdict: Verdict) -> Table:
    """Error on each material, harm and speed of each method, with intervals."""
    rmse = METRICS[0]
    shown = verdict.rankings
    columns = [Column(heading="method", numeric=False)]
    for name in shown:
        heading = f"RMSE, {MATERIALS[name].removesuffix(' objects')}"
        columns.append(Column(heading=heading, unit=rmse.unit, factor=rmse.factor, digits=1))
    columns += [*harm.COLUMNS, Column(heading="time", unit="s", digits=2)]
    order = list(shown[verdict.main].errors) if verdict.main in shown else []
    rows = []
    for method in [*order, *verdict.left_out]:
        of_method, cost = verdict.harms.get(method, {}), verdict.costs.get(method)
        values = [ranking.errors.get(method) for ranking in shown.values()]
        ties = [method in ranking.tied for ranking in shown.values()]
        values += [of_method.get(column.name) for column in harm.COLUMNS]
        values.append(None if cost is None else cost.seconds)
        marks = [*ties, *([False] * (len(harm.COLUMNS) + 1))]
        cells = [
            _cell(column, value, best=mark)
            for column, value, mark in zip(columns[1:], values, marks, strict=True)
        ]
        rows.append(Row([Cell(text=method), *cells]))
    what = sorted({cost.what for cost in verdict.costs.values()})
    notes = [
        "In brackets: 95 % intervals, of time the range of a few calls. Bold: the best, and what "
        "is not shown to be worse. Harm: share of the depth that the sensor had right and the "
        f"method made wrong. Time: {'; '.join(what) or 'not measured'}."
    ]
    return Table(columns=columns, rows=rows, title="All methods", notes=notes, sortable=True)


def _cell(column: Column, value: Value | None, *, best: bool) -> Cell:
    if value is None:
        return Cell(text="")
    interval = (value.low, value.high)
    return column.cell(value.mean, interval=interval, mark="best" if best else "")
