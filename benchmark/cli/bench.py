"""`std-bench`: score depth restorers and pose methods on STD, DREDS, ClearGrasp and one's own."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmark.cli.bench_tasks import (
    OWN,
    add_grasp_arguments,
    add_pose_arguments,
    list_planners,
    list_pose_methods,
    score,
    score_bop_results,
    score_grasps,
    score_poses,
)
from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.errors import ToolkitError
from std_toolkit.log import log_to_stderr

PRIORS = "priors"
PRECISIONS = ("fp32", "bf16", "fp16")


def build_parser() -> argparse.ArgumentParser:
    """The parser; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-bench",
        description="Score methods that restore depth, and what rests on depth. What is scored "
        "already is kept: run the same command again to go on. `std-report` makes tables and pages "
        "of the results. `std-bench priors --help` tells how to make shape priors of meshes.",
    )
    add = parser.add_argument
    add("--version", action="version", version=f"std-toolkit {__version__}")
    add("--debug", action="store_true", help="show the traceback of an error")

    what = parser.add_argument_group("what is scored")
    add = what.add_argument
    add("--task", choices=tuple(TASKS), default="depth", help="what is scored (depth)")
    add("--method", nargs="+", metavar="NAME", help="see --list-methods, or package.module:Class")
    add(
        "--data",
        nargs="+",
        metavar="[SPLIT=]ROOT",
        help="folder of the data sets, or of one split",
    )
    add("--split", nargs="+", metavar="NAME", help="see --list-splits")
    add("--out", type=Path, metavar="DIR", help="results")
    add("--protocol", nargs="+", default=["strict"], metavar="NAME", help="strict, paper, ...")
    add("--limit", type=int, metavar="N", help="so many frames, evenly spread over the split")
    add(
        "--depth",
        nargs="+",
        default=["raw"],
        metavar="NAME",
        help="what poses rest on: raw, gt, restorers, or NAME=DIR of saved depth",
    )
    add("--depth-from", type=Path, metavar="DIR", help="depth saved earlier, for the sensor's")

    how = parser.add_argument_group("how the methods work")
    add = how.add_argument
    add(
        "--preset",
        help="size of networks: published or compact (published, but where no --weights are given "
        "and the toolkit brings compact ones, those)",
    )
    add(
        "--weights",
        nargs="+",
        default=[],
        metavar="[METHOD=]FILE",
        help="trained weights: safetensors, or a checkpoint that holds tensors alone",
    )
    add(
        "--set",
        nargs="+",
        default=[],
        metavar="[METHOD.]NAME=VALUE",
        dest="settings",
        help="a method's own settings",
    )
    add("--label", help="what the method is called in tables (its name)")
    add("--device", nargs="+", default=["cpu"], metavar="NAME", help="cpu, cuda:0 cuda:1, ...")
    add("--precision", choices=PRECISIONS, default="fp32", help="of networks")
    add("--compile", action="store_true", help="networks through torch.compile")
    add("--batch-size", type=int, default=8, metavar="N")
    add("--save-depth", action="store_true", help="keep the restored depth beside the results")
    add("--no-speed", action="store_true", help="do not measure how fast the methods are")
    add("--no-gallery", action="store_true", help="keep no pictures of a few frames")
    add_job_arguments(parser)
    parser.add_argument(
        "--gpus-per-task", type=float, default=0.0, metavar="X", help="with --engine ray"
    )

    add_pose_arguments(parser)
    add_grasp_arguments(parser)

    instead = parser.add_argument_group("instead of scoring")
    add = instead.add_argument
    add("--list-methods", action="store_true", help="what methods there are")
    add("--list-splits", action="store_true", help="what splits there are")
    add("--check-data", type=Path, metavar="ROOT", help="what is there of --split, what is missing")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    log_to_stderr(logging.INFO)
    if words[:1] == [PRIORS]:
        from benchmark.cli.priors import main as make_priors

        return make_priors(words[1:])
    args = build_parser().parse_args(words)
    return exit_status(lambda: _run(args), program="std-bench", debug=args.debug)


def _run(args: argparse.Namespace) -> int:
    _check_task(args)
    if args.list_methods:
        return _list_methods(args.task)
    if args.list_splits:
        return _list_splits()
    if args.check_data is not None:
        return _check_data(args)
    task = TASKS[args.task]
    for name in task.needed:
        if not getattr(args, name):
            raise ToolkitError(
                "is needed", field=f"--{name}", hint="`std-bench --help` tells all options"
            )
    return task.score(args)


def _check_task(args: argparse.Namespace) -> None:
    """Refuse options of other tasks, which would do nothing without a word."""
    parser = build_parser()
    for task in TASKS.values():
        for name in set(task.own) - set(TASKS[args.task].own):
            if getattr(args, name) != parser.get_default(name):
                raise ToolkitError(
                    f"is no option of --task {args.task}", field=f"--{name.replace('_', '-')}"
                )


def _score_depth(args: argparse.Namespace) -> int:
    from benchmark.evaluation.config import DepthConfig

    config = DepthConfig(
        methods=tuple(args.method),
        splits=tuple(args.split),
        protocols=tuple(args.protocol),
        data=tuple(args.data),
        out=args.out,
        preset=args.preset,
        precision=args.precision,
        compile=args.compile,
        weights=tuple(args.weights),
        settings=tuple(args.settings),
        label=args.label,
        devices=tuple(args.device),
        batch_size=args.batch_size,
        limit=args.limit,
        save_depth=args.save_depth,
        depth_from=args.depth_from,
        speed=not args.no_speed,
        gallery=not args.no_gallery,
    )
    return score("depth", config, replace(job_options(args), gpus=args.gpus_per_task))


def _list_methods(task: str) -> int:
    if task == "pose":
        return list_pose_methods()
    if task == "grasp":
        return list_planners()
    import inspect

    from benchmark.methods.registry import restorers

    for name in restorers.names():
        try:
            about = (inspect.getdoc(restorers.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            about = f"not usable here: {error.problem}"
        print(f"{name:16} {about}")
    return 0


def _list_splits() -> int:
    from benchmark.data.splits import get_split, splits

    for name in splits.names():
        print(f"{name:24} {get_split(name).about}")
    return 0


def _check_data(args: argparse.Namespace) -> int:
    from benchmark.data.check import check_split

    if not args.split:
        raise ToolkitError("is needed", field="--split", hint="--list-splits tells their names")
    reports = [check_split(args.check_data, name) for name in args.split]
    for report in reports:
        print(report.text())
    return 0 if all(report.is_complete for report in reports) else 1


@dataclass(frozen=True)
class Task:
    """Something that is scored.

    Attributes:
        score: does it; returns the exit status.
        needed: options that must be given.
        own: options that only some tasks have, of those that this one has.
    """

    score: Callable[[argparse.Namespace], int]
    needed: tuple[str, ...]
    own: tuple[str, ...]


TASKS = {
    "depth": Task(
        _score_depth, ("method", "data", "split", "out"), ("depth_from", "save_depth", "no_speed")
    ),
    "pose": Task(
        score_poses,
        ("method", "data", "split", "out"),
        ("depth", "fit", "depth_as_input", "iou", "score", "gates"),
    ),
    "grasp": Task(score_grasps, ("depth", "planner", "out"), ("depth", *OWN)),
    "bop": Task(score_bop_results, ("data", "results"), ("results", "bop_split")),
}


if __name__ == "__main__":
    sys.exit(main())
