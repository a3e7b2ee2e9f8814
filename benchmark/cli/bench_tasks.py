"""`std-bench --task pose` and `--task bop`: poses of categories, and of known objects.

`std-bench --task bop`: result files of instance-level poses on a data set in BOP's layout.

`std-bench --task grasp`: table clearing in simulation.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_toolkit.cli.command_line import job_options
from std_toolkit.errors import ToolkitError

if TYPE_CHECKING:
    from std_toolkit.jobs import JobOptions

OWN = ("planner", "rounds", "seed", "camera", "attempts")


def add_pose_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that depth has not; imports no heavy library."""
    add = parser.add_argument_group("poses (--task pose)").add_argument
    add(
        "--fit",
        nargs="+",
        choices=("ransac", "paper"),
        default=["ransac"],
        help="how poses are fitted: RANSAC, or least squares as in the paper's program",
    )
    add(
        "--depth-as-input",
        action="store_true",
        help="networks look at the depth of --depth, too, and not at raw depth",
    )
    add("--iou", choices=("oriented", "aabb", "nocs2019"), help="instead of the protocol's own")
    add("--score", choices=("ap", "accuracy"), help="instead of the protocol's own")
    add(
        "--gates",
        choices=("all", "found"),
        help="angle and distance of all predictions, or of those that overlap a true box",
    )
    add = parser.add_argument_group("poses of known objects (--task bop)").add_argument
    add("--results", nargs="+", type=Path, default=[], metavar="CSV", help="in BOP's format")
    add("--bop-split", default="test", metavar="NAME", help="folder of the scenes")


def score_poses(args: argparse.Namespace) -> int:
    """Run and score pose methods; returns the exit status."""
    from benchmark.evaluation.config import PoseConfig

    config = PoseConfig(
        methods=tuple(args.method),
        splits=tuple(args.split),
        depths=tuple(args.depth),
        fits=tuple(args.fit),
        depth_as_input=args.depth_as_input,
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
        protocols=tuple(args.protocol),
        iou=args.iou,
        score=args.score,
        gates=args.gates,
        gallery=not args.no_gallery,
    )
    return score("pose", config, replace(job_options(args), gpus=args.gpus_per_task))


def score(name: str, config: Any, jobs: JobOptions) -> int:
    """Run a task and print its table; returns the exit status."""
    from benchmark.evaluation.engine import run_all
    from benchmark.evaluation.tasks import get_task

    task = get_task(name)
    report = run_all(task, task.plan(config), jobs)
    if report.finished:
        print(task.table([task.read(run.folder, run) for run in report.finished], config))
    for title, error in report.failed.items():
        print(f"error: {title}: {error}", file=sys.stderr)
    return 1 if report.failed or report.failed_frames else 0


def list_pose_methods() -> int:
    """Print what pose methods there are."""
    import inspect

    from benchmark.methods.registry import pose_methods

    for name in pose_methods.names():
        try:
            about = (inspect.getdoc(pose_methods.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            about = f"not usable here: {error.problem}"
        print(f"{name:16} {about}")
    return 0


def score_bop_results(args: argparse.Namespace) -> int:
    """Score result files; returns the exit status."""
    from benchmark.evaluation.tasks.bop import BopResult, bop_table, write_bop_result
    from benchmark.metrics.bop import open_bop, read_bop_results, score_bop

    if len(args.data) != 1 or not Path(args.data[0]).is_dir():
        raise ToolkitError(
            "needs one folder of a data set in BOP's layout", field="--data", value=args.data
        )
    dataset = open_bop(args.data[0], args.bop_split)
    rows = []
    for path in args.results:
        estimates = read_bop_results(path)
        scores = score_bop(dataset, estimates)
        result = BopResult(
            results=path.stem,
            data=str(args.data[0]),
            split=args.bop_split,
            targets=sum(target.inst_count for target in dataset.targets),
            estimates=len(estimates),
            ar=scores.ar,
            ar_vsd=scores.vsd,
            ar_mssd=scores.mssd,
            ar_mspd=scores.mspd,
            seconds_per_image=scores.seconds_per_image,
        )
        rows.append(result)
        if args.out is not None:
            write_bop_result(args.out, result)
    print(bop_table(rows))
    return 0


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
    from benchmark.evaluation.config import GraspConfig

    config = GraspConfig(
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
        gallery=not args.no_gallery,
    )
    if args.split or args.data or args.method or args.limit is not None:
        raise ToolkitError(
            "table clearing makes its own scenes",
            field="--method, --data, --split, --limit",
            hint="--depth names restorers, --rounds how many tables",
        )
    return score("grasp", config, replace(job_options(args), gpus=args.gpus_per_task))


def list_planners() -> int:
    """Print what grasp planners there are."""
    import inspect

    from benchmark.methods.registry import grasp_planners

    for name in grasp_planners.names():
        try:
            about = (inspect.getdoc(grasp_planners.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            about = f"not usable here: {error.problem}"
        print(f"{name:16} {about}")
    print(f"{'oracle':16} Knows where the objects are: what can be reached at all.")
    return 0
