"""`std-bench --task pose` and `--task bop`: poses of categories, and of known objects."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from std_toolkit.cli.job_arguments import job_options
from std_toolkit.errors import ToolkitError


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
    from benchmark.pose_running.campaign import run_all_poses
    from benchmark.pose_running.plan import PoseWishes, plan_pose_runs
    from benchmark.pose_running.protocols import wanted_protocols
    from benchmark.pose_running.results import read_pose_run
    from benchmark.pose_running.show import poses_table

    protocols = wanted_protocols(args.protocol, iou=args.iou, score=args.score, gates=args.gates)
    wishes = PoseWishes(
        methods=tuple(args.method),
        splits=tuple(args.split),
        depths=tuple(args.depth),
        fits=tuple(args.fit),
        as_input=args.depth_as_input,
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
    )
    jobs = replace(job_options(args), gpus=args.gpus_per_task)
    report = run_all_poses(plan_pose_runs(wishes), jobs, gallery=not args.no_gallery)
    if report.finished:
        print(poses_table([read_pose_run(run.folder) for run in report.finished], protocols))
    for title, error in report.failed.items():
        print(f"error: {title}: {error}", file=sys.stderr)
    return 1 if report.failed or report.failed_frames else 0


def list_pose_methods() -> int:
    """Print what pose methods there are."""
    import inspect

    from benchmark.pose_methods.registry import pose_methods

    for name in pose_methods.names():
        try:
            about = (inspect.getdoc(pose_methods.get(name)) or "").partition("\n")[0]
        except ToolkitError as error:
            about = f"not usable here: {error.problem}"
        print(f"{name:16} {about}")
    return 0
