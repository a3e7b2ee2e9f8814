"""`std-curate render`: ground truth for every labelled frame."""

from __future__ import annotations

import argparse

from std_toolkit.cli.command_line import add_job_arguments, job_options


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command `render`."""
    parser = subparsers.add_parser(
        "render",
        help="render depth, masks, NOCS, normals and visible fractions of the labelled objects",
        description="Render ground truth for every labelled frame into SCENE/gt: z-depth, instance "
        "mask, NOCS map, surface normals, and per object the visible fraction and boxes. Frames "
        "that are finished and whose inputs did not change are kept.",
    )
    parser.add_argument("scene", metavar="SCENE", help="scene folder")
    parser.add_argument(
        "--renderer",
        default="pyrender",
        help="pyrender (default; the ray caster takes over where no GL context can be made and for "
        "cameras with distortion), raycast, or a plug-in's name",
    )
    parser.add_argument(
        "--policy",
        choices=("auto", "models", "sensor", "fused"),
        default="auto",
        help="what hides labelled objects besides each other: nothing (models), the frame's sensor "
        "depth (sensor), geometry fused from many frames' sensor depth (fused); auto takes fused "
        "with sensor depth in 8 or more registered frames, sensor with fewer if no object is "
        "transparent or specular, else models",
    )
    parser.add_argument(
        "--delta-mm",
        type=float,
        default=15.0,
        metavar="MM",
        help="how far in front of an object sensor depth or fused geometry must be to hide it "
        "(default 15, as BOP)",
    )
    parser.add_argument(
        "--clearance-mm",
        type=float,
        default=30.0,
        metavar="MM",
        help="policy fused: geometry closer than this to a labelled object hides nothing "
        "(default 30)",
    )
    parser.add_argument(
        "--flat-normals",
        action="store_true",
        help="each triangle's own normal instead of interpolated ones",
    )
    parser.add_argument(
        "--frames", type=int, nargs="+", metavar="ID", help="render these frames only"
    )
    parser.add_argument("--force", action="store_true", help="render finished frames again")
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Render and print a summary; 1 when a frame failed."""
    from std_toolkit.rendering.occluders import FusionOptions
    from std_toolkit.rendering.render_step import RenderOptions, render_ground_truth
    from std_toolkit.scene.scene import Scene

    options = RenderOptions(
        renderer=args.renderer,
        policy=args.policy,
        delta_m=args.delta_mm / 1000,
        fusion=FusionOptions(clearance_m=args.clearance_mm / 1000),
        smooth_normals=not args.flat_normals,
        force=args.force,
    )
    scene = Scene.open(args.scene)
    with scene.lock():
        report = render_ground_truth(scene, options, frames=args.frames, jobs=job_options(args))
    kept = sum(1 for outcome in report.results.values() if outcome == "kept")
    print(
        f"ground truth: {len(report.results) - kept} frames rendered, {kept} kept, "
        f"{len(report.failed)} failed; in {scene.root / 'gt'}"
    )
    return 1 if report.failed else 0
