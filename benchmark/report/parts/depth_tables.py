"""Tables of depth restoration: leaderboard, breakdowns, costs, runs."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmark.evaluation import probes
from benchmark.evaluation.results import FAILED
from benchmark.evaluation.tasks.depth_results import RunResult, seen_columns
from benchmark.evaluation.tasks.depth_speed import CPU_CORES, CPU_S, STANDARD
from benchmark.metrics.depth.figures import shown_columns
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.report import leaderboard
from benchmark.report.page import NOTES
from benchmark.report.parts.published import address_note
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

RMSE = leaderboard.METRICS[0]
# Subsets with a separate table.
MAIN_SUBSETS = ("all", "specular+transparent")
OBJECTS = {
    "scene": "all pixels with truth",
    "all": "all objects",
    "specular+transparent": "specular and transparent objects",
}
DEPTH_PREFIX = "depth:"
FEW_SCENES = 10
LACKING = (
    "Rows with unanswered frames are not ranked: where the method failed, or saved depth has no "
    "file, every pixel counts as missing."
)
CLASSES = (
    f"cpu: at most {CPU_S:g} s a frame of {STANDARD[0]}x{STANDARD[1]} on {CPU_CORES} cores; gpu: "
    "slower, or measured on one; not stated"
)
ALIGNED = "Depth after one scale and shift to the truth: not to be compared with metric depth."
_COUNTS = (Column(heading="frames", digits=0), Column(heading="scenes", digits=0))
_METHOD = Column(heading="method", numeric=False)
_CLASS = Column(heading="class", numeric=False)


def board_title(board: leaderboard.Board, split: str, protocol: str) -> str:
    """Return the title of a table, with the number of frames."""
    return f"{split}, protocol {protocol}: {board.counted(split)}"


def board_tables(
    board: leaderboard.Board, split: str, protocol: str, *, all_published: bool = False
) -> list[Table]:
    """Return the tables of one split and protocol, one for each main subset.

    Args:
        board: all rows.
        split, protocol: split and protocol of the tables.
        all_published: include published ablations and other trainings.
    """
    grid, first = get_protocol(protocol).main
    aligned = bool(get_protocol(protocol).align)
    columns = shown_columns(aligned=aligned)
    tables = []
    for subset in dict.fromkeys((first, *MAIN_SUBSETS)):
        rows = board.part(split, protocol, grid, subset)
        measured = rows[rows["kind"] == leaderboard.MEASURED]
        if measured.empty:
            continue
        ranked = int(leaderboard.is_ranked(rows).sum())
        classes = "" if measured["speed_class"].nunique() < 2 else f" of its class ({CLASSES})"
        notes = [
            f"Bold: best measured{classes}. {_certainty(int(measured['scenes'].max()), ranked)}"
        ]
        if ranked < len(measured):
            notes.append(LACKING)
        notes += [ALIGNED] if aligned else []
        if (rows["kind"] == leaderboard.PUBLISHED).any():
            notes.append(address_note(rows["source"].dropna()))
        title = f"{board_title(board, split, protocol)}, {OBJECTS.get(subset, subset)}"
        chosen = rows if all_published else leaderboard.one_of_each(rows)
        tables.append(_method_table(chosen, columns, title=title, notes=notes, counts=True))
    return tables


_SEEN = (
    "Depth at the sensor's size, as std-restore writes it. Harm: share of the pixels that the "
    "sensor had right, within max(3 mm, 1 %), and the method made wrong by more than twice that.",
    "Cut holes: median error where depth that was right had been removed; other columns: RMSE on "
    "glass and metal. Both need `std-bench --probe`.",
)


def seen_tables(board: leaderboard.Board, split: str, protocol: str) -> list[Table]:
    """Return the table of what a user sees of the methods, and that of their spreads; tables
    without any figure are left out."""
    rows = board.main_rows(split, protocol)
    rows = rows[rows["kind"] == leaderboard.MEASURED]
    columns = seen_columns(rows)
    of = board_title(board, split, protocol)
    spreads = [c for c in columns if c in probes.SPREAD_COLUMNS]
    others = [c for c in columns if c not in spreads]
    tables = []
    if others:
        title = f"{of}, what a user sees"
        tables.append(_method_table(rows, others, title=title, notes=_SEEN))
    if spreads:
        title = f"{of}, expected errors"
        notes = ["Of errors at the method's size, 68 % and 95 % lie within 1 and 2 true spreads."]
        tables.append(_method_table(rows, spreads, title=title, notes=notes))
    return tables


def cost_table(board: leaderboard.Board, rows: pd.DataFrame, split: str, protocol: str) -> Table:
    """Return the table of the cost and accuracy of methods."""
    title = board_title(board, split, protocol)
    notes = [
        "Time of the method alone, without reading and scoring. Processor: time over all cores, "
        "which other programs hardly change. Load: programs that ran in the minute before."
    ]
    return _method_table(rows, (RMSE, *leaderboard.COSTS), title=title, notes=notes, hardware=True)


def breakdown_tables(board: leaderboard.Board, split: str, protocol: str) -> list[Table]:
    """Return tables of RMSE by material, at edges, at native size, and by scene."""
    grid, first = get_protocol(protocol).main
    rows = board.rows[(board.rows["split"] == split) & (board.rows["protocol"] == protocol)]
    rows = rows[
        (rows["kind"] == leaderboard.MEASURED) & ~rows["subset"].str.startswith(DEPTH_PREFIX)
    ]
    order = board.part(split, protocol, grid, first)
    methods = order.loc[order["kind"] == leaderboard.MEASURED, "method"].tolist()
    of = board.counted(split)
    tables = []
    for name, block in rows.groupby("grid", sort=False):
        wide = block.pivot(index="method", columns="subset", values=RMSE.name)
        wide = wide.reindex(index=methods, columns=list(dict.fromkeys(block["subset"])))
        tables.append(_matrix(wide, f"{RMSE.title} by pixels, {name}: {of}", "method"))
    frames = board.tables
    chosen = (frames["split"] == split) & (frames["protocol"] == protocol)
    chosen &= (frames["grid"] == grid) & (frames["subset"] == first) & (frames["n_pixels"] > 0)
    scenes = frames[chosen].pivot_table(
        index="scene", columns="method", values=RMSE.name, aggfunc="mean"
    )
    scenes = scenes.reindex(columns=[m for m in methods if m in scenes])
    if len(scenes) > 1:
        tables.append(_matrix(scenes, f"{RMSE.title} by scene: {of}", "scene"))
    return tables


def run_table(results: Sequence[RunResult]) -> Table:
    """Return the table of runs: weights, hardware and failures."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        settings = ", ".join(f"{k}={v}" for k, v in sorted(s.settings.items()))
        how = [
            result.preset,
            s.precision,
            *(["compiled"] if s.compile else []),
            settings,
            s.backend,
        ]
        how = how if result.preset or settings else [settings]
        if s.released_loader:
            how.append(f"authors' loader, batches of {s.released_loader}")
        cells = [
            Cell(text=m.label),
            Cell(text=f"{result.place}, {s.protocol}"),
            Cell(text=str(result.data.provenance)),
            *counted(s.frames, result.missing, result.failed),
            Cell(text=", ".join(h for h in how if h)),
            *machine(s.weights_sha256[:12], _hardware(result), m.version_of_tool),
            Cell(text=result.training_data),
        ]
        rows.append(Row(cells))
    heads = run_columns("method", "split, protocol", "data")
    trained = Column(heading="trained on", numeric=False)
    return Table(columns=[*heads, trained], rows=rows)


