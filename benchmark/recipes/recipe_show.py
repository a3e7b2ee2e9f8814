"""Runs a recipe, or tells its steps and their expected cost before."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from benchmark.recipes import recipe, recipe_page, recipe_plan, recipe_run
from benchmark.training import check_installed
from benchmark.training.options import TrainCommand
from benchmark.training.run_files import LAST
from benchmark.training.shards import PACK
from std_toolkit.cli.command_options import words_of
from std_toolkit.plugins import names_of

if TYPE_CHECKING:
    from sensors.simulation.options import SimulationOptions

# Processor seconds of a frame of 640x360 at draft quality: docs/simulation.md.
_INFRARED_S, _COLOR_S, _DENOISING_S, _REST_S = 3.14, 1.56, 0.34, 0.74

_MEASURED_PIXELS = 640 * 360

_DRAFT_SAMPLES = 8

# A shape's convex parts, found once; so many shapes are drawn from on one side of the split.
_SHAPE_S, _SHAPES = 1.6, 8 * 250

# Colour as PNG of a picture larger than the labels.
_COLOR_BYTES = 2.0


def perform(options: recipe.RecipeConfig) -> tuple[str | object, Mapping[str, str]]:
    """Run a recipe, or tell what it would do, or list recipes.

    Returns:
        A text, or records for JSON; and error lines, by what they are of.

    Raises:
        ToolkitError: no such recipe or scale, data that are not there, or a step that fails.
    """
    if not options.recipe:
        return recipe_records() if options.json else recipe_list(), {}
    check_installed()
    devices = recipe_run.scoring_devices(options.machine)
    tables = [""]
    trusted = options.allow_code and not options.plan
    with nullcontext() if trusted else names_of(f"the recipe {options.recipe}"):
        plan = recipe_plan.plan_recipe(replace(options, devices=devices))
        if options.plan:
            return plan_text(plan), {e.title: e.problem for e in plan.entries if e.problem}
        outcome = recipe_run.run_recipe(
            plan, options.machine.shown(), options.jobs,
            after=lambda outcome: tables.append(recipe_page.write_pages(plan, outcome)),
        )  # fmt: skip
    if options.json:
        return pd.read_csv(plan.folder / recipe_page.CSV).to_dict("records"), outcome.problems
    return tables[-1], outcome.problems


def simulation_s(options: SimulationOptions, scenes: int) -> float:
    """Processor seconds that scenes take where no shape is known from before: by pixels and light
    paths from what was measured at draft quality."""
    from sensors.render.sim_renderer import quality_of

    quality = quality_of(options.quality)
    pixels = options.width * options.height / _MEASURED_PIXELS
    color_pixels = pixels * options.color_factor**2
    draft = quality_of("draft").infrared
    paths = quality.infrared.samples + quality.infrared.ambient_samples
    infrared = _INFRARED_S * paths / (draft.samples + draft.ambient_samples)
    color = _COLOR_S * quality.color.samples / _DRAFT_SAMPLES + _DENOISING_S
    frame = pixels * (infrared + _REST_S) + color_pixels * color
    shapes = min(scenes * (options.min_objects + options.max_objects) / 2, _SHAPES)
    return scenes * options.views * frame + shapes * _SHAPE_S


def simulation_bytes(options: SimulationOptions, frames: int) -> float:
    """Room on the disk that frames take."""
    from sensors.simulation.simulated_set import BYTES_PER_PIXEL

    larger = options.color_factor**2 - 1
    pixels = options.width * options.height
    return frames * pixels * (BYTES_PER_PIXEL["dreds"] + larger * _COLOR_BYTES)


def pack_bytes(size: tuple[int, int], frames: int) -> float:
    """Room that packed frames take: colour, two maps of depth, mask."""
    return frames * size[0] * size[1] * (3 + 4 + 4 + 1)


def as_size(number: float) -> str:
    """Bytes for people."""
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if number >= factor:
            return f"{number / factor:.1f} {unit}"
    return f"{number / 1e3:.0f} kB"


def as_time(seconds: float) -> str:
    """A duration for people."""
    if seconds >= 2 * 3600:
        return f"{seconds / 3600:.0f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"


def recipe_records() -> dict[str, dict[str, str]]:
    """A line on each recipe and each scale."""
    about = {name: recipe.load_recipe(name)[1].about for name in recipe.recipe_names()}
    sizes = {}
    for name, scale in recipe.scales().items():
        frames = scale.sets["train"].scenes * int(scale.sets["train"].options["views"])
        sizes[name] = f"{frames} training frames; {scale.about}"
    return {"recipes": {n: " ".join(text.split()) for n, text in about.items()}, "scales": sizes}


def recipe_list() -> str:
    """All recipes and scales with a line on each."""
    width = max(map(len, recipe.recipe_names()))
    lines = []
    for title, rows in recipe_records().items():
        lines += [f"{title}:", *(f"  {name:{width}}  {about}" for name, about in rows.items())]
    return "\n".join(lines)


def plan_text(plan: recipe_plan.RecipePlan) -> str:
    """All steps with their size, and which are finished."""
    lines = [f"{plan.recipe.title}. {recipe_page.scale_line(plan)}", "", "data"]
    lines += _sets(plan) or ["  nothing to simulate"]
    lines.append("packs")
    lines += _packs(plan) or ["  none"]
    lines.append("trainings")
    for entry in plan.entries:
        if entry.training is not None or entry.problem:
            lines += _training(entry)
    once = {entry.label: entry for entry in plan.poses.values()}
    for entry in once.values():
        lines += _training(entry)
    lines.append("tests")
    for target in plan.targets:
        place = plan.place(target)
        if place is None:
            lines.append(f"  {target.title}: not available: {target.absent}")
        elif target.set:
            lines.append(f"  {target.title}: {plan.sets[target.set].origin}")
        else:
            lines.append(f"  {target.title}: {place[1]}")
    usable = [entry for entry in plan.entries if not entry.problem]
    runs = sum(len(plan.runs(entry, target)) for entry in usable for target in plan.targets)
    limit = "" if plan.scale.limit is None else f", at most {plan.scale.limit} frames each"
    lines.append(f"scores\n  {runs} runs of a method on a test by a protocol{limit}")
    lines.append(f"page\n  {plan.folder}")
    return "\n".join(lines)


def _sets(plan: recipe_plan.RecipePlan) -> list[str]:
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


def _packs(plan: recipe_plan.RecipePlan) -> list[str]:
    lines = []
    for pack in plan.packs:
        size = as_size(pack_bytes(pack.size, pack.frames.frames))
        begun = "begun" if (pack.folder / PACK).is_file() else "to do"
        lines.append(f"  {pack.folder.name}: {size}; {begun}")
    return lines


def _training(entry: recipe_plan.Entry) -> list[str]:
    if entry.problem:
        return [f"  {entry.title}: {entry.problem}"]
    assert entry.training is not None
    assert entry.folder is not None
    training = entry.training
    long = "as published" if training.steps is None else f"{training.steps} steps"
    of = "" if training.batch_size is None else f" of {training.batch_size}"
    done = (entry.folder / LAST).is_file()
    return [
        f"  {entry.title}: {long}{of}; {'done' if done else 'to do'}",
        f"    {train_command(entry, entry.folder)}",
    ]


def train_command(entry: recipe_plan.Entry, folder: Path) -> str:
    """The same training by itself: on several devices, for instance."""
    assert entry.training is not None
    words = words_of(TrainCommand(**vars(entry.training), out=folder))
    return shlex.join(["std-train", *words])
