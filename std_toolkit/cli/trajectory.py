"""`std-curate trajectory`: the camera path for other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

FORMATS = ("csv", "tum", "colmap", "nerf")


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "trajectory",
        help="write the camera poses for other tools",
        description="Write the camera poses in metres: csv (one row per frame, T_world_cam "
        "row-major), tum, colmap (a folder with a text model) or nerf (transforms.json, OpenGL "
        "axes).",
    )
    parser.add_argument("scene", type=Path, help="scene folder")
    parser.add_argument("--out", type=Path, required=True, help="file, or folder for colmap")
    parser.add_argument("--format", choices=FORMATS, default="csv")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.poses.trajectory import write_trajectory
    from std_toolkit.scene import Scene

    scene = Scene.open(args.scene)
    write_trajectory(scene, args.out, format=args.format)
    done, total = len(scene.registered_frames()), len(scene.frames)
    print(f"{args.out}: {done} of {total} frames have a pose")
    return 0
