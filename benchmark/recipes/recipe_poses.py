"""The table of a recipe's pose methods: measured rows and published ones."""

import pandas as pd

from benchmark.evaluation.tasks.pose_results import (
    ALL,
    HARD,
    PoseResult,
    heading,
    score_run,
)
from benchmark.metrics.pose import get_pose_protocol
from benchmark.published.load import published_rows
from benchmark.recipes.recipe_plan import RecipePlan
from benchmark.recipes.recipe_run import Outcome
from benchmark.recipes.targets import Target
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Cell, Column, Row, Table

MEASURED, PUBLISHED, ABSENT = "measured", "published", "not measured"
_SUBSETS = {ALL: "all", HARD: "specular_transparent"}
_SAMPLES = 1000


def pose_rows(plan: RecipePlan, outcome: Outcome) -> pd.DataFrame:
    """Rows of all tests in the order of the recipe: measured, published and what is missing.

    Figures are fractions, each with the ends of its 95 % interval over scenes.
    """
    printed = published_poses(plan.recipe.pose_table)
    rows: list[dict[str, object]] = []
    for target in plan.targets:
        mine = printed[printed["dataset"] == target.dataset] if len(printed) else printed
        for name, variant in plan.recipe.poses.items():
            common: dict[str, object] = {
                "recipe": plan.name,
                "scale": plan.scale_name,
                "test": target.name,
                "dataset": target.dataset,
                "variant": variant.title,
            }
            result = outcome.poses.get((name, target.name))
            if result is None:
                why = _why(plan, name, target, outcome)
                rows.append(common | {"kind": ABSENT, "note": why})
            else:
                rows += [common | row for row in _measured(plan, result)]
            if variant.published is not None and len(mine):
                same = mine[mine["method"] == variant.published.method]
                rows += [
                    common | {"kind": PUBLISHED, "protocol": "the paper's"} | row
                    for row in same.drop(columns=["dataset", "method"]).to_dict("records")
                ]
    found = pd.DataFrame(rows)
    missing = [name for name in ("subset", "note") if name not in found]
    return found.reindex(columns=[*found.columns, *missing])


def _measured(plan: RecipePlan, result: PoseResult) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for name in plan.recipe.pose_protocols:
        protocol = get_pose_protocol(name)
        for subset, key in _SUBSETS.items():
            scored = score_run(result, protocol, subset, samples=_SAMPLES)
            if not scored.objects and subset != ALL:
                continue
            row: dict[str, object] = {"kind": MEASURED, "protocol": name, "subset": key}
            row |= {"objects": scored.objects, "scenes": scored.scene_count}
            for column in protocol.columns:
                row[column] = float(scored.scores.mean[column])
                row[f"{column}_low"], row[f"{column}_high"] = scored.interval(column)
            rows.append(row)
    return rows


def _why(plan: RecipePlan, name: str, target: Target, outcome: Outcome) -> str:
    if plan.place(target) is None:
        return f"not available: {target.absent}"
    entry, title = plan.poses[name], plan.recipe.poses[name].title
    told = outcome.problems.get(f"{title} on {target.name}") or outcome.problems.get(title)
    return entry.problem or told or "not run yet"


def published_poses(table: str) -> pd.DataFrame:
    """The paper's figures of a table of poses, as fractions, a row for each method and subset.

    Raises:
        ToolkitError: no such table was published.
    """
    rows = published_rows()
    rows = rows[(rows["task"] == "category_pose") & (rows["table"] == table)]
    if table and rows.empty:
        raise ToolkitError("no such table of poses", field="pose_table", value=table)
    wide = [
        {"dataset": dataset, "subset": subset, "method": method}
        | {
            m.removesuffix("_pct"): float(v) / 100
            for m, v in zip(g["metric"], g["value"], strict=True)
        }
        for (dataset, subset, method), g in rows.groupby(
            ["dataset", "subset", "method"], sort=False
        )
    ]
    return pd.DataFrame(wide)


def pose_tables(plan: RecipePlan, rows: pd.DataFrame) -> list[Table]:
    """A table for each test and set of objects, in percent."""
    columns = get_pose_protocol(plan.recipe.pose_protocols[0]).columns
    heads = [Column(heading=h, numeric=False) for h in ("variant", "figures")]
    heads += [Column(heading=heading(c), unit="%") for c in columns]
    tables = []
    for target in plan.targets:
        mine = rows[rows["test"] == target.name]
        absent = mine[mine["kind"] == ABSENT]
        why = dict.fromkeys(absent["note"])
        if len(why) == 1 and set(absent["variant"]) == {
            v.title for v in plan.recipe.poses.values()
        }:
            notes = [f"Not measured: {note}" for note in why]  # the test's, hence said once
        else:
            notes = [f"{v}: {n}" for v, n in zip(absent["variant"], absent["note"], strict=True)]
        if len(absent) == len(mine):
            tables.append(Table(columns=heads, rows=[], title=_title(target, ""), notes=notes))
            continue
        for key in _SUBSETS.values():
            block = mine[mine["subset"] == key]
            made = [_row(row, columns) for row in block.to_dict("records")]
            if made:
                title = _title(target, key.replace("_", " and "))
                tables.append(Table(columns=heads, rows=made, title=title, notes=notes))
    return tables


def _title(target: Target, objects: str) -> str:
    return f"Poses, {target.title}" + (f", {objects} objects" if objects else "")


def _row(row: dict[str, object], columns: tuple[str, ...]) -> Row:
    published = row["kind"] == PUBLISHED
    figures = "published" if published else f"{row['protocol']}, {int(row['objects'])} objects"  # type: ignore[call-overload]
    cells = [Cell(text=str(row["variant"])), Cell(text=figures)]
    for column in columns:
        value = row.get(column)
        if value is None or pd.isna(value):
            cells.append(Cell(text="-"))
            continue
        low, high = row.get(f"{column}_low"), row.get(f"{column}_high")
        known = low is not None and not pd.isna(low)
        note = f"[{100 * low:.1f}, {100 * high:.1f}]" if known else ""  # type: ignore[operator]
        cells.append(Cell(text=f"{100 * value:.1f}", note=note))  # type: ignore[operator]
    return Row(cells, "published" if published else "")
