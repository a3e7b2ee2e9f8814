"""`std-train`: train networks, pack frames for that, run experiments, export weights."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from std_toolkit.cli.command import Command, Program, print_json
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

if TYPE_CHECKING:
    from benchmark.recipes.recipe import RecipeConfig
    from benchmark.recipes.recipe_run import Outcome
    from benchmark.training.options import (
        ExportOptions,
        GraspPackCommand,
        MineOptions,
        PackCommand,
        TrainCommand,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return PROGRAM.main(arguments)


def train(options: TrainCommand) -> int:
    """Train a network; returns the exit status."""
    _needs_torch()
    from benchmark.training.export import bench_command
    from benchmark.training.fit import fit, process_rank
    from benchmark.training.plan import plan_training

    if process_rank() > 0:  # the first of several processes reports for all
        logger.setLevel(logging.WARNING)
    config, data, beginning = plan_training(options)
    logger.info(
        "%d frames to train on, %d to validate; %d steps of %d frames",
        len(data.of_training),
        len(data.of_validation),
        config.steps,
        config.optimization.batch_size,
    )
    machine = replace(options.machine, progress=sys.stderr.isatty())
    if options.engine == "ray":
        from benchmark.training.ray_launch import fit_on_ray

        best = fit_on_ray(options.out, options, machine, options.ray_address)
    else:
        best = fit(options.out, config, data, machine, beginning)
    if process_rank() > 0:
        return 0
    settings = " ".join(f"{name}={value}" for name, value in config.settings.items())
    option = f" --set {settings}" if settings else ""
    command = bench_command(options.method)
    print(f"{best}: {command} --preset {options.preset} --weights {best}{option}")
    return 0


def pack(options: PackCommand) -> int:
    """Pack the frames of a split; returns the exit status."""
    from benchmark.training.pack import pack_split

    packed = pack_split(options.folder, options.split, options.data, options, options.jobs)
    print(f"{options.folder}: {packed.frames} frames")
    return _failures(packed.failed)


def pack_grasps(options: GraspPackCommand) -> int:
    """Make and pack scenes of labelled grasps; returns the exit status."""
    from benchmark.training.grasp.pack_grasps import pack_grasps

    packed = pack_grasps(options.folder, options.scenes, options, options.jobs)
    print(
        f"{options.folder}: {packed.scenes} scenes, {packed.frames} frames; "
        f"{100 * packed.graspable:.0f} % of the points seen have a grasp"
    )
    return _failures(packed.failed, "scene ")


def export(options: ExportOptions) -> int:
    """Write weights and their card; returns the exit status."""
    _needs_torch()
    from benchmark.report.page import make_parts
    from benchmark.training.export import export_weights

    tables = [
        text
        for part in (make_parts(options.results) if options.results else [])
        for name, text in part.files.items()
        if name.endswith(".md")
    ]
    print(export_weights(options.run, options.out, scores="\n\n".join(tables)))
    return 0


def recipe(options: RecipeConfig) -> int:
    """Run a recipe, or report what it would do; returns the exit status.

    Raises:
        ToolkitError: no such recipe or scale, data that are not there, or a step that fails.
    """
    from benchmark.recipes.recipe_show import plan_text, recipe_list, recipe_records

    if not options.recipe:
        print_json(recipe_records()) if options.json else print(recipe_list())
        return 0
    _needs_torch()
    import pandas as pd

    from benchmark.recipes.recipe_page import CSV, write_pages
    from benchmark.recipes.recipe_plan import plan_recipe
    from benchmark.recipes.recipe_run import run_recipe

    plan = plan_recipe(replace(options, devices=_devices(options.machine.accelerator)))
    if options.plan:
        print(plan_text(plan))
        return 0
    table = ""

    def show(outcome: Outcome) -> None:
        nonlocal table
        table = write_pages(plan, outcome)

    machine = replace(options.machine, progress=sys.stderr.isatty())
    outcome = run_recipe(plan, machine, options.jobs, after=show)
    if options.json:
        print_json(pd.read_csv(plan.folder / CSV).to_dict("records"))
    else:
        print(table)
    return _failures(outcome.problems)


def mine(options: MineOptions) -> int:
    """Fine-tune shipped weights on your own objects; returns the exit status."""
    _needs_torch()
    from benchmark.recipes.mine import fine_tune, report_lines

    machine = replace(options.machine, progress=sys.stderr.isatty())
    report = fine_tune(replace(options, machine=machine))
    print("\n".join(report_lines(report, options.method)))
    print(f"std-report {report.results}: tables by material, depth and scene")
    return _failures(report.problems)


def _devices(accelerator: str) -> tuple[str, ...]:
    """Torch devices to score on."""
    import torch

    if accelerator != "cpu" and torch.cuda.is_available():
        return tuple(f"cuda:{i}" for i in range(torch.cuda.device_count()))
    return ("cpu",)


def _failures(failed: Mapping[str, str], prefix: str = "") -> int:
    for key, error in failed.items():
        print(f"error: {prefix}{key}: {error}", file=sys.stderr)
    return 1 if failed else 0


def _needs_torch() -> None:
    from importlib.util import find_spec

    missing = [name for name in ("torch", "pytorch_lightning", "kornia") if not find_spec(name)]
    if missing:
        raise ToolkitError(
            f"training needs {', '.join(missing)}", hint="pip install 'std-toolkit[train]'"
        )


def _command(name: str, about: str, options: str, run: Callable[[Any], int]) -> Command:
    return Command(
        name=name, about=about, options=options, run=f"benchmark.cli.train:{run.__name__}"
    )


_OPTIONS = "benchmark.training.options"
PROGRAM = Program(
    name="std-train",
    about="Train networks on packed frames. Interrupted or killed, the same command resumes.",
    commands=(
        _command("pack", "pack the frames of a split", f"{_OPTIONS}:PackCommand", pack),
        _command(
            "pack-grasps",
            "make and pack scenes of labelled grasps",
            f"{_OPTIONS}:GraspPackCommand",
            pack_grasps,
        ),
        _command("train", "train a network on packed frames", f"{_OPTIONS}:TrainCommand", train),
        _command("export", "write trained weights and a card", f"{_OPTIONS}:ExportOptions", export),
        _command(
            "mine",
            "fine-tune the shipped weights on your own objects",
            f"{_OPTIONS}:MineOptions",
            mine,
        ),
        _command(
            "recipe",
            "run an experiment from its data to its table",
            "benchmark.recipes.recipe:RecipeConfig",
            recipe,
        ),
    ),
    default="train",
)

if __name__ == "__main__":
    sys.exit(main())
