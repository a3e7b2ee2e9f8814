"""Table clearing in a report: the paper's table, causes of failure, strips, and what it answers.

Which runs of table clearing a report is about: with what, and where.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2
import pandas as pd

from benchmark.evaluation.results import INDEX
from benchmark.evaluation.tasks.grasp import ORACLE, RAW, STRIPS, TRUE
from benchmark.evaluation.tasks.grasp_results import (
    HEADINGS,
    PLAN_HEADINGS,
    GraspResult,
    Rate,
    cells,
    completion_gain,
    grasp_table,
    plan_cells,
    read_grasp_results,
    share,
)
from benchmark.evaluation.tasks.grasp_table import ATTEMPT, KIND, scene_name
from benchmark.published.load import published_rows
from benchmark.report.page import PageSection, ReportPart
from std_toolkit.html.markup import Cell, paragraph, table, text, words
from std_toolkit.io.images import read_color

_HEADS = ("planner", "depth", "camera", "seed", "tables", "how", "weights", "ran on", "tool")

CSV, MARKDOWN, LATEX = "grasping.csv", "grasping.md", "grasping.tex"

# Strips of a run that the page shows: one of every way in which attempts ended.
_MOST_STRIPS = 6

_STRIP_QUALITY = 80

_DEFINITIONS = (
    "Success: attempts that ended with an object held, of all attempts; per table: the mean over "
    "rounds, a round in which nothing could be tried counting 0. Completion: objects removed (held "
    "after lifting, or over the table's edge) of those that stood there, over all objects, and as "
    "the mean over tables. In brackets: 95 %, by drawing whole rounds. The published completion of "
    "40 % does not follow from the 19 objects of about 25 printed beside it (76 %)."
)

_PLANNED = (
    "GraspNet's average precision of all grasps planned on the first view of each table, which is "
    "the same for every planner and depth, judged by the true meshes: of the best 50 (10 for an "
    "object at most), those fail that hit something, have nothing between the fingers, or do not "
    "hold; AP is the mean over frictions of 0.2 to 1.2."
)


def grasp_runs(results: Sequence[GraspResult]) -> str:
    """What ran, with what, on what."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        how = [f"planner {s.planner_preset}"] if s.planner_weights_sha256 else []
        how += [f"depth {s.depth_preset}"] if s.depth_preset else []
        how += [f"{s.planner}.{k}={v}" for k, v in sorted(s.planner_settings.items())]
        how += [f"{s.depth}.{k}={v}" for k, v in sorted(s.depth_settings.items())]
        digests = [w[:12] for w in (s.planner_weights_sha256, s.depth_weights_sha256) if w]
        rows.append(
            [
                Cell(escape(m.planner_label)),
                Cell(escape(m.depth_label)),
                Cell(escape(s.camera)),
                Cell(str(s.seed), numeric=True),
                Cell(str(result.rates.rounds), numeric=True),
                Cell(escape(", ".join(how) or "-")),
                Cell(words(" ".join(f"`{w}`" for w in digests) or "-")),
                Cell(escape(m.hardware.get("gpus") or m.hardware.get("processor", ""))),
                Cell(escape(m.version_of_tool)),
            ]
        )
    return table([(head, "") for head in _HEADS], rows)


def grasp_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """See `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, or none is finished.
    """
    results = read_grasp_results(folders)
    rounds = max(r.rates.rounds for r in results)
    planners = list(dict.fromkeys(r.manifest.planner_label for r in results))
    depths = list(dict.fromkeys(r.manifest.depth_label for r in results))
    rows = printed_rows() if published else []
    return ReportPart(
        title="Grasping: table clearing",
        summary=f"{rounds} tables of 4 to 5 specular or transparent objects in simulation; "
        f"planners: {escape(', '.join(planners))}; depth: {escape(', '.join(depths))}",
        sections=[
            PageSection("clearing", "Table clearing", _board(results, rows)),
            PageSection("clearing-plans", "What was planned", _plans(results)),
            PageSection("clearing-causes", "How attempts ended", _causes(results)),
            PageSection("clearing-strips", "Attempts in pictures", _strips(results)),
            PageSection("clearing-runs", "What ran: clearing", grasp_runs(results)),
        ],
        answer=_answer(results),
        terminal=grasp_table(results),
        files={
            CSV: board_of(results).to_csv(index=False),
            MARKDOWN: _markdown(results, rows),
            LATEX: _latex(results, rows),
        },
    )


