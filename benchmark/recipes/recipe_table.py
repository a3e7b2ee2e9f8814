"""The table of a recipe: measured rows and published ones."""

import pandas as pd

from benchmark.evaluation.tasks.depth_results import OVER_ALL, summarise
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.published.load import published_table
from benchmark.recipes import recipe_plan, recipe_run, targets
from benchmark.recipes.recipe import Recipe
from benchmark.report.parts.depth_tables import MAIN_SUBSETS

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


def recipe_rows(plan: recipe_plan.RecipePlan, outcome: recipe_run.Outcome) -> pd.DataFrame:
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


def origin(plan: recipe_plan.RecipePlan, target: targets.Target) -> str:
    """Where a test's frames come from, for people."""
    if target.set:
        return plan.sets[target.set].origin
    return "not available" if target.root is None else f"from {target.root}"


def _measured(
    outcome: recipe_run.Outcome, entry: recipe_plan.Entry, target: targets.Target
) -> list[dict[str, object]]:
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
