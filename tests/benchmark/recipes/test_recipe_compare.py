"""Differences between the variants of a recipe, and one page of all recipes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmark.metrics.pose import PoseProtocol
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.recipes import recipe_compare, recipe_overview
from benchmark.recipes.recipe import RecipeConfig, load_recipe, recipe_names, scales
from benchmark.recipes.recipe_plan import RecipePlan, plan_recipe
from benchmark.recipes.recipe_run import COSTS, Outcome, spent
from benchmark.report.parts.pose_board import PoseDifference
from benchmark.training.config import CONFIG
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document, write_document

REPOSITORY = Path(__file__).resolve().parents[3]
SCENES, VIEWS = 8, 3


def plan_of(recipe: str, out: Path) -> RecipePlan:
    return plan_recipe(RecipeConfig(recipe=recipe, scale="tiny", out=out))


def scored(protocol: str, errors: np.ndarray, subset: str = "specular+transparent") -> object:
    """A run whose frames have these errors, (SCENES, VIEWS), in metres."""
    grid, _ = get_protocol(protocol).main
    scene, frame = np.indices(errors.shape)
    table = pd.DataFrame(
        {"scene": scene.ravel().astype(str), "frame": frame.ravel().astype(str),
         "grid": grid, "subset": subset, "n_pixels": 100, "rmse": errors.ravel()}
    )  # fmt: skip
    return SimpleNamespace(
        manifest=SimpleNamespace(setup=SimpleNamespace(protocol=protocol)), table=table
    )


def outcome_of(errors: dict[str, np.ndarray]) -> Outcome:
    """What each variant scored on the simulated test, by both protocols."""
    outcome = Outcome()
    for name, values in errors.items():
        found = [scored(protocol, values) for protocol in ("paper", "strict")]
        outcome.results[name, "dreds-catknown-test"] = found  # type: ignore[assignment]
    return outcome


def test_a_difference_is_held_against_the_paper(tmp_path: Path) -> None:
    """The paper: fusion lowers the RMSE on STD-CatKnown by far, confidence does not."""
    rng = np.random.default_rng(3)
    base = rng.uniform(0.02, 0.04, (SCENES, VIEWS))
    noise = rng.normal(0, 1e-4, (3, SCENES, VIEWS))
    worse, better = base + 0.003 + noise[0], base - 0.002 + noise[1]
    outcome = outcome_of({"swindrnet": base, "concatenated": worse, "no-confidence": better})
    rows = recipe_compare.comparisons(plan_of("module-ablation", tmp_path), outcome)
    assert tuple(rows.columns) == recipe_compare.COLUMNS
    assert len(rows) == 2 * 2  # pairs, protocols
    rows = rows.set_index(["protocol", "second"])
    first = rows.loc["paper", "SwinDRNet, concatenated, no fusion, no confidence"]
    assert first["first"] == "SwinDRNet"
    assert first["difference"] == pytest.approx((base - worse).mean(), rel=1e-9)
    assert first["low"] < first["difference"] < first["high"] < 0
    assert first["scenes"] == SCENES and first["frames"] == SCENES * VIEWS
    # Two pairs: the smallest p of 8 scenes is 2 / 2**8, twice that after Holm.
    assert first["p"] == pytest.approx(2 * 2 / 2**SCENES)
    # Nothing is printed on DREDS-CatKnown, hence the other data set of the table.
    assert first["published"] < 0 and first["published_on"] == "STD-CatKnown"
    assert first["reading"] == recipe_compare.AS_PUBLISHED
    other = rows.loc["paper", "SwinDRNet, fusion, no confidence"]
    assert other["low"] > 0
    # The paper's RMSE is 1 mm lower without confidence.
    assert other["published"] == pytest.approx(0.001)
    assert other["reading"] == recipe_compare.AS_PUBLISHED
    # The paper's figures are by its own protocol.
    assert rows.loc["strict", "published"].isna().all()
    assert (rows.loc["strict", "reading"] == "").all()


@pytest.mark.parametrize(
    ("low", "high", "p", "published", "reading"),
    [
        (1.0, 2.0, 0.05, 3.0, recipe_compare.AS_PUBLISHED),
        (1.0, 2.0, 0.01, -3.0, recipe_compare.OPPOSITE),
        (-2.0, -1.0, 0.01, 3.0, recipe_compare.OPPOSITE),
        (-1.0, 2.0, 0.01, 3.0, recipe_compare.UNDECIDED),
        (1.0, 2.0, 0.06, 3.0, recipe_compare.UNDECIDED),
        (0.0, 0.0, 0.01, 3.0, recipe_compare.UNDECIDED),
        (np.nan, np.nan, 1.0, 3.0, recipe_compare.UNDECIDED),
        (1.0, 2.0, np.nan, 3.0, recipe_compare.UNDECIDED),
        (1.0, 2.0, 0.01, 0.0, ""),
        (1.0, 2.0, 0.01, np.nan, ""),
    ],
)
def test_readings(low: float, high: float, p: float, published: float, reading: str) -> None:
    assert recipe_compare.read(low, high, p, published) == reading


def test_few_scenes_decide_nothing(tmp_path: Path) -> None:
    """An interval over three scenes does not hold zero, but three swaps may be chance."""
    base = np.linspace(0.02, 0.03, 3)[:, None]
    worse = base + np.array([[0.01], [0.02], [0.03]])
    outcome = outcome_of({"swindrnet": base, "concatenated": worse})
    row = recipe_compare.comparisons(plan_of("module-ablation", tmp_path), outcome).iloc[0]
    assert row["high"] < 0 and row["published"] < 0
    assert row["p"] == pytest.approx(2 / 2**3)
    assert row["reading"] == recipe_compare.UNDECIDED


def test_one_scene_has_a_difference_without_interval(tmp_path: Path) -> None:
    outcome = outcome_of(
        {"swindrnet": np.full((1, 3), 0.02), "concatenated": np.full((1, 3), 0.03)}
    )
    plan = plan_of("module-ablation", tmp_path)
    rows = recipe_compare.comparisons(plan, outcome)
    assert rows["difference"].tolist() == pytest.approx([-0.01, -0.01])
    assert rows[["low", "high"]].isna().all().all()
    assert rows["reading"].tolist() == [recipe_compare.UNDECIDED, ""]
    (table,) = recipe_compare.comparison_tables(rows, {"dreds-catknown-test": "DREDS"})
    assert table.title == "DREDS, specular and transparent objects: 3 frames of 1 scene"
    assert "\u221210.0 mm |" in table.markdown()


def test_poses_that_are_not_paired_are_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper's protocol counts other objects for a method that answers in other frames."""
    outcome = Outcome()
    plan = plan_of("pose-confidence", tmp_path)
    for name in plan.poses:
        outcome.poses[name, "dreds-catknown-test"] = SimpleNamespace(name=name)  # type: ignore[assignment]

    def score(result: SimpleNamespace, protocol: PoseProtocol, subset: str) -> SimpleNamespace:
        fewer = protocol.name == "paper" and result.name == "confidence"
        return SimpleNamespace(objects=3 if fewer else 5)

    found = PoseDifference(("5deg5cm",), *(np.array([0.2]),) * 4, scenes=8, frames=16)
    monkeypatch.setattr(recipe_compare, "score_run", score)
    monkeypatch.setattr(recipe_compare, "compare_runs", lambda *_, **__: found)
    rows = recipe_compare.comparisons(plan, outcome)
    assert rows["protocol"].tolist() == ["strict"]
    assert rows["subset"].tolist() == ["all"]  # the paper's table is of all objects alone