def printed_rows() -> list[list[str]]:
    """The paper's figures under the same headings; what it does not print is a dash."""
    rows = published_rows()
    rows = rows[(rows["task"] == "grasping") & (rows["table"].str.contains("table clearing"))]
    found = []
    for method, part in rows.groupby("method", sort=False):
        figure = dict(zip(part["metric"], part["value"], strict=True))
        found.append(
            [
                str(method),
                "published",
                "6",
                f"{figure['objects_grasped']} / {figure['attempts']}",
                figure["success_rate_pct"],
                "-",
                "-",
                "-",
                figure["completion_rate_pct"],
                "-",
                "-",
                "-",
            ]
        )
    return found


def board_of(results: Sequence[GraspResult]) -> pd.DataFrame:
    """One row per run, rates as shares."""
    rows = []
    for result in results:
        camera, seed, planner, depth = result.name
        rates = result.rates
        row: dict[str, object] = {
            "camera": camera,
            "seed": seed,
            "planner": planner,
            "depth": depth,
            "rounds": rates.rounds,
            "objects": rates.objects,
            "attempts": rates.attempts,
            "grasped": rates.grasped,
            "off_table": rates.lost,
        }
        shares = {
            "success_attempts": rates.success_attempts,
            "success_tables": rates.success_tables,
            "completion_objects": rates.completion_objects,
            "completion_tables": rates.completion_tables,
            "cleared": rates.cleared,
            **{f"completion_{m}": r for m, r in sorted(rates.completion_of.items())},
            **rates.precision,
        }
        for name, rate in shares.items():
            row |= {name: rate.value, f"{name}_low": rate.low, f"{name}_high": rate.high}
        rows.append(row)
    return pd.DataFrame(rows)


def _board(results: Sequence[GraspResult], printed: Sequence[Sequence[str]]) -> str:
    parts = [paragraph(_DEFINITIONS)]
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        mine = [r for r in results if r.name[:2] == (camera, seed)]
        parts.append(f"<h3>{escape(camera)} camera, seed {seed}</h3>")
        rows = [[*map(text, cells(r)[:2]), *map(_figure, cells(r)[2:])] for r in mine]
        rows += [[*map(text, row[:2]), *map(_figure, row[2:])] for row in printed]
        parts.append(table([_heading(title) for title in HEADINGS], rows))
    if printed:
        parts.append(paragraph("Published rows were measured with a real robot and other objects."))
    return "".join(parts)


def _plans(results: Sequence[GraspResult]) -> str:
    rows = [
        [
            text(plan_cells(r)[0]),
            text(plan_cells(r)[1], small=f"{r.name[0]} camera, seed {r.name[1]}"),
            *map(_figure, plan_cells(r)[2:]),
        ]
        for r in results
    ]
    return paragraph(_PLANNED) + table([(title, "") for title in PLAN_HEADINGS], rows)


def _heading(title: str) -> tuple[str, str]:
    """A heading in two lines: what, and of what."""
    for mark in (" %", " / "):
        if mark in title:
            at = title.index(mark)
            return title[:at], title[at:].strip()
    return title, ""


def _figure(cell: str) -> Cell:
    """A number, with its interval below it."""
    value, bracket, interval = cell.partition(" [")
    note = f"<small>{escape(bracket.strip() + interval)}</small>" if interval else ""
    return Cell(escape(value) + note, numeric=True)


def _causes(results: Sequence[GraspResult]) -> str:
    names = sorted({name for r in results for name in r.rates.outcomes})
    rows = [
        [
            text(r.manifest.planner_label),
            text(r.manifest.depth_label, small=f"{r.name[0]} camera, seed {r.name[1]}"),
            *(_figure(str(r.rates.outcomes.get(name, 0))) for name in names),
        ]
        for r in results
    ]
    return table([("planner", ""), ("depth", ""), *((name, "views") for name in names)], rows)


