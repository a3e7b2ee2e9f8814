"""`std-curate run`: poses, propagate, render and check in one go."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from std_toolkit.cli.command_line import add_job_arguments

# A step whose result the next ones build on ends the run when it fails; a frame that could not
# be rendered does not: the check tells what is missing.
ENDS_THE_RUN = ("poses", "propagate")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "run",
        help="poses, propagate --refine, render and check in one go",
        description="Run the steps poses, propagate, render and check on a scene whose objects "
        "are labelled. Steps and frames that are done are kept, stale ones are redone; run it "
        "again after any interruption. Poses that came with an import are kept.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE")
    parser.add_argument(
        "--no-refine", action="store_true", help="propagate the annotated poses as they are"
    )
    parser.add_argument(
        "--refine-scale",
        action="store_true",
        help="let the known sizes of the objects correct the scale of the camera poses",
    )
    poses = parser.add_argument_group("as in `std-curate poses`")
    poses.add_argument("--scale", default="auto", metavar="SOURCE")
    poses.add_argument("--board", type=Path, metavar="FILE")
    poses.add_argument("--seed", type=int, default=0)
    poses.add_argument("--threads", type=int, metavar="N")
    render = parser.add_argument_group("as in `std-curate render`")
    render.add_argument("--renderer", default="pyrender")
    render.add_argument("--policy", choices=("auto", "models", "sensor", "fused"), default="auto")
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the steps as their own commands would; the first failure that matters ends it."""
    from std_toolkit.cli.main import build_parser

    parser = build_parser()
    status = 0
    for step, arguments in _steps(args):
        print(f"\n== {step}", flush=True)
        parsed = parser.parse_args([step, str(args.scene), *arguments])
        outcome = int(parsed.run(parsed))
        status = max(status, outcome)
        if outcome and step in ENDS_THE_RUN:
            print(f"the run ends here: `{step}` failed, see above", file=sys.stderr)
            break
    return status


def _steps(args: argparse.Namespace) -> Iterator[tuple[str, list[str]]]:
    """(command, its arguments); evaluated one by one, so that each sees what the last one did."""
    from std_toolkit.errors import ToolkitError
    from std_toolkit.log import logger
    from std_toolkit.scene import Scene

    jobs = ["--engine", args.engine]
    if args.workers is not None:
        jobs += ["--workers", str(args.workers)]
    if args.ray_address is not None:
        jobs += ["--ray-address", args.ray_address]

    scene = Scene.open(args.scene)
    if scene.poses is not None and scene.poses.source != "sfm":
        logger.info("camera poses: kept as they came (%s)", scene.poses.source)
    else:
        arguments = ["--scale", args.scale, "--seed", str(args.seed), *jobs]
        if args.board is not None:
            arguments += ["--board", str(args.board)]
        if args.threads is not None:
            arguments += ["--threads", str(args.threads)]
        yield "poses", arguments
    if not scene.labels.labels:
        raise ToolkitError(
            "no object is labelled yet",
            path=args.scene,
            hint="the camera poses are done; label objects with `std-curate label`, then run again",
        )
    refine = [] if args.no_refine else ["--refine"]
    yield "propagate", [*refine, *(["--refine-scale"] if args.refine_scale else [])]
    yield "render", ["--renderer", args.renderer, "--policy", args.policy, *jobs]
    yield "check", jobs