def test_nothing_scored_is_nothing_to_compare(tmp_path: Path) -> None:
    plan = plan_of("module-ablation", tmp_path)
    rows = recipe_compare.comparisons(plan, outcome_of({"swindrnet": np.ones((2, 2))}))
    assert rows.empty and tuple(rows.columns) == recipe_compare.COLUMNS
    assert recipe_compare.comparison_tables(rows, {"dreds-catknown-test": "DREDS"}) == []


def test_a_pair_of_no_names_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'title = "A"\ncompare = [["a", "b"]]\n[variants.a]\ntitle = "A"\nmethod = "dfnet"\n'
        '[tests.dreds-catknown-test]\nset = "test"\n'
    )
    with pytest.raises(ToolkitError, match="no two variants or poses of these names"):
        load_recipe(str(path))


def test_every_recipe_of_the_toolkit_compares_something(tmp_path: Path) -> None:
    for name in recipe_names():
        plan = plan_of(name, tmp_path)
        names = [e.name for e in plan.entries if plan.recipe.compare or e.folder is not None]
        of_poses = recipe_compare.pairs_of(plan, list(plan.poses)) if plan.poses else []
        assert bool(of_poses) == bool(plan.poses), name
        assert of_poses or recipe_compare.pairs_of(plan, names), name


def test_the_page_of_all_recipes(tmp_path: Path) -> None:
    """Readings and processor time come from the files of the recipes."""
    plan = plan_of("module-ablation", tmp_path)
    rng = np.random.default_rng(0)
    base = rng.uniform(0.02, 0.04, (SCENES, VIEWS))
    rows = recipe_compare.comparisons(
        plan, outcome_of({"swindrnet": base, "concatenated": base + 0.01})
    )
    out = tmp_path / "tiny"
    for name in ("module-ablation", "main-comparison", "mine"):
        (out / name).mkdir(parents=True)
        text = f"# Title of {name}\n\n**Scale: tiny (about)**\n\n## A\n\n{recipe_overview.NOTE}\n"
        (out / name / recipe_overview.MARKDOWN).write_text(text)
    rows.to_csv(out / "module-ablation" / recipe_overview.DIFFERENCES_CSV, index=False)
    with spent(out, "training a"):
        sum(range(200_000))
    with spent(out, "training a"), pytest.raises(ZeroDivisionError), spent(out, "set s"):
        1 / 0  # noqa: B018
    costs = read_document(out / COSTS, dict[str, float])
    assert set(costs) == {"training a", "set s"}
    assert costs["training a"] >= costs["set s"] >= 0
    write_document(out / COSTS, {"training a": 150.0, "set s": 0.0})
    (out / "data" / "t").mkdir(parents=True)
    (out / "training" / "a").mkdir(parents=True)
    write_document(out / "training" / "a" / CONFIG, {"precision": "bf16"})
    page = recipe_overview.all_tables(out, "tiny")
    assert page.startswith("# All recipes at scale `tiny`\n")
    assert scales()["tiny"].about in page
    assert "4 steps of 2 frames, --precision bf16.\n" in page
    assert "1 as published, 0 opposite to the paper, 0 undecided" in page
    assert "| module-ablation | dreds-catknown-test | SwinDRNet |" in page
    assert "| training `a` | 2.5 |" in page and "| all of these | 2.5 |" in page
    # A set without a time of its own.
    assert "| simulated set `s` | \u2013 |" in page and "| simulated set `t` | \u2013 |" in page
    # The toolkit's recipes in their order, then the user's.
    places = [
        page.index(f"## Title of {n}") for n in ("main-comparison", "module-ablation", "mine")
    ]
    assert places == sorted(places)
    assert page.count("**Scale: ") == 1 and page.count(recipe_overview.NOTE) == 1
