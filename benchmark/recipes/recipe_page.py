"""The table of a recipe as CSV, Markdown and a page. Each of them tells the scale."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import pandas as pd

from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.recipes.recipe_plan import RecipePlan
from benchmark.recipes.recipe_run import Outcome
from benchmark.recipes.recipe_table import ABSENT, MEASURED, PUBLISHED, findings, recipe_rows
from benchmark.report.leaderboard import BOARD
from benchmark.report.leaderboard_text import MAIN_SUBSETS
from benchmark.report.parts import depth_sections
from std_toolkit import __version__
from std_toolkit.html.markup import CSS, paragraph, section, words
from std_toolkit.io.atomic import write_bytes_atomic

PAGE, MARKDOWN, CSV = "report.html", "table.md", "table.csv"
_OBJECTS = {"all": "all objects", "specular+transparent": "specular and transparent"}
_STYLE = """
tr.published td { background:#f4f1ea; font-style:italic; color:var(--soft); }
tr.absent td { color:var(--bad); white-space:normal; }
td small, th small { display:block; color:var(--faint); font-weight:400; font-size:11.5px; }
h2 small { font-weight:400; font-size:13px; color:var(--bad); margin-left:10px; }
.strip { margin:0 0 10px; }
.strip img { width:100%; display:block; border-radius:3px; }
.panels { display:grid; grid-template-columns:repeat(5,1fr); font-size:12px; color:var(--faint); }
details { margin:8px 0; }
summary { cursor:pointer; color:var(--link); }
b.over { color:var(--bad); }
"""
_NOTE = (
    "Figures are means over frames. `paper` is the released evaluation, which the published "
    "figures were made by; under `strict` a hole costs its whole depth. Published rows are as "
    "printed: of the full data and training, and the paper's own networks."
)


def write_pages(plan: RecipePlan, outcome: Outcome) -> str:
    """Write the table in all formats; returns it for a terminal.

    Raises:
        ToolkitError: a file cannot be written.
    """
    rows = recipe_rows(plan, outcome)
    told = findings(plan, outcome)
    plan.folder.mkdir(parents=True, exist_ok=True)
    texts = {
        CSV: rows.to_csv(index=False, lineterminator="\n"),
        MARKDOWN: markdown(plan, outcome, rows, told),
        PAGE: html(plan, outcome, rows, told),
    }
    for name, text in texts.items():
        write_bytes_atomic(plan.folder / name, text.encode())
    return f"{terminal(plan, rows, told)}\n{plan.folder / PAGE}"


def scale_line(plan: RecipePlan) -> str:
    """The scale, and what its numbers are worth."""
    return f"Scale: {plan.scale_name} ({plan.scale.about})"


def markdown(plan: RecipePlan, outcome: Outcome, rows: pd.DataFrame, told: Sequence[str]) -> str:
    """The tables as GitHub's Markdown; published rows in italics."""
    lines = [f"# {plan.recipe.title}", "", f"**{scale_line(plan)}**", "", plan.recipe.about, ""]
    lines += [f"- {sentence}" for sentence in told] + [""] * bool(told)
    for target in plan.targets:
        mine = rows[rows["test"] == target.name]
        lines += [f"## {target.title} (scale {plan.scale_name})", "", f"{_data(mine)}.", ""]
        for row in mine[mine["kind"] == ABSENT].to_dict("records"):
            lines.append(f"- **{row['variant'] or 'Not measured'}**: {row['note']}")
        for subset in MAIN_SUBSETS:
            block = mine[(mine["subset"] == subset) & (mine["kind"] != ABSENT)]
            if block.empty:
                continue
            heads = [_OBJECTS[subset], "figures", *(column.title for column in BOARD), "training"]
            lines += ["", "| " + " | ".join(heads) + " |", "|---|---|" + "---:|" * 7 + "---|"]
            for row in block.to_dict("records"):
                cells = [row["variant"], _figures(row), *_numbers(row), _training(row)]
                if row["kind"] == PUBLISHED:
                    cells = [f"*{cell}*" if cell else "" for cell in cells]
                lines.append("| " + " | ".join(c.replace("|", r"\|") for c in cells) + " |")
        lines.append("")
    lines += [_NOTE]
    if outcome.problems:
        lines += ["", f"## What did not run (scale {plan.scale_name})", ""]
        lines += [f"- {what}: {why}" for what, why in outcome.problems.items()]
    return "\n".join(lines).rstrip() + "\n"


def html(plan: RecipePlan, outcome: Outcome, rows: pd.DataFrame, told: Sequence[str]) -> str:
    """One file that needs nothing but itself; the same results give the same bytes."""
    results = [result for found in outcome.results.values() for result in found]
    parts = []
    for i, target in enumerate(plan.targets):
        mine = rows[rows["test"] == target.name]
        body = paragraph(f"{_data(mine)}.")
        for row in mine[mine["kind"] == ABSENT].to_dict("records"):
            body += f'<p class="absent"><b>{escape(row["variant"] or "Not measured")}</b>: '
            body += f"{words(row['note'])}</p>"
        for subset in MAIN_SUBSETS:
            block = mine[(mine["subset"] == subset) & (mine["kind"] != ABSENT)]
            if not block.empty:
                body += _table(_OBJECTS[subset], block.to_dict("records"))
        parts.append((f"test-{i}", target.title, body))
    problems = "".join(paragraph(f"{what}: {why}") for what, why in outcome.problems.items())
    parts += [
        ("problems", "What did not run", problems),
        ("pictures", "Pictures", depth_sections.gallery(_shown(plan, results))),
        ("runs", "What ran", depth_sections.runs(results) if results else ""),
    ]
    links = "".join(f'<a href="#{k}">{escape(t)}</a>' for k, t, body in parts if body)
    # Each section tells the scale: they are what is shown around in pictures.
    mark = f" <small>scale {escape(plan.scale_name)}</small></h2>"
    body = "".join(section(k, t, b).replace("</h2>", mark, 1) for k, t, b in parts)
    summary = "".join(paragraph(sentence) for sentence in told)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(plan.recipe.title)}, scale {escape(plan.scale_name)}</title>"
        '<link rel="icon" href="data:,">'
        f"<style>{CSS}{_STYLE}</style></head><body>"
        '<header><div class="inner"><div class="kind">Recipe</div>'
        f"<h1>{escape(plan.recipe.title)}</h1>"
        f'<div class="verdict{" fail" if plan.scale_name == "tiny" else ""}">'
        f"<b>Scale: {escape(plan.scale_name)}</b><span>{words(plan.scale.about)}</span></div>"
        f"{paragraph(plan.recipe.about)}{summary}"
        f"{paragraph(_NOTE)}</div></header>"
        f'<nav><div class="inner">{links}</div></nav><main>{body}'
        f"<footer>std-toolkit {__version__}, std-train recipe {escape(plan.name)} --scale "
        f"{escape(plan.scale_name)}. The same figures: {CSV}.</footer></main></body></html>\n"
    )


