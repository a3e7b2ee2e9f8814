"""`std-curate import`: make a scene from a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.errors import ToolkitError


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "import",
        help="make a scene from a recording",
        description="Make a scene from separate images (--color DIR [--depth DIR] --intrinsics K) "
        "or from a recording in another format (SRC).",
    )
    parser.add_argument("source", nargs="?", metavar="SRC", help="folder of a known format")
    parser.add_argument(
        "--format", help="folder, std, dreds, bop, nocs, cleargrasp or a plug-in (default: by SRC)"
    )
    parser.add_argument("--out", required=True, type=Path, metavar="SCENE", help="new scene folder")
    parser.add_argument("--name", help="name of the scene (default: that of its folder)")
    images = parser.add_argument_group("separate images")
    images.add_argument("--color", metavar="DIR", help="folder or quoted pattern of colour images")
    images.add_argument("--depth", metavar="DIR", help="folder or pattern of aligned depth images")
    images.add_argument(
        "--depth-scale", type=float, help="metres per unit of 16-bit depth (default: 0.001)"
    )
    images.add_argument(
        "--depth-correction", type=float, default=1.0, help="calibrated factor on all depth"
    )
    images.add_argument("--intrinsics", metavar="K", help="a file, or fx,fy,cx,cy in pixels")
    images.add_argument("--distortion", help="k1,k2,p1,p2[,k3[,k4,k5,k6]] (OpenCV)")
    images.add_argument(
        "--skip-unpaired", action="store_true", help="leave out frames without colour or depth"
    )
    images.add_argument(
        "--off-centre", action="store_true", help="accept a principal point far from the middle"
    )
    parser.add_argument(
        "--material",
        choices=("raw", "diffuse", "transparent", "specular"),
        help="of imported objects whose format does not tell",
    )
    parser.add_argument(
        "--models", type=Path, metavar="DIR", help="CAD models, where the format keeps them apart"
    )
    parser.add_argument(
        "--link",
        nargs="?",
        const="hard",
        default="copy",
        choices=("copy", "hard", "sym"),
        help="link images that need no conversion, instead of copying them",
    )
    add_job_arguments(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.cli.summary import summarise
    from std_toolkit.importers import ImportRequest, import_recording
    from std_toolkit.scene.document import check_name, safe_name

    if (args.source is None) == (args.color is None):
        raise ToolkitError("give either SRC or --color", hint="see `std-curate import --help`")
    name = (
        check_name(args.name, field="--name") if args.name else safe_name(args.out.resolve().name)
    )
    request = ImportRequest(
        source=Path(args.source or args.color),
        name=name,
        color=args.color,
        depth=args.depth,
        depth_scale=args.depth_scale,
        depth_correction=args.depth_correction,
        intrinsics=args.intrinsics,
        distortion=args.distortion,
        skip_unpaired=args.skip_unpaired,
        off_centre=args.off_centre,
        material=args.material,
        models=args.models,
    )
    explicit = args.engine != "local" or args.workers is not None
    scene = import_recording(
        request,
        args.out,
        format_name=args.format,
        link=args.link,
        options=job_options(args) if explicit else None,
    )
    print("\n".join(summarise(scene).lines()))
    return 0
