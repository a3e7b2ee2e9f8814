"""`std-curate propagate`: carry annotated poses to all registered frames, and refine them."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser(
        "propagate",
        help="carry annotated poses to every registered frame",
        description="Give every labelled object one pose in the world, and with it one in every "
        "registered frame. --refine adjusts it jointly over spread keyframes against image edges "
        "and silhouettes and, on diffuse objects only, sensor depth.",
    )
    parser.add_argument("scene", type=Path)
    parser.add_argument("--object", action="append", metavar="NAME", help="only these objects")
    parser.add_argument("--refine", action="store_true")
    parser.add_argument(
        "--refine-scale",
        action="store_true",
        help="estimate the scale of the camera poses from the objects' sizes too",
    )
    parser.add_argument("--keyframes", type=int, default=10, help="frames used to refine")
    parser.add_argument("--no-depth", action="store_true", help="refine with the images alone")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.labels.propagate import PropagateOptions, label_lines, propagate_labels
    from std_toolkit.scene import Scene

    scene = Scene.open(args.scene)
    options = PropagateOptions(
        refine=args.refine,
        refine_scale=args.refine_scale,
        objects=tuple(args.object) if args.object else None,
        keyframes=args.keyframes,
        use_depth=not args.no_depth,
    )
    labels = propagate_labels(scene, options)
    for line in label_lines(scene, labels):
        print(line)
    chosen = {scene.objects.object_named(n).id for n in args.object or ()}
    lost = [
        x for x in labels.labels if x.T_world_obj is None and (not chosen or x.object in chosen)
    ]
    return 1 if lost else 0
