"""`std-curate export`: write a labelled scene in the layout of another tool."""

from __future__ import annotations

import argparse
from pathlib import Path

from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.errors import ToolkitError


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "export",
        help="write a labelled scene in the layout of STD, BOP or NOCS",
        description="Write every frame with ground truth in the layout of STD, BOP or NOCS. "
        "std_toolkit.json beside it holds what the layout has no place for: camera poses, "
        "intrinsics, object poses, where the metres come from.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE")
    parser.add_argument("--format", required=True, help="std, bop, nocs or a plug-in")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--label-size",
        metavar="WxH",
        help="STD: size of the labels (default: half of 1280x720, else that of colour)",
    )
    parser.add_argument(
        "--quaternion",
        choices=("dreds", "plain"),
        default="dreds",
        help="STD: rotation in the meta file as the DREDS generator writes it (inverse) or plain",
    )
    parser.add_argument("--scene-number", type=int, default=1, help="BOP, NOCS: default 1")
    parser.add_argument("--split", choices=("train", "val", "test"), default="test")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier export")
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.exporters import ExportOptions, export_scene
    from std_toolkit.scene.scene import Scene

    options = ExportOptions(
        label_size=_size(args.label_size),
        scene_number=args.scene_number,
        split=args.split,
        quaternion=args.quaternion,
        overwrite=args.overwrite,
    )
    explicit = args.engine != "local" or args.workers is not None
    sidecar = export_scene(
        Scene.open(args.scene),
        args.format,
        args.out,
        options=options,
        jobs=job_options(args) if explicit else None,
    )
    print(
        f"{args.out}: {len(sidecar.frames)} frames, {len(sidecar.models)} models, "
        f"{len(sidecar.files)} files in the layout of {sidecar.layout}"
    )
    if sidecar.left_out:
        print(f"left out {len(sidecar.left_out)} frames without ground truth")
    return 0


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise ToolkitError("a size is WIDTHxHEIGHT", field="--label-size", value=text)
    return int(width), int(height)
