"""From a recipe, a scale and data to steps: what is made, what is taken, what is told."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from recipe_data import mark_as_simulated, write_set, write_std

from benchmark.cli.train import main
from benchmark.recipes.recipe import RecipeConfig, recipe_names
from benchmark.recipes.recipe_plan import RecipePlan, plan_recipe
from benchmark.recipes.recipe_show import plan_text, recipe_list, simulation_s, train_command
from benchmark.training.options import TrainCommand
from sensors.simulation.options import SimulationOptions
from std_toolkit.cli.command_options import parse_options
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions


def planned(tmp_path: Path, recipe: str, scale: str = "tiny", **told: Any) -> RecipePlan:
    return plan_recipe(RecipeConfig(recipe=recipe, scale=scale, out=tmp_path / "out", **told))


@pytest.fixture
def own(tmp_path: Path) -> dict[str, Path]:
    """A set to train on, one to test on, and STD."""
    return {
        "train": write_set(tmp_path / "own_train", "train", 3),
        "test": write_set(tmp_path / "own_test", "test", 1, 60000),
        "std": write_std(tmp_path / "std"),
    }


def test_variants_share_what_they_can(tmp_path):
    """Sim-to-real: one set, rendered once, packed twice; equal trainings of recipes are one."""
    plan = planned(tmp_path, "sim-to-real")
    assert list(plan.sets) == ["train", "test"]
    assert [(p.raw, p.frames.name) for p in plan.packs] == [("cut", "train"), ("sensor", "train")]
    labels = {}
    for name in recipe_names():
        for entry in planned(tmp_path, name).entries:
            if entry.folder is not None:
                labels.setdefault(entry.label, set()).add((entry.folder, str(entry.training)))
    assert all(len(same) == 1 for same in labels.values())
    assert "swindrnet.train" in labels
    # Three methods, cut, two ablations, fixed materials, half, and five factors.
    assert len(labels) == 13


def test_half_the_data_are_the_same_pack(tmp_path):
    plan = planned(tmp_path, "data-scale")
    assert len(plan.packs) == 1
    shares = [entry.training.share for entry in plan.entries if entry.training]
    assert shares == [0.5, 1.0]


def test_a_derived_set_differs_in_what_it_says_alone(tmp_path):
    plan = planned(tmp_path, "material-randomization")
    one, other = plan.sets["train"], plan.sets["train-fixed"]
    assert one.seeds == other.seeds
    differing = {
        name
        for name in SimulationOptions.__struct_fields__
        if getattr(one.options, name) != getattr(other.options, name)
    }
    assert differing == {"materials"}
    sensors = planned(tmp_path, "cross-sensor").sets
    assert sensors["test"].options.sensor == "d415"
    assert sensors["test-d435"].options.sensor == "d435"
    assert sensors["test-d435"].part == "test"


def test_own_data_are_taken_and_derived_sets_follow_them(tmp_path, own):
    plan = planned(
        tmp_path,
        "sim-to-real",
        train_data=[str(own["train"])],
        test_data=[f"test={own['test']}"],
        data=[str(own["std"])],
    )
    assert all(s.options is None for s in plan.sets.values())
    assert {s.root for s in plan.sets.values()} == {own["train"], own["test"]}
    assert "to do" not in plan_text(plan).split("packs")[0]
    titles = {t.name: t.title for t in plan.targets}
    assert titles["dreds-catknown-test"] == "DREDS-CatKnown"  # of a set without std-sim's record
    std = next(t for t in plan.targets if t.name == "std-catknown")
    assert plan.place(std)[:2] == ("std-catknown", own["std"])
    with pytest.raises(ToolkitError, match=r"scenes of train, which was not made by std-sim"):
        planned(tmp_path, "material-randomization", train_data=[str(own["train"])])
    mark_as_simulated(own["train"])
    fixed = planned(tmp_path, "material-randomization", train_data=[str(own["train"])])
    alike = fixed.sets["train-fixed"]
    assert alike.seeds == (0, 1, 2)
    assert (alike.options.materials, alike.options.width) == ("fixed", 64)
    assert alike.name != "train-fixed"  # it is no other user's set


def test_a_test_not_at_hand_is_told_with_where_to_get_it(tmp_path, own):
    plan = planned(tmp_path, "main-comparison", data=[str(own["std"])])
    text = plan_text(plan)
    assert "STD-CatNovel: not available" in text
    assert "https://pku-epic.github.io/DREDS/" in text
    assert "--scenes-from graspnet" in text
    assert "--data std-catnovel=ROOT" in text
    assert "STD-CatKnown: not available" not in text
    assert "DREDS-CatKnown, simulated anew: simulated by std-sim" in text
    assert [t.name for t in plan.targets if plan.place(t) is None] == [
        "dreds-catnovel",
        "std-catnovel",
    ]
    scenes = planned(tmp_path, "cross-sensor")
    absent = [t for t in scenes.targets if t.absent]
    assert len(absent) == 4
    assert all("--data std-scene" in t.absent for t in absent)


def test_public_data_come_before_simulated_ones(tmp_path):
    public = write_set(tmp_path / "public", "test", 2)
    plan = planned(tmp_path, "main-comparison", data=[str(public)])
    target = plan.targets[0]
    assert target.root == public
    assert list(plan.sets) == ["train"]
    # Only a set that is named may stand for another test.
    sim = write_set(tmp_path / "graspnet", "test", 1)
    plan = planned(tmp_path, "main-comparison", data=[f"dreds-catnovel={sim}"])
    novel = plan.targets[1]
    assert plan.place(novel)[:2] == ("dreds-catknown-test", sim)


def test_some_variants_only(tmp_path):
    plan = planned(tmp_path, "main-comparison", only=["swindrnet"])
    assert [entry.name for entry in plan.entries] == ["raw", "nearest", "swindrnet"]
    fixed = planned(tmp_path, "material-randomization", only=["randomized"])
    assert "train-fixed" not in fixed.sets


def test_other_seeds_and_steps_are_other_trainings(tmp_path):
    plain = planned(tmp_path, "domain-transfer")
    other = planned(tmp_path, "domain-transfer", seed=3, steps=7)
    assert other.entries[-1].label == "swindrnet.train.seed-3.steps-7"
    assert (other.entries[-1].training.seed, other.entries[-1].training.steps) == (3, 7)
    assert plain.folder != other.folder
    assert plain.packs == other.packs


def test_validation_of_ones_own(tmp_path, own):
    judged = write_set(tmp_path / "judged", "val", 1)
    plan = planned(tmp_path, "sim-to-real", validation_data=judged)
    cut = plan.entries[1]
    assert [p.raw for p in cut.packs] == ["cut", "cut"]
    assert cut.training.validation == (cut.packs[1].folder,)
    assert "judged-by" in cut.label


def test_what_cannot_be_trained_is_a_problem_of_its_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'title = "M"\n[variants.a]\ntitle = "A"\nmethod = "dfnet"\n[variants.b]\ntitle = "B"\n'
        'method = "nothing"\n[variants.c]\ntitle = "C"\nmethod = "dfnet"\n'
        'settings = { speed = "3" }\n[tests.dreds-catknown-test]\nset = "test"\n'
    )
    plan = planned(tmp_path, str(path))
    assert not plan.entries[1].problem
    assert "no plug-in with this name" in plan.entries[2].problem
    assert "speed: the method has no such setting" in plan.entries[3].problem
    assert "cannot be trained here" in plan_text(plan)
    assert len(plan.packs) == 1


@pytest.mark.slow
def test_the_command_of_a_training_means_that_training(tmp_path):
    for name, scale in (("module-ablation", "tiny"), ("data-scale", "small")):
        for entry in planned(tmp_path, name, seed=2, scale=scale).entries:
            if entry.training is None:
                continue
            words = shlex.split(train_command(entry, entry.folder))
            options, _ = parse_options(TrainCommand, words[1:], "std-train")
            assert options == TrainCommand(**vars(entry.training), out=entry.folder)
            assert options.seed == 2


def test_costs_follow_pixels_and_light_paths():
    plain = SimulationOptions()
    hundred = simulation_s(plain, 100) - simulation_s(plain, 100) % 1
    # docs/simulation.md: 5.78 s a frame, and the shapes once.
    assert hundred == pytest.approx(100 * 30 * 5.78 + 1.6 * 800, rel=0.01)
    small = SimulationOptions(width=320, height=180)
    assert simulation_s(small, 100) - 1.6 * 800 == pytest.approx((hundred - 1280) / 4, rel=0.01)
    assert simulation_s(SimulationOptions(quality="better"), 100) > 2 * hundred


@pytest.mark.parametrize(
    ("told", "match"),
    [
        ({"only": ["nope"]}, r"--only: the recipe has no such variant \(got 'nope'\)"),
        ({"steps": 0}, "steps: must be at least 1"),
        ({"data": ["/nowhere"]}, "/nowhere: no such folder"),
        ({"data": ["nope=."]}, r"--data: the recipe has no such test \(got 'nope'\)"),
        ({"train_data": ["/nowhere"]}, "/nowhere: no such folder"),
        ({"train_data": ["nope=."]}, "the recipe has no such set"),
        ({"validation_data": Path("/nowhere")}, "no frames of a simulated set here"),
    ],
)
def test_wrong_wishes(told, match, tmp_path):
    with pytest.raises(ToolkitError, match=match):
        planned(tmp_path, "sim-to-real", **told)


def test_folders_that_hold_something_else(tmp_path, own, capsys):
    with pytest.raises(ToolkitError, match="no frames of a simulated set here"):
        planned(tmp_path, "sim-to-real", train_data=[str(own["std"])])
    with pytest.raises(ToolkitError, match=r"holds none of the recipe's tests"):
        planned(tmp_path, "domain-transfer", data=[str(own["std"])])
    assert main(
        ["recipe", "main-comparison", "--plan", "--scale", "tiny", "--out", str(tmp_path),
         "--data", str(own["std"]), str(own["train"])]
    ) == 0  # fmt: skip
    assert (
        f"{own['train']}: passed over, holds none of the recipe's tests" in capsys.readouterr().err
    )
    with pytest.raises(ToolkitError, match="std-catnovel is expected as"):
        planned(tmp_path, "sim-to-real", data=[f"std-catnovel={own['train']}"])
    with pytest.raises(ToolkitError, match="two folders for one set"):
        planned(tmp_path, "sim-to-real", train_data=[str(own["train"])] * 2)
    with pytest.raises(ToolkitError, match="no use for this set"):
        planned(tmp_path, "domain-transfer", test_data=[str(own["test"])])


def test_the_command_line(tmp_path, capsys):
    assert main(["recipe"]) == 0
    told = capsys.readouterr().out
    assert told == recipe_list() + "\n"
    assert all(name in told for name in (*recipe_names(), "tiny", "small", "medium", "paper"))
    assert main(["recipe", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["recipes"]) == recipe_names()
    plan = ["recipe", "cross-sensor", "--scale", "paper", "--plan", "--out", str(tmp_path)]
    assert main(plan) == 0
    told = capsys.readouterr().out
    assert "3340 scenes of 30 views, 640x360; 3340 to do" in told
    assert "as published" in told
    assert "Scale: paper" in told
    assert not list(tmp_path.iterdir())
    for wrong in (["nope", "--scale", "tiny"], ["sim-to-real"], ["sim-to-real", "--scale", "x"]):
        assert main(["recipe", *wrong]) == 1
        error = capsys.readouterr().err
        assert error.startswith("error: ")
        assert error.count("\n") == 1


def test_scenes_of_other_seeds_are_refused(tmp_path: Path) -> None:
    """A set that was simulated at another size would be trained on as a whole."""
    plan = planned(tmp_path, "data-scale")
    train = plan.sets["train"]
    train.check_scenes()  # nothing is there yet
    write_set(train.root, "train", 3)
    train.check_scenes()
    write_set(train.root, "train", 2, first=3)
    with pytest.raises(ToolkitError, match="scenes that are not of the set") as error:
        train.simulate(JobOptions(engine="serial"))
    assert error.value.value == "00003, 00004"