def _hardware(result: RunResult) -> dict[str, str]:
    """Of this machine; of predictions in a folder, what their author says."""
    if not result.manifest.setup.depth_from:
        return result.manifest.hardware
    return {"processor": result.said.hardware if result.said else ""}


def run_columns(*names: str) -> list[Column]:
    """Return the columns of a table of runs; `names` are the first ones."""
    numeric = ("frames", "failed")
    heads = (*names, *numeric, "settings", "weights", "ran on", "version")
    return [Column(heading=h, numeric=h in numeric, digits=0) for h in heads]


def counted(frames: int, missing: int, failed: int) -> list[Cell]:
    """Return the cells with the numbers of frames and of failed frames of a run."""
    of = f"{frames - missing} of {frames}" if missing else str(frames)
    return [
        Cell(text=of, mark="bad" if missing else ""),
        Cell(text=str(failed), mark="bad" if failed else ""),
    ]


def machine(weights: str, hardware: dict[str, str], version: str) -> list[Cell]:
    """Return the cells with weights, hardware and version of a run."""
    processor = hardware.get("gpus") or hardware.get("processor", "")
    return [Cell(text=weights), Cell(text=processor), Cell(text=version)]


def can_differ(scenes: int, methods: int) -> bool:
    """Whether the test of differences can be significant: over n scenes p is at least 2 / 2**n,
    before the correction for all pairs."""
    pairs = methods * (methods - 1) / 2
    return bool(pairs * 2.0 ** (1 - scenes) < leaderboard.SIGNIFICANT)


def interval_note(scenes: int) -> str:
    """Return the note that explains the brackets after figures."""
    if scenes < 2:
        return "With one scene there are no intervals."
    few = ", too narrow with so few scenes" if scenes < FEW_SCENES else ""
    return f"In brackets: 95 % intervals over scenes{few}."


def _certainty(scenes: int, methods: int) -> str:
    note = interval_note(scenes)
    if methods < 2 or scenes < 2:
        return note
    if not can_differ(scenes, methods):
        return f"{note} With {scenes} scenes and {methods} methods no difference is significant."
    return (
        f"{note} ≈: not significantly worse than the best in RMSE (sign-flip test over scenes, "
        "corrected for all pairs)."
    )


