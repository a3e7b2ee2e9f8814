"""`std-bench --task grasp`: table clearing in simulation."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

from std_toolkit.cli.job_arguments import job_options
from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

OWN = ("planner", "rounds", "seed", "camera", "attempts")


def add_grasp_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that other tasks have not; imports no heavy library."""
    add = parser.add_argument_group("table clearing (--task grasp)").add_argument
    add(
        "--planner",
        nargs="+",
        default=["antipodal"],
        metavar="NAME",
        help="antipodal, graspnet, oracle (knows where the objects are), or package.module:Class",
    )
    add("--rounds", type=int, default=6, metavar="N", help="tables to clear (6)")
    add("--seed", type=int, default=0, metavar="N", help="decides every round and all noise (0)")
    add(
        "--camera",
        default="quick",
        metavar="KIND",
        help="quick: depth by a model fitted to the simulator; simulated: by the simulator itself",
    )
    add("--attempts", type=int, default=10, metavar="N", help="at most so many a round (10)")


def score_grasps(args: argparse.Namespace) -> int:
    """Clear the tables; returns the exit status."""
    from benchmark.clearing.plan import GraspWishes, plan_grasp_runs
    from benchmark.clearing.results import read_grasp_run
    from benchmark.clearing.run import run_clearing
    from benchmark.clearing.show import grasp_table

    wishes = GraspWishes(
        depths=tuple(args.depth),
        planners=tuple(args.planner),
        rounds=args.rounds,
        seed=args.seed,
        out=args.out,
        camera=args.camera,
        attempts=args.attempts,
        preset=args.preset,
        precision=args.precision,
        compile=args.compile,
        weights=tuple(args.weights),
        settings=tuple(args.settings),
        devices=tuple(args.device),
        strips=not args.no_gallery,
    )
    if args.split or args.data or args.method or args.limit is not None:
        raise ToolkitError(
            "table clearing makes its own scenes",
            field="--method, --data, --split, --limit",
            hint="--depth names restorers, --rounds how many tables",
        )
    jobs = replace(job_options(args), gpus=args.gpus_per_task)
    finished, failed = [], {}
    for run in plan_grasp_runs(wishes):
        logger.info("%s: %d rounds", run.title, run.rounds)
        try:
            run_clearing(run, jobs)
        except ToolkitError as error:
            # Weights that are not at hand keep no other depth or planner from its table.
            failed[run.title] = str(error)
        else:
            finished.append(read_grasp_run(run.folder, rounds=run.rounds))
    if finished:
        print(grasp_table(finished))
    for title, why in failed.items():
        print(f"error: {title}: {why}", file=sys.stderr)
    return 1 if failed else 0


def list_planners() -> int:
    """Print what grasp planners there are."""
    import inspect

    from benchmark.grasp_methods.registry import grasp_planners

    for name in grasp_planners.names():
        try:
            about = (inspect.getdoc(grasp_planners.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            about = f"not usable here: {error.problem}"
        print(f"{name:16} {about}")
    print(f"{'oracle':16} Knows where the objects are: what can be reached at all.")
    return 0
