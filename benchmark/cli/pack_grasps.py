"""`std-train pack-grasps`: make scenes of objects on a table with labelled grasps."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from std_toolkit.cli.job_arguments import add_job_arguments, job_options

PACK_GRASPS = "pack-grasps"


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
    from benchmark.training.grasps.pack import GraspPackOptions, pack_grasps
    from benchmark.training.grasps.tabletop import TableOptions

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
