"""The tables of a recipe as CSV, Markdown and a page; each states the scale."""

import re
from collections.abc import Sequence
from dataclasses import replace
from math import nan
from pathlib import Path

import pandas as pd

from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.recipes import (
    recipe_compare,
    recipe_plan,
    recipe_run,
    recipe_table,
)
from benchmark.recipes.recipe_overview import DIFFERENCES_CSV, MARKDOWN, NOTE, all_tables
from benchmark.report.leaderboard import BOARD, frames_of
from benchmark.report.parts.depth import gallery
from benchmark.report.parts.depth_tables import MAIN_SUBSETS, OBJECTS, run_table
from std_toolkit import __version__
from std_toolkit.html.page import Block, Bullets, Page, Paragraph, Section, Verdict
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.io.atomic import write_bytes_atomic

PAGE, CSV, POSES_CSV = "report.html", "table.csv", "poses.csv"
# Beside the recipes: all their tables.
ALL_TABLES = "tables.md"


def write_pages(plan: recipe_plan.RecipePlan, outcome: recipe_run.Outcome) -> str:
    """Write the table in all formats; returns it for a terminal.

    Raises:
        ToolkitError: a file cannot be written.
    """
    rows = recipe_table.recipe_rows(plan, outcome)
    differences = recipe_compare.comparisons(plan, outcome)
    titles = {target.name: target.title for target in plan.targets}
    compared = recipe_compare.comparison_tables(differences, titles)
    plan.folder.mkdir(parents=True, exist_ok=True)
    poses = recipe_table.pose_rows(plan, outcome)
    pose_tables = recipe_table.pose_tables(plan, poses) if plan.poses else []
    sections = _sections(plan, outcome, rows, compared, pose_tables)
    texts = {
        CSV: rows.to_csv(index=False, lineterminator="\n"),
        DIFFERENCES_CSV: differences.to_csv(index=False, lineterminator="\n"),
        MARKDOWN: markdown(plan, sections),
        PAGE: html(plan, outcome, sections),
    }
    if plan.poses:
        texts[POSES_CSV] = poses.to_csv(index=False, lineterminator="\n")
    for name, text in texts.items():
        write_bytes_atomic(plan.folder / name, text.encode())
    write_bytes_atomic(plan.out / ALL_TABLES, all_tables(plan.out, plan.scale_name).encode())
    shown = [terminal(plan, rows), *(table.terminal() for table in [*pose_tables, *compared])]
    return "\n\n".join(shown) + f"\n{plan.folder / PAGE}"


def scale_line(plan: recipe_plan.RecipePlan) -> str:
    """The scale, and what its numbers are worth."""
    return f"Scale: {plan.scale_name} ({plan.scale.about})"


def _sections(
    plan: recipe_plan.RecipePlan,
    outcome: recipe_run.Outcome,
    rows: pd.DataFrame,
    compared: Sequence[Table],
    pose_tables: Sequence[Table],
) -> list[Section]:
    """What the page and the text share. Each section states the scale: it is shown as a picture."""
    sections = [Section("differences", "Differences", list(compared))] if compared else []
    for i, target in enumerate(plan.targets):
        mine = rows[rows["test"] == target.name]
        blocks: list[Block] = [Paragraph(f"{_data(mine)}.")]
        blocks += [Paragraph(why, f"{what}:", "bad") for what, why in _absent(mine)]
        sections.append(Section(f"test-{i}", target.title, [*blocks, *_tables(mine)]))
    if pose_tables:
        sections.append(Section("poses", "Poses", list(pose_tables)))
    if outcome.problems:
        problems = [Paragraph(why, f"{what}:") for what, why in outcome.problems.items()]
        sections.append(Section("problems", "What did not run", [Bullets(problems)]))
    return [replace(section, mark=f"scale {plan.scale_name}") for section in sections]


def markdown(plan: recipe_plan.RecipePlan, sections: Sequence[Section]) -> str:
    """The tables as GitHub's Markdown; published rows in italics."""
    lines = [f"# {plan.recipe.title}", "", f"**{scale_line(plan)}**", "", plan.recipe.about, ""]
    for section in sections:
        lines += ["", NOTE] if section.anchor == "problems" else []
        lines += ["", f"## {section.title} ({section.mark})", ""]
        for block in section.blocks:
            if isinstance(block, Table):
                lines += ["", block.markdown(), ""]
            elif isinstance(block, Bullets):
                lines += [f"- {item.lead} {item.text}" for item in block.items]
            elif isinstance(block, Paragraph):
                lead = block.lead.rstrip(":")
                lines += [f"- **{lead}**: {block.text}"] if lead else [block.text, ""]
    lines += [] if NOTE in lines else ["", NOTE]
    return re.sub("\n{3,}", "\n\n", "\n".join(lines)) + "\n"


