"""Recipes and scales as files: all can be read, and say nothing that is not so."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from benchmark.cli.train import main
from benchmark.data.splits import get_split
from benchmark.methods.registry import pose_methods, restorers
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.published.load import published_rows, published_table
from benchmark.recipes import recipe as recipe_module
from benchmark.recipes.recipe import (
    FOLDER,
    Scale,
    get_scale,
    load_recipe,
    recipe_names,
    scales,
)
from benchmark.recipes.recipe_table import printed_rows, published_poses
from benchmark.recipes.targets import find_targets
from sensors.simulation.options import SimulationOptions
from std_toolkit.errors import ToolkitError
from std_toolkit.io.foreign_files import read_toml

REPOSITORY = Path(__file__).resolve().parents[3]
PLAIN = """
title = "Mine"
[variants.one]
title = "One"
method = "dfnet"
[tests.dreds-catknown-test]
set = "test"
"""


def test_every_experiment_of_depth_restoration_is_a_recipe() -> None:
    rows = published_rows()
    of_dreds = (rows["task"] == "depth_restoration") & (rows["source"] == "dreds")
    tables = set(rows.loc[of_dreds, "table"])
    named = {load_recipe(name)[1].table for name in recipe_names()}
    assert named - {""} == tables
    assert recipe_names()[0] == "main-comparison"


@pytest.mark.parametrize("name", recipe_names())
def test_a_recipe_covers_its_table(name: str) -> None:
    """All data sets of the table are tests; all printed rows are there, and are variants but for
    one that was trained on data that nobody has."""
    recipe = load_recipe(name)[1]
    table = printed_rows(recipe)
    assert set(table["dataset"]) <= {target.dataset for target in find_targets(recipe, [])}
    printed = set(table[["method", "training_data"]].itertuples(index=False, name=None))
    ours = {
        (v.published.method, v.published.training_data)
        for v in recipe.variants.values()
        if v.published
    }
    assert ours <= printed
    others = {method for method, _ in printed - ours}
    assert others == ({"LIDF (previous best)"} if name == "domain-transfer" else set())
    assert recipe.protocols[0] == "paper"
    for protocol in recipe.protocols:
        get_protocol(protocol)
    for test, told in recipe.tests.items():
        get_split(told.split or test)
    methods = [v.method for v in recipe.variants.values()] + recipe.baselines
    assert set(methods) <= set(restorers.names())
    assert {p.method for p in recipe.poses.values()} <= set(pose_methods.names())
    poses = published_poses(recipe.pose_table)
    if recipe.pose_table:
        ours = {p.published.method for p in recipe.poses.values() if p.published}
        assert ours == set(poses["method"]) and poses["iou50"].between(0, 1).all()


def test_every_table_of_poses_is_a_recipe() -> None:
    rows = published_rows()
    tables = set(rows.loc[rows["task"] == "category_pose", "table"])
    assert {load_recipe(name)[1].pose_table for name in recipe_names()} - {""} == tables


def test_the_folder_at_the_top_is_the_installed_one() -> None:
    assert (REPOSITORY / "recipes").resolve() == FOLDER.resolve()


def test_scales_grow() -> None:
    known = scales()
    assert list(known) == ["tiny", "small", "medium", "paper"]
    frames = []
    for scale in known.values():
        for size in scale.sets.values():
            msgspec.convert(dict(size.options), SimulationOptions)
        train, test = scale.sets["train"], scale.sets["test"]
        assert train.seed + train.scenes <= test.seed
        assert test.seed + test.scenes <= 100_000
        frames.append(train.scenes * train.options["views"])
    assert frames == sorted(frames)
    assert frames[-1] == 100_200
    assert "mean nothing" in known["tiny"].about
    assert known["paper"].of("swindrnet").steps is None


def test_what_a_method_does_not_say_is_that_of_the_scale() -> None:
    small = get_scale("small")
    assert small.of("swindrnet").batch_size == small.training.batch_size
    assert small.of("lidf").batch_size != small.training.batch_size
    assert small.of("swindrnet").learning_rate == 1e-3 and small.training.learning_rate is None
    assert small.of("nlspn").settings == {"input_size": "112,63", "steps": "6"}
    assert small.of("lidf").steps == small.training.steps


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('method = "dfnet"', "method = 3", r"variants\[\.\.\.\]\.method: Expected `str`"),
        ('method = "dfnet"', "", "missing required field `method`"),
        ('method = "dfnet"', 'method = "dfnet"\nspeed = 3', "unknown field `speed`"),
        ('method = "dfnet"', 'method = "dfnet"\nset = "tarin"', r"variants\.one\.set: no such set"),
        ('method = "dfnet"', 'method = "dfnet"\nshare = 1.5', r"variants\.one\.share: must lie"),
        ('set = "test"', 'set = "t"', r"dreds-catknown-test\.set: no such set"),
        ("[variants.one]", "[variants.One]", "lower-case"),
        ('title = "Mine"', 'title = "Mine"\ntests = 4', "no TOML"),
        ('title = "Mine"', 'title = "Mine"\nprotocols = []', "protocols: needs at least one"),
        ('title = "Mine"', 'title = "Mine"\n[sets.a]\nlike="b"\noptions={}', r"sets\.a\.like"),
        ('title = "Mine"', 'title = "Mine"\n[sets.test]\nlike="test"\noptions={}', "scale has"),
        (
            'title = "Mine"',
            'title = "Mine"\n[poses.a]\ntitle="A"\nmethod="nocs"\ndepth="two"',
            r"poses\.a\.depth: no such depth .*raw, gt, one",
        ),
        (
            'title = "Mine"',
            'title = "Mine"\nbaselines = [' + "'raw', " * 201 + "]",
            r"baselines: at most 200 \(got 201\)",
        ),
    ],
)
def test_a_wrong_recipe_is_told_in_one_line(old: str, new: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(PLAIN)
    assert load_recipe(str(path))[0] == "mine"
    path.write_text(PLAIN.replace(old, new))
    with pytest.raises(ToolkitError, match=told) as caught:
        load_recipe(str(path))
    assert str(path) in str(caught.value)


def test_what_there_is_not(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match=r"no such recipe \(got 'nope'\); one of main-comp"):
        load_recipe("nope")
    with pytest.raises(ToolkitError, match="cannot read the TOML file: No such file"):
        load_recipe(str(tmp_path / "nope.toml"))
    with pytest.raises(ToolkitError, match=r"--scale: no such scale \(got 'huge'\); one of tiny"):
        get_scale("huge")
    with pytest.raises(ToolkitError, match=r"table: no such table .*'main: none'"):
        published_table("main: none")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("views = -5", r"sets\.other\.options.views.*>= 1"),
        ("colour = 3", "unknown field `colour`"),
        ("views = 'many'", "Expected `int`"),
    ],
)
def test_a_set_that_no_variant_uses_is_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, told: str
) -> None:
    recipe = tmp_path / "mine.toml"
    recipe.write_text(f'{PLAIN}\n[sets.other]\nlike = "train"\n[sets.other.options]\n{line}\n')
    words = ["recipe", str(recipe), "--plan", "--scale", "tiny", "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert re.search(told, capsys.readouterr().err)


def test_a_plan_of_what_cannot_run_ends_with_status_1(tmp_path: Path, capsys) -> None:
    recipe = tmp_path / "mine.toml"
    words = ["recipe", str(recipe), "--plan", "--scale", "tiny", "--out", str(tmp_path / "out")]
    recipe.write_text(PLAIN)
    assert main(words) == 0
    recipe.write_text(PLAIN.replace('method = "', 'method = "no-'))
    assert main(words) == 1
    assert "cannot be trained here" in capsys.readouterr().err


def test_a_scale_without_a_set_is_refused(tmp_path: Path) -> None:
    text = Path(recipe_module.__file__).with_name("scales.toml").read_text()
    path = tmp_path / "scales.toml"
    path.write_text(text.replace("[tiny.sets.test]", "[tiny.sets.tset]"))
    with pytest.raises(ToolkitError, match="must be train and test"):
        read_toml(path, dict[str, Scale])


def test_the_guide_names_all_recipes_and_its_own_one_works(tmp_path: Path) -> None:
    text = (REPOSITORY / "docs" / "recipes.md").read_text()
    assert all(f"| `{name}` |" in text for name in recipe_names())
    path = tmp_path / "own.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0])
    recipe = load_recipe(str(path))[1]
    assert recipe.variants["opaque"].set == "train-opaque"
    msgspec.convert(recipe.sets["train-opaque"].options, SimulationOptions)


@pytest.mark.parametrize("more", [[], ["--allow-code"]])
@pytest.mark.parametrize(
    "line",
    [
        'baselines = ["{}:X"]',
        'protocols = ["{}:X"]',
        '[variants.two]\ntitle = "T"\nmethod = "{}:X"',
        '[sets.other]\nlike = "train"\noptions = {{ assets = "{}:X" }}',
    ],
)
def test_a_recipe_runs_no_code_that_it_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], line: str
) -> None:
    helper = tmp_path / "helper.py"
    helper.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nclass X: pass\n")
    recipe = tmp_path / "mine.toml"
    text = PLAIN + "\n" + line.format(helper)
    if line.startswith(("baselines", "protocols")):
        text = line.format(helper) + PLAIN
    recipe.write_text(text)
    words = ["recipe", str(recipe), "--plan", "--scale", "tiny", "--out", str(tmp_path / "out")]
    main([*words, *more])
    told = "".join(capsys.readouterr())
    assert not (tmp_path / "ran").exists()
    assert "names code, which is not loaded" in told
