"""`std-curate poses`: camera poses in metres."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.poses.options import Mapper, PoseOptions, Refinement


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "poses",
        help="recover camera poses in metres (structure from motion)",
        description="Recover the camera pose of every frame with structure from motion, find the "
        "metres from every source that the scene has, and judge the result. Exit status 1 if a "
        "quality gate fails (the poses are saved and marked).",
    )
    default = PoseOptions()
    parser.add_argument("scene", type=Path, help="scene folder")
    parser.add_argument(
        "--scale",
        default=default.scale,
        metavar="SOURCE",
        help="auto, none (unit unknown), depth, cad, board, or an installed plug-in "
        "(default: auto: all that the scene has; they must agree)",
    )
    parser.add_argument(
        "--board", type=Path, metavar="FILE", help="fiducial board (default: SCENE/board.json)"
    )
    parser.add_argument(
        "--refine",
        choices=[str(x) for x in Refinement],
        default=str(default.refine),
        help="intrinsics to adjust with the poses (default: %(default)s)",
    )
    parser.add_argument(
        "--mapper",
        choices=[str(x) for x in Mapper],
        default=str(default.mapper),
        help="COLMAP's mapper for the keyframes (default: %(default)s)",
    )
    model = parser.add_argument_group("keyframes and matching")
    model.add_argument(
        "--keyframe-motion",
        type=float,
        default=default.keyframe_motion,
        metavar="N",
        help="image motion between keyframes, share of the width (default: %(default)s)",
    )
    model.add_argument(
        "--max-keyframe-gap",
        type=int,
        default=default.max_keyframe_gap,
        metavar="N",
        help="a keyframe at least every this many frames (default: %(default)s)",
    )
    model.add_argument(
        "--max-features",
        type=int,
        default=default.max_features,
        metavar="N",
        help="SIFT features per image (default: %(default)s)",
    )
    model.add_argument(
        "--fine-keyframes",
        action="store_true",
        help="twice the features at four times the time, for scenes of little texture",
    )
    model.add_argument(
        "--overlap",
        type=int,
        default=default.overlap,
        metavar="N",
        help="neighbours in time that a keyframe is matched with (default: %(default)s)",
    )
    model.add_argument(
        "--loops",
        type=int,
        default=default.loops,
        metavar="N",
        help="keyframes elsewhere in time that look alike, matched too (default: %(default)s)",
    )
    model.add_argument(
        "--min-points",
        type=int,
        default=default.min_points,
        metavar="N",
        help="fewest points that register a frame (default: %(default)s)",
    )
    model.add_argument(
        "--min-angle-deg",
        type=float,
        default=default.min_angle_deg,
        metavar="N",
        help="smallest angle under which points of the final adjustment are seen "
        "(default: %(default)s)",
    )
    gates = parser.add_argument_group("quality gates")
    gates.add_argument(
        "--min-registered",
        type=float,
        default=default.min_registered,
        metavar="N",
        help="smallest share, 0 to 1, of frames with a pose (default: %(default)s)",
    )
    gates.add_argument(
        "--max-reprojection-px",
        type=float,
        default=default.max_reprojection_px,
        metavar="N",
        help="largest mean reprojection error (default: %(default)s)",
    )
    gates.add_argument(
        "--max-position-sigma",
        type=float,
        default=default.max_position_sigma,
        metavar="N",
        help="largest standard deviation of a camera position, over the distance of what it "
        "sees (default: %(default)s)",
    )
    gates.add_argument(
        "--max-disagreement",
        type=float,
        default=default.max_disagreement,
        metavar="N",
        help="largest relative difference of two scale sources (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=default.seed, help="default: %(default)s")
    parser.add_argument(
        "--threads", type=int, help="1 makes the result byte-identical (default: all cores)"
    )
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def options_of(args: argparse.Namespace) -> PoseOptions:
    """The options of the step from parsed flags."""
    return PoseOptions(
        keyframe_motion=args.keyframe_motion,
        max_keyframe_gap=args.max_keyframe_gap,
        max_features=args.max_features,
        fine_keyframes=args.fine_keyframes,
        overlap=args.overlap,
        loops=args.loops,
        mapper=Mapper(args.mapper),
        refine=Refinement(args.refine),
        min_angle_deg=args.min_angle_deg,
        min_points=args.min_points,
        scale=args.scale,
        board=args.board,
        min_registered=args.min_registered,
        max_reprojection_px=args.max_reprojection_px,
        max_position_sigma=args.max_position_sigma,
        max_disagreement=args.max_disagreement,
        seed=args.seed,
        threads=args.threads,
    )


def run(args: argparse.Namespace) -> int:
    from std_toolkit.log import logger
    from std_toolkit.poses.pose_step import estimate_poses, failed_gates
    from std_toolkit.scene import Scene

    scene = Scene.open(args.scene)
    poses = estimate_poses(scene, options_of(args), jobs=job_options(args))
    for line in summary(poses, [f.name for f in scene.frames]):
        print(line)
    failed = failed_gates(poses)
    for line in failed:
        logger.error("gate failed: %s", line)
    return 1 if failed else 0


def summary(poses: Any, names: list[str]) -> list[str]:
    """What a person wants to know, one line each."""
    registered = [p for p in poses.frames if p.status == "registered"]
    lost = [name for p, name in zip(poses.frames, names, strict=True) if p.status != "registered"]
    lines = [f"registered {len(registered)} of {len(poses.frames)} frames"]
    if lost:
        shown = ", ".join(lost[:8]) + (" ..." if len(lost) > 8 else "")
        lines.append(f"  unregistered: {shown}")
    lines += [f"  note: {note}" for note in poses.notes]
    for gate in poses.gates:
        mark = "ok    " if gate.passed else "FAILED"
        lines.append(f"  {mark} {gate.name}: {gate.value:.4g} (limit {gate.limit:.4g})")
    if poses.scale is not None:
        lines.append(f"scale: {poses.scale.chosen}, unit {poses.scale.unit}")
        for e in poses.scale.estimates:
            lines.append(
                f"  {e.source}: {e.factor:.6g} m per unit, spread {100 * e.spread:.2f} %, "
                f"standard error {100 * e.standard_error:.3f} %, n = {e.count} ({e.note})"
            )
    for key, camera in poses.cameras.items():
        values = " ".join(f"{v:.2f}" for v in (camera.fx, camera.fy, camera.cx, camera.cy))
        extra = " ".join(f"{v:.4f}" for v in camera.distortion)
        lines.append(f"camera {key}: {values}" + (f" distortion {extra}" if extra else ""))
    return lines
