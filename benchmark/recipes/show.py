"""What a recipe is going to do, as text."""

from __future__ import annotations

import shlex
from pathlib import Path

from benchmark.recipes.estimate import (
    as_size,
    as_time,
    pack_bytes,
    simulation_bytes,
    simulation_s,
)
from benchmark.recipes.page import scale_line
from benchmark.recipes.plan import Entry, RecipePlan
from benchmark.recipes.recipe import load_recipe, recipe_names
from benchmark.recipes.scale import scales
from benchmark.training.run_files import LAST
from benchmark.training.shards import PACK


def recipe_list() -> str:
    """All recipes and scales with a line on each."""
    names = recipe_names()
    width = max(map(len, names))
    lines = ["recipes:"]
    for name in names:
        _, recipe = load_recipe(name)
        about = " ".join(recipe.about.split())
        lines.append(f"  {name:{width}}  {about}")
    lines.append("scales:")
    for name, scale in scales().items():
        frames = scale.sets["train"].scenes * int(scale.sets["train"].options["views"])
        lines.append(f"  {name:{width}}  {frames} training frames; {scale.about}")
    return "\n".join(lines)


def plan_text(plan: RecipePlan) -> str:
    """All steps with their size, and which are finished."""
    lines = [f"{plan.recipe.title}. {scale_line(plan)}", "", "data"]
    lines += _sets(plan) or ["  nothing to simulate"]
    lines.append("packs")
    lines += _packs(plan) or ["  none"]
    lines.append("trainings")
    for entry in plan.entries:
        if entry.wishes is not None or entry.problem:
            lines += _training(entry)
    lines.append("tests")
    for target in plan.targets:
        place = plan.place(target)
        if place is None:
            lines.append(f"  {target.title}: not at hand: {target.absent}")
        elif target.set:
            lines.append(f"  {target.title}: {plan.sets[target.set].origin}")
        else:
            lines.append(f"  {target.title}: {place[1]}")
    runs = sum(len(plan.runs(entry)) for entry in plan.entries if not entry.problem)
    limit = "" if plan.scale.limit is None else f", at most {plan.scale.limit} frames each"
    lines.append(f"scores\n  {runs} runs of a method on a test by a protocol{limit}")
    lines.append(f"page\n  {plan.folder}")
    return "\n".join(lines)


def _sets(plan: RecipePlan) -> list[str]:
    lines = []
    for frames in plan.sets.values():
        if frames.options is None:
            lines.append(f"  {frames.name}: {frames.frames} frames in {frames.root}")
            continue
        left = len(frames.missing())
        o = frames.options
        cost = ""
        if left:
            cost = (
                f"; {left} to do: about {as_time(simulation_s(o, left))} of one core and "
                f"{as_size(simulation_bytes(o, left * o.views))}"
            )
        lines.append(f"  {frames.name}: {frames.size}, {o.width}x{o.height}{cost or '; done'}")
    return lines


def _packs(plan: RecipePlan) -> list[str]:
    lines = []
    for pack in plan.packs:
        size = as_size(pack_bytes(pack.size, pack.frames.frames))
        begun = "begun" if (pack.folder / PACK).is_file() else "to do"
        lines.append(f"  {pack.folder.name}: {size}; {begun}")
    return lines


def _training(entry: Entry) -> list[str]:
    if entry.problem:
        return [f"  {entry.title}: {entry.problem}"]
    assert entry.wishes is not None
    assert entry.folder is not None
    wishes = entry.wishes
    long = "as published" if wishes.steps is None else f"{wishes.steps} steps"
    of = "" if wishes.batch_size is None else f" of {wishes.batch_size}"
    done = (entry.folder / LAST).is_file()
    return [
        f"  {entry.title}: {long}{of}; {'done' if done else 'to do'}",
        f"    {train_command(entry, entry.folder)}",
    ]


def train_command(entry: Entry, folder: Path) -> str:
    """The same training by itself: on several devices, for instance."""
    wishes = entry.wishes
    assert wishes is not None
    words = ["std-train", "--method", wishes.method, "--preset", wishes.preset]
    if wishes.settings:
        words += ["--set", *(f"{name}={value}" for name, value in wishes.settings.items())]
    words += ["--data", *map(str, wishes.data)]
    if wishes.validation:
        words += ["--validation", *map(str, wishes.validation)]
    words += ["--hold-out", f"{wishes.hold_out:g}"]
    words += ["--share", f"{wishes.share:g}"] if wishes.share != 1 else []
    words += ["--steps", str(wishes.steps)] if wishes.steps is not None else []
    words += ["--batch-size", str(wishes.batch_size)] if wishes.batch_size is not None else []
    if wishes.learning_rate is not None:
        words += ["--learning-rate", f"{wishes.learning_rate:g}"]
    words += ["--geometry", wishes.geometry] if wishes.geometry != "published" else []
    words += ["--seed", str(wishes.seed)] if wishes.seed else []
    return shlex.join([*words, "--out", str(folder)])
