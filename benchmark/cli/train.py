"""`std-train`: train networks, pack frames for that, run experiments, export weights."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from benchmark.cli import commands, report_failures
from benchmark.training import check_installed
from std_toolkit.cli.command import Program, print_json

if TYPE_CHECKING:
    from benchmark.recipes.recipe import RecipeConfig
    from benchmark.training.options import (
        ExportOptions,
        GraspPackCommand,
        MineOptions,
        PackCommand,
        TrainCommand,
    )


def train(options: TrainCommand) -> None:
    """Train a network."""
    check_installed()
    from benchmark.training.ray_launch import run_training

    if (told := run_training(options)) is not None:
        print(told)


def pack(options: PackCommand) -> int:
    """Pack the frames of a split; returns the exit status."""
    from benchmark.training.pack import pack_split

    packed = pack_split(options.folder, options.split, options.data, options, options.jobs)
    print(f"{options.folder}: {packed.frames} frames")
    return report_failures(packed.failed)


def pack_grasps(options: GraspPackCommand) -> int:
    """Make and pack scenes of labelled grasps; returns the exit status."""
    from benchmark.training.grasp.pack_grasps import pack_grasps

    packed = pack_grasps(options.folder, options.scenes, options, options.jobs)
    print(
        f"{options.folder}: {packed.scenes} scenes, {packed.frames} frames; "
        f"{100 * packed.graspable:.0f} % of the points seen have a grasp"
    )
    return report_failures(packed.failed, "scene ")


def export(options: ExportOptions) -> None:
    """Write weights and their card."""
    check_installed()
    from benchmark.report.page import markdown_tables
    from benchmark.training.export import export_weights

    print(export_weights(options.run, options.out, scores=markdown_tables(options.results)))


def recipe(options: RecipeConfig) -> int:
    """Run a recipe, or report what it would do; returns the exit status.

    Raises:
        ToolkitError: no such recipe or scale, data that are not there, or a step that fails.
    """
    from benchmark.recipes.recipe_show import perform

    shown, problems = perform(options)
    print(shown) if isinstance(shown, str) else print_json(shown)
    return report_failures(problems)


def mine(options: MineOptions) -> int:
    """Fine-tune shipped weights on your own objects; returns the exit status."""
    check_installed()
    from benchmark.recipes.mine import fine_tune, report_lines

    report = fine_tune(replace(options, machine=options.machine.shown()))
    print("\n".join(report_lines(report, options.method)))
    print(f"std-report {report.results}: tables by material, depth and scene")
    return report_failures(report.problems)


PROGRAM = Program(
    name="std-train",
    about="Train networks on packed frames. Interrupted or killed, the same command resumes.",
    commands=commands(
        "benchmark.cli.train",
        "benchmark.training.options",
        ("pack", "pack the frames of a split", "PackCommand", "pack"),
        (
            "pack-grasps",
            "make and pack scenes of labelled grasps",
            "GraspPackCommand",
            "pack_grasps",
        ),
        ("train", "train a network on packed frames", "TrainCommand", "train"),
        ("export", "write trained weights and a card", "ExportOptions", "export"),
        ("mine", "fine-tune the shipped weights on your own objects", "MineOptions", "mine"),
        (
            "recipe",
            "run an experiment from its data to its table",
            "benchmark.recipes.recipe:RecipeConfig",
            "recipe",
        ),
    ),
    default="train",
)
main = PROGRAM.main

if __name__ == "__main__":
    sys.exit(main())
