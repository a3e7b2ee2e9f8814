"""The tables of a recipe, of depth and of poses: measured rows and published ones."""

import pandas as pd

from benchmark.evaluation.tasks.depth_results import OVER_ALL, summarise
from benchmark.evaluation.tasks.pose_results import ALL, HARD, PoseResult, heading, score_run
from benchmark.metrics.pose import get_pose_protocol
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.published.load import published_rows, published_table
from benchmark.recipes.recipe import Recipe
from benchmark.recipes.recipe_plan import Entry, RecipePlan
from benchmark.recipes.recipe_run import Outcome
from benchmark.recipes.targets import Target
from benchmark.report.parts.depth_tables import MAIN_SUBSETS
from std_toolkit.errors import ToolkitError
from std_toolkit.html.table import Cell, Column, Row, Table

MEASURED, PUBLISHED, ABSENT = "measured", "published", "not measured"
_INTERVAL = ("rmse_low", "rmse_high")
# kind: MEASURED, PUBLISHED or ABSENT, with the reason in `note`. data: where the frames of the test
# come from. Errors in metres, shares 0 to 1; interval: 95 %, over scenes.
COLUMNS = (
    "recipe", "scale", "test", "dataset", "data", "variant", "kind", "protocol", "subset",
    *OVER_ALL, *_INTERVAL, "frames", "scenes", "training_frames", "training_scenes", "steps",
    "batch_size", "training_data", "note",
)  # fmt: skip
_DRAWS = 1000
_PLACES = {subset: place for place, subset in enumerate(MAIN_SUBSETS)}
RANKED_BY = "rmse"


def recipe_rows(plan: RecipePlan, outcome: Outcome) -> pd.DataFrame:
    """All rows, test by test, in the order of the recipe; see `COLUMNS`.

    Nothing is left out: a test that is not available and a variant that did not run have a row that
    says so.

    Raises:
        ToolkitError: the recipe names a table that was not published.
    """
    printed = printed_rows(plan.recipe)
    rows: list[dict[str, object]] = []
    for target in plan.targets:
        mine = printed[printed["dataset"] == target.dataset]
        here: list[dict[str, object]] = []
        if plan.place(target) is None:
            here.append({"kind": ABSENT, "variant": "", "note": f"not available: {target.absent}"})
        shown: set[tuple[str, str]] = set()
        for entry in plan.entries:
            if plan.place(target) is not None:
                here += _measured(outcome, entry, target)
            if entry.published is not None:
                key = (entry.published.method, entry.published.training_data)
                shown.add(key)
                here += _published(mine, key, entry.title)
        for key in dict.fromkeys(mine[["method", "training_data"]].itertuples(index=False)):
            if tuple(key) not in shown:
                here += _published(mine, tuple(key), key[0], note="not a variant that was run")
        common = {
            "recipe": plan.name,
            "scale": plan.scale_name,
            "test": target.name,
            "dataset": target.dataset,
            "data": origin(plan, target),
        }
        here.sort(key=lambda row: _PLACES.get(str(row.get("subset")), -1))
        rows += [{**common, **row} for row in here]
    return pd.DataFrame(rows).reindex(columns=list(COLUMNS))


def printed_rows(recipe: Recipe) -> pd.DataFrame:
    """The table of the paper that a recipe is held against, maybe without rows.

    Raises:
        ToolkitError: no such table was published.
    """
    if not recipe.table:
        return pd.DataFrame(columns=["dataset", "subset", "method", "training_data", *OVER_ALL])
    return published_table(recipe.table)


def origin(plan: RecipePlan, target: Target) -> str:
    """Where a test's frames come from, for people."""
    if target.set:
        return plan.sets[target.set].origin
    return "not available" if target.root is None else f"from {target.root}"


def _measured(outcome: Outcome, entry: Entry, target: Target) -> list[dict[str, object]]:
    common: dict[str, object] = {"variant": entry.title}
    if entry.name in outcome.trained:
        trained = outcome.trained[entry.name]
        common |= {
            "training_frames": trained.frames,
            "training_scenes": trained.scenes,
            "steps": trained.steps,
            "batch_size": trained.batch_size,
        }
    results = outcome.results.get((entry.name, target.name), [])
    rows: list[dict[str, object]] = []
    for result in results:
        protocol = result.manifest.setup.protocol
        grid, _ = get_protocol(protocol).main
        table = result.table[result.table["grid"] == grid]
        means = summarise(table[table["subset"].isin(MAIN_SUBSETS)], samples=_DRAWS)
        for row in means[means["frames"] > 0].to_dict("records"):
            names = ("protocol", "subset", *OVER_ALL, *_INTERVAL, "frames", "scenes")
            rows.append({**common, "kind": MEASURED, **{name: row[name] for name in names}})
    if rows:
        return rows
    where = f"{entry.title} on {target.name}"
    why = entry.problem or outcome.problems.get(entry.title) or outcome.problems.get(where)
    ran = "no frame could be scored" if results else "not run yet"
    return [{**common, "kind": ABSENT, "note": why or ran}]


def _published(
    rows: pd.DataFrame, key: tuple[str, str], title: str, note: str = ""
) -> list[dict[str, object]]:
    method, training_data = key
    found = rows[(rows["method"] == method) & (rows["training_data"] == training_data)]
    return [
        {
            "variant": title,
            "kind": PUBLISHED,
            "protocol": "the paper's",
            "training_data": training_data,
            "note": note,
            **{
                name: row[name]
                for name in ("subset", *OVER_ALL)
                if name in row and not pd.isna(row[name])
            },
        }
        for row in found.to_dict("records")
    ]


SUBSET_OF = {ALL: "all", HARD: "specular_transparent"}


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
                rows += [common | row for row in _measured_poses(plan, result)]
            if variant.published is not None and len(mine):
                same = mine[mine["method"] == variant.published.method]
                rows += [
                    common | {"kind": PUBLISHED, "protocol": "the paper's"} | row
                    for row in same.drop(columns=["dataset", "method"]).to_dict("records")
                ]
    found = pd.DataFrame(rows)
    missing = [name for name in ("subset", "note") if name not in found]
    return found.reindex(columns=[*found.columns, *missing])


def _measured_poses(plan: RecipePlan, result: PoseResult) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for name in plan.recipe.pose_protocols:
        protocol = get_pose_protocol(name)
        for subset, key in SUBSET_OF.items():
            scored = score_run(result, protocol, subset, samples=_DRAWS)
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
        for key in SUBSET_OF.values():
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