def html(
    plan: recipe_plan.RecipePlan, outcome: recipe_run.Outcome, sections: Sequence[Section]
) -> str:
    """One file that needs nothing but itself; the same results give the same bytes."""
    results = [result for found in outcome.results.values() for result in found]
    mark = f"scale {plan.scale_name}"
    more = [
        Section("pictures", "Pictures", gallery(_shown(plan, results)), mark),
        Section("runs", "What ran", [run_table(results)], mark),
    ]
    return Page(
        kind="Recipe",
        title=plan.recipe.title,
        tab_title=f"{plan.recipe.title}, {mark}",
        verdicts=[
            Verdict(
                plan.scale.about,
                f"Scale: {plan.scale_name}",
                "fail" if plan.scale_name == "tiny" else "",
            )
        ],
        intro=[Paragraph(text) for text in (plan.recipe.about, NOTE)],
        sections=[*sections, *more],
        footer=f"std-toolkit {__version__}, `std-train recipe {plan.name} --scale "
        f"{plan.scale_name}`. The same figures: `{CSV}`.",
    ).html()


def terminal(plan: recipe_plan.RecipePlan, rows: pd.DataFrame) -> str:
    """The rows of specular and transparent objects, or of all where there are no others."""
    lines = [scale_line(plan)]
    for target in plan.targets:
        mine = rows[rows["test"] == target.name]
        lines.append(f"{target.title}: {_data(mine)}")
        lines += [f"  {what}: {why}" for what, why in _absent(mine)]
        shown = mine[mine["kind"] != recipe_table.ABSENT]
        hard = shown[shown["subset"] == MAIN_SUBSETS[-1]]
        for row in (shown if hard.empty else hard).to_dict("records"):
            printed = row["kind"] == recipe_table.PUBLISHED
            numbers = "  ".join(
                f"{c.heading} {text}{c.unit and ' ' + c.unit}"
                for c in BOARD
                if c.name in ("rmse", "mae", "d105")
                and (text := c.text(row[c.name], published=printed))
            )
            lines.append(f"  {row['variant']} ({_figures(row)}, {row['subset']}): {numbers}")
    return "\n".join(lines)


def _absent(rows: pd.DataFrame) -> list[tuple[str, str]]:
    """What was not measured, and why."""
    absent = rows[rows["kind"] == recipe_table.ABSENT].to_dict("records")
    return [(row["variant"] or "Not measured", row["note"]) for row in absent]


def _tables(rows: pd.DataFrame) -> list[Table]:
    """The rows of one test, a table for each set of objects."""
    texts = [Column(heading=h, numeric=False) for h in ("variant", "figures", "training")]
    tables = []
    for subset in MAIN_SUBSETS:
        block = rows[(rows["subset"] == subset) & (rows["kind"] != recipe_table.ABSENT)]
        made = [_row(row) for row in block.to_dict("records")]
        columns = [*texts[:2], *BOARD, texts[2]]
        if made:
            title = OBJECTS[subset].capitalize()
            frames = block.loc[block["kind"] != recipe_table.PUBLISHED, "frames"].max()
            if not pd.isna(frames):
                title += f": {frames_of(str(block['test'].iloc[0]), int(frames))}"
            tables.append(Table(columns=columns, rows=made, title=title))
    return tables


def _row(row: dict[str, object]) -> Row:
    published = row["kind"] == recipe_table.PUBLISHED
    cells = [Cell(text=str(row["variant"])), Cell(text=_figures(row))]
    for column in BOARD:
        ends = (row["rmse_low"], row["rmse_high"]) if column.name == "rmse" else (nan, nan)
        interval = (nan, nan) if published else ends
        cells.append(column.cell(row[column.name], interval=interval, published=published))  # type: ignore[arg-type]
    return Row([*cells, Cell(text=_training(row))], "published" if published else "")


def _figures(row: dict[str, object]) -> str:
    if row["kind"] == recipe_table.PUBLISHED:
        return "published"
    frames, scenes = int(row["frames"]), int(row["scenes"])  # type: ignore[call-overload]
    return f"{row['protocol']}, {frames} frames of {scenes} scene{'s' * (scenes != 1)}"


def _training(row: dict[str, object]) -> str:
    if row["kind"] == recipe_table.PUBLISHED:
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
    origin, _, folder = str(rows["data"].iloc[0]).partition("from ")
    # A page is for others, too: a folder's place on one machine is in the CSV alone.
    return f"Frames: {f'from {Path(folder).name}' if folder and not origin else origin}"


def _shown(plan: recipe_plan.RecipePlan, results: Sequence[RunResult]) -> list[RunResult]:
    """Pictures by one protocol are enough."""
    return [r for r in results if r.manifest.setup.protocol == plan.recipe.protocols[-1]]