def terminal(plan: RecipePlan, rows: pd.DataFrame, told: Sequence[str]) -> str:
    """The rows of specular and transparent objects, or of all where there are no others."""
    lines = [scale_line(plan)]
    for target in plan.targets:
        mine = rows[rows["test"] == target.name]
        lines.append(f"{target.title}: {_data(mine)}")
        lines += [
            f"  {row['variant'] or 'not measured'}: {row['note']}"
            for row in mine[mine["kind"] == ABSENT].to_dict("records")
        ]
        shown = mine[mine["kind"] != ABSENT]
        hard = shown[shown["subset"] == MAIN_SUBSETS[-1]]
        for row in (shown if hard.empty else hard).to_dict("records"):
            numbers = "  ".join(
                f"{c.heading} {text}{c.unit and ' ' + c.unit}"
                for c, text in zip(BOARD, _numbers(row), strict=True)
                if text and c.name in ("rmse", "mae", "d105")
            )
            lines.append(f"  {row['variant']} ({_figures(row)}, {row['subset']}): {numbers}")
    return "\n".join([*lines, *told])


def _table(title: str, rows: Sequence[dict[str, object]]) -> str:
    heads = "".join(
        f'<th class="n">{escape(c.heading)}<small>{escape(c.unit)}</small></th>' for c in BOARD
    )
    body = []
    for row in rows:
        numbers = _numbers(row)
        interval = _interval(row)
        cells = "".join(
            f'<td class="n">{text}{interval if i == 0 else ""}</td>'
            for i, text in enumerate(numbers)
        )
        kind = ' class="published"' if row["kind"] == PUBLISHED else ""
        body.append(
            f"<tr{kind}><td>{escape(str(row['variant']))}</td><td>{escape(_figures(row))}</td>"
            f"{cells}<td>{escape(_training(row))}</td></tr>"
        )
    return (
        f'<h3>{escape(title)}</h3><div class="scroll"><table><thead><tr><th>variant</th>'
        f"<th>figures</th>{heads}<th>training</th></tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def _numbers(row: dict[str, object]) -> list[str]:
    printed = row["kind"] == PUBLISHED
    return [column.text(row[column.name], printed=printed) for column in BOARD]  # type: ignore[arg-type]


def _interval(row: dict[str, object]) -> str:
    low, high = row["rmse_low"], row["rmse_high"]
    if row["kind"] != MEASURED or pd.isna(low):
        return ""
    return f"<small>{BOARD[0].text(low)}–{BOARD[0].text(high)}</small>"  # type: ignore[arg-type]


def _figures(row: dict[str, object]) -> str:
    if row["kind"] == PUBLISHED:
        return "published"
    frames, scenes = int(row["frames"]), int(row["scenes"])  # type: ignore[call-overload]
    return f"{row['protocol']}, {frames} frames of {scenes} scene{'s' * (scenes != 1)}"


def _training(row: dict[str, object]) -> str:
    if row["kind"] == PUBLISHED:
        note = f"; {row['note']}" if row["note"] and not pd.isna(row["note"]) else ""
        return f"{row['training_data']}{note}"
    if pd.isna(row["steps"]):
        return ""
    count = {k: int(row[k]) for k in ("training_frames", "training_scenes", "steps", "batch_size")}  # type: ignore[call-overload]
    return (
        f"{count['training_frames']} frames of {count['training_scenes']} scenes, "
        f"{count['steps']} steps of {count['batch_size']}"
    )


def _data(rows: pd.DataFrame) -> str:
    return f"Frames: {rows['data'].iloc[0]}"


def _shown(plan: RecipePlan, results: Sequence[RunResult]) -> list[RunResult]:
    """Pictures by one protocol are enough."""
    return [r for r in results if r.manifest.setup.protocol == plan.recipe.protocols[-1]]
