"""`std-curate label`: set or import an object's pose in one or several frames."""

from __future__ import annotations

import argparse
from pathlib import Path

FORMATS_HELP = """pose files (--pose):
  4x4 numbers as text, .npy or JSON; JSON with quaternion_wxyz or quaternion_xyzw and
  translation_m or translation_mm; BOP scene_gt.json; 6D-PAT poses.json; LabelFusion
  *_poses.yaml and registration_result.yaml; vision6D .npy. The pose maps the mesh into the
  camera. docs/labelling.md describes each.

examples:
  std-curate label SCENE --object mug --mesh mug.obj --mesh-unit mm --category mug \\
      --material transparent --frame 0 --correspondences clicks.csv
  std-curate label SCENE --object mug --frame 0 --pose a.txt --frame 40 --pose b.txt
"""


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    parser = subparsers.add_parser(
        "label",
        help="set or import an object's pose in a frame",
        description="Enter an object and set its pose in one frame, or in several (then each is "
        "an annotated keyframe).",
        epilog=FORMATS_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene folder")
    parser.add_argument("--object", required=True, help="name of the object in this scene")
    thing = parser.add_argument_group("the object (when it is new, or to change it)")
    thing.add_argument("--mesh", type=Path, help="mesh to copy into the scene")
    thing.add_argument(
        "--mesh-unit", choices=("m", "cm", "mm"), default="m", help="of the mesh file (default: m)"
    )
    thing.add_argument("--model", metavar="ID", help="of the model (default: the mesh's name)")
    thing.add_argument("--category", help="such as mug (default: other)")
    thing.add_argument(
        "--material",
        choices=("raw", "diffuse", "specular", "transparent"),
        help="decides which evidence is trusted (default: diffuse)",
    )
    thing.add_argument(
        "--symmetry",
        action="append",
        metavar="S",
        help="axis:z (any turn about z), fold:z:4 (four equal turns), a JSON file, or none; "
        "through the bounding box's centre, or '@origin'; may be repeated",
    )
    pose = parser.add_argument_group("the pose (repeat --frame with its source for more views)")
    pose.add_argument(
        "--frame", type=int, action="append", default=[], metavar="N", help="id of the frame"
    )
    pose.add_argument(
        "--pose",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="the object's pose in this frame; see below",
    )
    pose.add_argument(
        "--correspondences",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="CSV or JSON of u, v (pixels) and x, y, z (mesh frame), four or more",
    )
    pose.add_argument(
        "--pose-format",
        default="auto",
        metavar="NAME",
        help="matrix, quaternion, bop, 6dpat or labelfusion (default: by content)",
    )
    pose.add_argument(
        "--pose-unit", choices=("m", "cm", "mm"), help="where the file leaves it open"
    )
    pose.add_argument(
        "--pose-convention",
        choices=("opencv", "opengl"),
        default="opencv",
        help="camera axes of the file: z forward, or -z forward (default: opencv)",
    )
    pose.add_argument("--pose-frame", help="image inside a file of many (default: --frame)")
    pose.add_argument("--pose-item", help="object inside a file of several")
    pose.add_argument(
        "--threshold-px", type=float, default=4.0, help="inlier limit of PnP (default: 4)"
    )
    pose.add_argument(
        "--add-view", action="store_true", help="keep earlier annotations of the object"
    )
    pose.add_argument("--annotator", default="", help="who did it")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.errors import ToolkitError
    from std_toolkit.io.atomic import sweep_temporaries
    from std_toolkit.labels.label_command import LabelCommand, run_label_command
    from std_toolkit.scene import Scene

    sources = [*args.pose, *args.correspondences]
    if args.pose and args.correspondences:
        raise ToolkitError("give either --pose or --correspondences, not both")
    shared = len(sources) == 1 and bool(args.pose)
    if len(sources) != len(args.frame) and not (shared and args.frame):
        raise ToolkitError(
            "each --frame needs its own --pose or --correspondences",
            value=f"{len(args.frame)} frames, {len(sources)} files",
        )
    scene = Scene.open(args.scene)
    command = LabelCommand(
        object=args.object,
        mesh=args.mesh,
        mesh_unit=args.mesh_unit,
        model=args.model,
        category=args.category,
        material=args.material,
        symmetry=tuple(args.symmetry) if args.symmetry is not None else None,
        frames=tuple(args.frame),
        # One file of many images (BOP, 6D-PAT) may serve several frames.
        poses=tuple(args.pose) if not shared else tuple(args.pose * len(args.frame)),
        correspondences=tuple(args.correspondences),
        pose_format=args.pose_format,
        pose_unit=args.pose_unit,
        pose_convention=args.pose_convention,
        pose_frame=args.pose_frame,
        pose_item=args.pose_item,
        threshold_px=args.threshold_px,
        add_view=args.add_view,
        annotator=args.annotator,
    )
    with scene.lock():
        sweep_temporaries(scene.root)
        for line in run_label_command(scene, command):
            print(line)
    return 0