def _method_table(
    rows: pd.DataFrame,
    columns: Sequence[Column],
    *,
    title: str,
    notes: Sequence[str],
    counts: bool = False,
    hardware: bool = False,
) -> Table:
    best = _best_figures(rows, columns)
    ranked = leaderboard.is_ranked(rows)
    methods = int(ranked.sum())
    in_classes = bool(set(rows["speed_class"]) & {"cpu", "gpu"})
    made = []
    for row, competes in zip(rows.to_dict("records"), ranked, strict=True):
        published = row["kind"] == leaderboard.PUBLISHED
        # The test does not apply to costs.
        tested = counts and competes and can_differ(row["scenes"], methods)
        alike = tested and row["p_best"] >= leaderboard.SIGNIFICANT
        note = f"published; {source_of(row)}" if published else "≈" if alike else ""
        cells = [Cell(text=row["method"]), *([class_cell(row)] if in_classes else [])]
        cells += [frames_cell(row), _COUNTS[1].cell(row["scenes"])] if counts else []
        for column in columns:
            value = row[column.name]
            ends = [row.get(f"{column.name}_{end}", math.nan) for end in ("low", "high")]
            is_best = competes and value == best.get((row["speed_class"], column.name))
            nowhere = not published and column is columns[0] and row["failed"] == row["frames"]
            cells.append(
                column.cell(
                    value,
                    interval=(ends[0], ends[1]),
                    published=published,
                    mark="best" if is_best else "",
                    missing=FAILED if nowhere else "",
                )
            )
        cells += [Cell(text=str(row["hardware"]))] if hardware else []
        cells += [Cell(text=note)]
        made.append(Row(cells, "published" if published else ""))
    heads = [_METHOD, *([_CLASS] if in_classes else []), *(_COUNTS if counts else ()), *columns]
    heads += [Column(heading="on", numeric=False)] if hardware else []
    heads += [Column(heading=NOTES, numeric=False)]
    table = Table(columns=heads, rows=made, title=title, notes=notes, sortable=True)
    return table if any(row.cells[-1].text for row in made) else table.without(NOTES)


def frames_cell(row: dict[str, object]) -> Cell:
    """Return the cell with the number of frames of a row, and of those without an answer."""
    cell = _COUNTS[0].cell(row["frames"])  # type: ignore[arg-type]
    if not (row["kind"] == leaderboard.MEASURED and row["unanswered"]):
        return cell
    return replace(cell, text=f"{cell.text} ({row['unanswered']:.0f} unanswered)", mark="bad")


def source_of(row: dict[str, object]) -> str:
    """Return table, grade and training data of a published row: papers print a method several
    times, with other training data or repeated."""
    training = row["training_data"]
    table = f"{row['table']} ({row['trust']})"
    return f"{table}; trained on {training}" if isinstance(training, str) and training else table


def class_cell(row: dict[str, object]) -> Cell:
    """Return the cell with the class of speed of a row, and its place in it."""
    if row["kind"] == leaderboard.PUBLISHED:
        return Cell(text=NONE)
    place = row["place"]
    ranked = isinstance(place, float) and math.isfinite(place)
    return Cell(text=str(row["speed_class"]), note=f"{place:.0f}." if ranked else "")


def _best_figures(rows: pd.DataFrame, columns: Sequence[Column]) -> dict[tuple[str, str], float]:
    """The best ranked figure of each class and column that has a direction."""
    measured = rows[leaderboard.is_ranked(rows)]
    return {
        (str(name), c.name): part[c.name].min() if c.lower_is_better else part[c.name].max()
        for name, part in measured.groupby("speed_class")
        for c in columns
        if c.lower_is_better is not None
    }


def _matrix(wide: pd.DataFrame, title: str, corner: str) -> Table:
    """RMSE of methods (columns) by scene, shaded from the best to the worst method."""
    values = wide.to_numpy(float)
    axis = 1 if corner == "scene" else 0
    with np.errstate(all="ignore"):
        low = np.fmin.reduce(values, axis=axis, keepdims=True)
        high = np.fmax.reduce(values, axis=axis, keepdims=True)
        level = (np.log(values + 1e-4) - np.log(low + 1e-4)) / np.log((high + 1e-4) / (low + 1e-4))
    rows = []
    for name, line, shades in zip(wide.index, values, level, strict=True):
        cells = [
            Cell(
                text=RMSE.text(value) or NONE,
                value=value,
                shade=f"rgba(180,35,24,{0.28 * shade:.2f})" if np.isfinite(shade) else "",
            )
            for value, shade in zip(line, shades, strict=True)
        ]
        rows.append(Row([Cell(text=str(name)), *cells]))
    columns = [Column(heading=corner, numeric=False)]
    columns += [Column(heading=str(c), lower_is_better=True) for c in wide.columns]
    return Table(columns=columns, rows=rows, title=title)