def _strips(results: Sequence[GraspResult]) -> str:
    parts = []
    for result in results:
        views = result.table[result.table[KIND] == ATTEMPT]
        first = views.drop_duplicates("outcome").head(_MOST_STRIPS)
        shown = [
            _strip(result.folder / STRIPS / name, f"{scene_name(int(index))}: {outcome}")
            for index, number, outcome in zip(
                first[INDEX], first["attempt"], first["outcome"], strict=True
            )
            if (result.folder / STRIPS / (name := strip_name(int(index), int(number)))).is_file()
        ]
        if shown:
            title = f"{result.manifest.planner_label} on {result.manifest.depth_label} depth"
            parts.append(f"<h3>{escape(title)}</h3>{''.join(shown)}")
    return "".join(parts)


def strip_name(index: int, attempt: int) -> str:
    """File name of an attempt's strip."""
    return f"{scene_name(index)}-attempt-{attempt:02d}.png"


def _strip(path: Path, caption: str) -> str:
    image = read_color(path)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _STRIP_QUALITY])
    encoded = base64.b64encode(data.tobytes()).decode("ascii")
    return (
        f'<figure class="strip"><img alt="{escape(caption)}" '
        f'src="data:image/jpeg;base64,{encoded}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def _answer(results: Sequence[GraspResult]) -> str:
    """How much more of a table is cleared with each depth than with raw depth."""
    lines = []
    for result in results:
        camera, seed, planner, depth = result.name
        raw = next((r for r in results if r.name == (camera, seed, planner, RAW)), None)
        if raw is None or depth == RAW or planner == ORACLE:
            continue
        gain = completion_gain(result.table, raw.table)
        if not gain.total:
            continue
        what = "True depth" if depth == TRUE else f"Depth by {depth}"
        lines.append(
            f"<li>{escape(what)} with {escape(planner)}: {escape(points(gain))} of a table's "
            f"objects removed than with raw depth, over the same {gain.total} tables "
            f"({escape(share(result.rates.completion_tables))} % against "
            f"{escape(share(raw.rates.completion_tables))} %); {verdict(gain)}.</li>"
        )
    return f'<ul class="findings">{"".join(lines)}</ul>' if lines else ""


def points(gain: Rate) -> str:
    """A difference of shares in percentage points.

    >>> points(Rate(0.25, 0.1, 0.4, 2, 8))
    '25.0 points [10.0, 40.0] more'
    """
    word = "more" if gain.value >= 0 else "fewer"
    return (
        f"{100 * abs(gain.value):.1f} points [{100 * gain.low:.1f}, {100 * gain.high:.1f}] {word}"
    )


def verdict(gain: Rate) -> str:
    """What an interval allows to say."""
    if math.isnan(gain.low):
        return "one table is too few to say"
    if gain.low > 0:
        return "it helps"
    return "it harms" if gain.high < 0 else "chance may explain it"


def _markdown(results: Sequence[GraspResult], printed: Sequence[Sequence[str]]) -> str:
    lines = [["camera", *HEADINGS], ["---"] * (len(HEADINGS) + 1)]
    lines += [[f"{r.name[0]}, seed {r.name[1]}", *cells(r)] for r in results]
    lines += [["robot", *row] for row in printed]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _latex(results: Sequence[GraspResult], printed: Sequence[Sequence[str]]) -> str:
    rows = [cells(r) for r in results] + [list(row) for row in printed]
    lines = [f"\\begin{{tabular}}{{ll{'r' * (len(HEADINGS) - 2)}}}"]
    lines += [" & ".join(map(_tex, line)) + r" \\" for line in (list(HEADINGS), *rows)]
    return "\n".join([*lines, r"\end{tabular}", ""])


def _tex(cell: str) -> str:
    return cell.replace("%", r"\%").replace("_", r"\_")
