"""`std-train recipe`: an experiment from its data to its table.

`std-train pack-grasps`: make scenes of objects on a table with labelled grasps.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from benchmark.recipes.recipe_run import Outcome

PACK_GRASPS = "pack-grasps"


def build_recipe_parser() -> argparse.ArgumentParser:
    """The parser of recipes; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-train recipe",
        description="Run an experiment: simulate and pack frames, train every variant, score it, "
        "and write the table with the published rows beside. Without NAME: which recipes and "
        "scales there are. What is finished is left alone: run the same command again to go on.",
    )
    add = parser.add_argument
    add("name", nargs="?", metavar="NAME", help="of a recipe, or FILE.toml")
    add("--debug", action="store_true", help="show the traceback of an error")
    add("--scale", metavar="NAME", help="tiny (plumbing only), small (hours), paper (full size)")
    add("--out", type=Path, default=Path("recipe-runs"), metavar="DIR", help="(recipe-runs)")
    add("--plan", action="store_true", help="tell what would be done, and do nothing")
    add("--only", nargs="+", default=[], metavar="VARIANT", help="these variants")
    add("--seed", type=int, default=0, help="of weights, order and held-out scenes (0)")
    add("--steps", type=int, metavar="N", help="of every training, instead of the scale's")

    data = parser.add_argument_group("data that are there already")
    add = data.add_argument
    add(
        "--data",
        nargs="+",
        default=[],
        metavar="[TEST=]ROOT",
        help="STD, DREDS, ClearGrasp to test on: folders above them, or of one test",
    )
    add(
        "--train-data",
        nargs="+",
        default=[],
        metavar="[SET=]DIR",
        help="DREDS, or a set of std-sim, instead of simulating one to train on",
    )
    add("--test-data", nargs="+", default=[], metavar="[SET=]DIR", help="the same to test on")
    add("--validation-data", type=Path, metavar="DIR", help="chooses the best weights; else "
        "scenes of the training data are held out")  # fmt: skip

    where = parser.add_argument_group("where networks are trained and scored")
    add = where.add_argument
    add("--accelerator", choices=("auto", "cpu", "gpu"), default="auto")
    add("--precision", choices=("fp32", "bf16"), default="fp32", help="of training")
    add("--readers", type=int, default=2, metavar="N", help="processes that read packed frames")
    add_job_arguments(parser)
    return parser


def run(args: argparse.Namespace) -> int:
    """Run a recipe, or tell of it.

    Raises:
        ToolkitError: no such recipe or scale, data that are not there, or a step that fails.
    """
    from benchmark.recipes.recipe_show import plan_text, recipe_list

    if args.name is None:
        print(recipe_list())
        return 0
    if args.scale is None:
        from benchmark.recipes.recipe import scales

        raise ToolkitError("is needed", field="--scale", hint=f"one of {', '.join(scales())}")
    from benchmark.recipes.recipe_plan import RecipeConfig, plan_recipe

    wishes = RecipeConfig(
        recipe=args.name,
        scale=args.scale,
        out=args.out,
        train_data=args.train_data,
        test_data=args.test_data,
        validation_data=args.validation_data,
        data=args.data,
        only=args.only,
        seed=args.seed,
        steps=args.steps,
        devices=_devices(args.accelerator),
    )
    plan = plan_recipe(wishes)
    if args.plan:
        print(plan_text(plan))
        return 0
    from benchmark.recipes.recipe_page import write_pages
    from benchmark.recipes.recipe_run import run_recipe
    from benchmark.training.config import Machine

    machine = Machine(
        accelerator=args.accelerator, readers=args.readers, progress=sys.stderr.isatty()
    )
    table = ""

    def show(outcome: Outcome) -> None:
        nonlocal table
        table = write_pages(plan, outcome)

    outcome = run_recipe(plan, machine, job_options(args), precision=args.precision, after=show)
    print(table)
    for what, why in outcome.problems.items():
        print(f"error: {what}: {why}", file=sys.stderr)
    return 1 if outcome.problems else 0


def _devices(accelerator: str) -> tuple[str, ...]:
    """Torch devices to score on."""
    if accelerator == "cpu":
        return ("cpu",)
    import torch

    if torch.cuda.is_available():
        return tuple(f"cuda:{i}" for i in range(torch.cuda.device_count()))
    return ("cpu",)


def build_grasp_pack_parser() -> argparse.ArgumentParser:
    """The parser; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog=f"std-train {PACK_GRASPS}",
        description="Drop objects on a table, look at them, find all grasps of each on a grid, and "
        "pack that for `std-train --method graspnet`. Run the same command again to go on, with "
        "more --scenes to add some.",
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="DIR", help="where the packed scenes go")
    add("--debug", action="store_true", help="show the traceback of an error")
    add("--scenes", type=int, required=True, metavar="N")
    add("--frames", type=int, default=4, metavar="N", help="views of a scene (4)")
    add("--seed", type=int, default=0, help="of the first scene (0)")
    add("--depth", choices=("exact", "sensor"), default="exact", help="sensor: errs as a D415 does")
    add("--size", nargs=2, type=int, default=(640, 360), metavar=("W", "H"), help="(640 360)")
    add("--points", type=int, default=40_000, metavar="N", help="kept of a frame (40000)")
    add("--assets", default="procedural", help="source: procedural, shapenet, folder (procedural)")
    add("--assets-root", type=Path, metavar="DIR", help="folder of its files")
    add("--split", choices=("train", "test", "all"), default="train", help="of shapes (train)")
    add("--objects", nargs=2, type=int, default=(4, 8), metavar=("LEAST", "MOST"), help="(4 8)")
    add(
        "--sizes",
        nargs=2,
        type=float,
        default=(0.4, 0.9),
        metavar=("LEAST", "MOST"),
        help="of the usual sizes of a category (0.4 0.9)",
    )
    add("--gripper", default="panda", help="what must not hit anything: panda, graspnet (panda)")
    add("--spacing", type=float, default=0.008, metavar="M", help="between labelled points (0.008)")
    add_job_arguments(parser)
    return parser


def pack_grasps_command(args: argparse.Namespace) -> int:
    """Run it; returns the exit status."""
    from benchmark.training.grasp.pack_grasps import GraspPackOptions, pack_grasps
    from benchmark.training.grasp.tabletop import TableOptions

    options = GraspPackOptions(
        table=TableOptions(
            assets=args.assets,
            assets_root=args.assets_root,
            split=args.split,
            objects=tuple(args.objects),
            sizes=tuple(args.sizes),
        ),
        seed=args.seed,
        frames=args.frames,
        size=tuple(args.size),
        depth=args.depth,
        points=args.points,
        gripper=args.gripper,
        spacing=args.spacing,
    )
    packed = pack_grasps(args.folder, args.scenes, options, job_options(args))
    print(
        f"{args.folder}: {packed.scenes} scenes, {packed.frames} frames; "
        f"{100 * packed.graspable:.0f} % of the points seen have a grasp"
    )
    for key, error in packed.failed.items():
        print(f"error: scene {key}: {error}", file=sys.stderr)
    return 1 if packed.failed else 0
