"""`std-sim`: simulate a data set, look at a scene beforehand, tell what a set holds.

Names that the command line offers, apart from what they stand for: `--help` loads nothing.
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.log import log_to_stderr

if TYPE_CHECKING:
    from sensors.simulation.options import SimulationOptions

# Command-line flag to field of SimulationOptions; a flag that is not given leaves the preset's.
_FLAGS = {
    "sensor": "sensor",
    "views": "views",
    "order": "order",
    "sweep_deg": "sweep_deg",
    "width": "width",
    "height": "height",
    "color_factor": "color_factor",
    "assets": "assets",
    "assets_root": "assets_root",
    "scenes_from": "scenes_from",
    "graspnet_root": "graspnet_root",
    "pattern": "pattern",
    "pattern_fov": "pattern_fov_deg",
    "environments": "environments",
    "floors": "floors",
    "quality": "quality",
    "matcher": "matcher",
    "materials": "materials",
    "depth": "depth",
}

PRESET_NAMES = ("draft", "tiny", "dreds")

QUALITY_NAMES = ("rough", "draft", "better", "fine")

ORDERS = ("random", "arc", "spiral")

MATERIAL_SWITCHES = ("mixed", "fixed", "opaque")

SCENE_ORIGINS = ("drop", "graspnet")


def build_parser() -> argparse.ArgumentParser:
    """The parser; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-sim",
        description="Simulate RGB-D recordings of specular, transparent and diffuse objects with "
        "an active stereo camera. `std-sim run` makes a data set, `std-sim preview` shows a "
        "scene, `std-sim stats` tells what a set holds.",
    )
    parser.add_argument("--version", action="version", version=f"std-toolkit {__version__}")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    run = commands.add_parser(
        "run",
        help="simulate scenes (also without the word: std-sim --out DIR ...)",
        description="Simulate scenes. What is there already is kept: run the same command again to "
        "go on, or with more scenes to add some.",
    )
    run.add_argument("--out", type=Path, required=True, metavar="DIR", help="data set")
    run.add_argument("--scenes", type=int, metavar="N", help="number of scenes")
    run.add_argument(
        "--share",
        type=float,
        default=1.0,
        metavar="X",
        help="make this share of the scenes only, spread evenly (ablation: half the data is 0.5)",
    )
    run.add_argument(
        "--split", choices=("train", "val", "test"), default="train", help="part of the data set"
    )
    run.add_argument(
        "--layout",
        action="append",
        choices=("dreds", "scene"),
        help="dreds: DREDS-CatKnown (default); scene: toolkit scenes; give both for both",
    )
    run.add_argument(
        "--cache", type=Path, metavar="DIR", help="keeps convex parts (~/.cache/std-toolkit)"
    )
    _add_scene_arguments(run)
    add_job_arguments(run)
    run.set_defaults(run=_run)

    preview = commands.add_parser(
        "preview",
        help="make one scene and show it as a contact sheet",
        description="Simulate views of one scene into a picture: colour, infrared, raw depth, "
        "exact depth, error.",
    )
    preview.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="picture")
    _add_scene_arguments(preview)
    preview.set_defaults(run=_preview)

    stats = commands.add_parser(
        "stats",
        help="categories, materials, completeness and error of the raw depth by material",
        description="Read a data set in the DREDS layout and print what it holds.",
    )
    stats.add_argument("root", type=Path, metavar="DIR", help="data set")
    stats.add_argument("--csv", type=Path, metavar="FILE", help="write the depth table there")
    stats.set_defaults(run=_stats)
    return parser


def _add_scene_arguments(parser: argparse.ArgumentParser) -> None:

    add = parser.add_argument
    add("--preset", choices=PRESET_NAMES, default="draft", help="what is not told below")
    add("--seed", type=int, default=0, help="of the first scene; the others follow it")
    add("--sensor", metavar="NAME", help="d415, d435, d455 or the path of a specification")
    add("--views", type=int, metavar="N", help="frames of a scene (30)")
    add("--order", choices=ORDERS, help="viewpoints at random, or along a smooth way")
    add("--sweep-deg", type=float, metavar="DEG", help="angle of a smooth way (120)")
    add("--width", type=int, metavar="PX", help="of infrared, depth and labels (640)")
    add("--height", type=int, metavar="PX", help="of the same (360)")
    add("--color-factor", type=int, metavar="K", help="colour is so many times as large (1)")
    add("--assets", metavar="NAME", help="procedural, shapenet, folder or a plug-in")
    add("--assets-root", metavar="DIR", help="folder of the asset source's files")
    add(
        "--scenes-from",
        choices=SCENE_ORIGINS,
        help="drop: objects fall (default); graspnet: objects lie as in GraspNet-1Billion",
    )
    add("--graspnet-root", metavar="DIR", help="folder of GraspNet-1Billion: scenes/ and models/")
    add("--pattern", metavar="FILE", help="image that the projector throws, instead of made dots")
    add("--pattern-fov", type=float, metavar="DEG", help="its width as an angle (the projector's)")
    add("--environments", metavar="DIR", help="folder of .hdr and .exr environment maps")
    add("--floors", metavar="DIR", help="folder of floor pictures")
    add("--quality", choices=QUALITY_NAMES, help="light paths per pixel")
    add("--matcher", metavar="NAME", help="local, sgbm, dreds or a plug-in")
    ablations = parser.add_argument_group("ablations")
    ablations.add_argument(
        "--materials",
        choices=MATERIAL_SWITCHES,
        help="mixed; fixed: objects keep their own look; opaque: none is transparent",
    )
    ablations.add_argument(
        "--no-infrared-noise", action="store_true", help="no shot and read noise in infrared"
    )
    ablations.add_argument(
        "--depth",
        choices=("sensor", "cut"),
        help="cut: exact depth without transparent and specular objects, instead of stereo",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a failure, 2 bad usage."""
    words = list(sys.argv[1:] if argv is None else argv)
    # `std-sim --out DIR --scenes 10` is what everybody types.
    if words and words[0].startswith("--") and words[0] not in ("--help", "--version", "--debug"):
        words.insert(0, "run")
    args = build_parser().parse_args(words)
    log_to_stderr(logging.INFO)
    return exit_status(lambda: int(args.run(args)), program="std-sim", debug=args.debug)


def _options(args: argparse.Namespace, split: str) -> SimulationOptions:
    import msgspec

    from sensors.simulation.options import preset

    given: dict[str, Any] = {
        field: getattr(args, flag)
        for flag, field in _FLAGS.items()
        if getattr(args, flag) is not None
    }
    # Validation scenes are made of the training shapes and light.
    given["split"] = "test" if split == "test" else "train"
    given["infrared_noise"] = not args.no_infrared_noise
    return msgspec.structs.replace(preset(args.preset).options, **given)


def _run(args: argparse.Namespace) -> int:
    from sensors.simulation.options import preset
    from sensors.simulation.simulated_set import simulate_set
    from std_toolkit.errors import ToolkitError

    options = _options(args, args.split)
    count = args.scenes if args.scenes is not None else preset(args.preset).scenes
    if not 0 < args.share <= 1:
        raise ToolkitError("must lie above 0 and at most 1", field="--share", value=args.share)
    seeds = [args.seed + i for i in range(count) if int((i + 1) * args.share) > int(i * args.share)]
    report = simulate_set(
        args.out,
        options,
        seeds,
        split=args.split,
        layouts=tuple(dict.fromkeys(args.layout or ["dreds"])),
        cache=args.cache,
        jobs=job_options(args),
    )
    made = sum(1 for times in report.results.values() if times.frames)
    print(
        f"{made} scenes made, {len(seeds) - made - len(report.failed)} kept, "
        f"{len(report.failed)} failed; in {args.out}"
    )
    frames = sum(times.frames for times in report.results.values())
    if frames:
        total: dict[str, float] = {}
        for times in report.results.values():
            for part, seconds in times.seconds.items():
                total[part] = total.get(part, 0.0) + seconds
        shares = ", ".join(f"{part} {seconds / frames:.2f}" for part, seconds in total.items())
        print(f"seconds of a worker per frame: {sum(total.values()) / frames:.2f} ({shares})")
    return 1 if report.failed else 0


def _preview(args: argparse.Namespace) -> int:
    from sensors.simulation.set_report import contact_sheet
    from sensors.simulation.simulated_set import parts_cache
    from sensors.simulation.simulator import Simulator
    from std_toolkit.io.images import write_color

    args.views = args.views or 4
    simulator = Simulator(_options(args, "train"), parts_cache=parts_cache())
    world = simulator.world(args.seed, "preview")
    write_color(args.out, contact_sheet(list(simulator.frames(world))))
    for thing, drawn in zip(world.record.objects, world.draw.objects, strict=True):
        print(
            f"{thing.instance_id:3d}  {thing.category:10s} {1000 * thing.scale_m:4.0f} mm  "
            f"{thing.material_class:12s} {drawn.material.name}"
        )
    print(f"floor: {world.draw.floor.material.name}; light: {world.scene.environment.name}")
    print(args.out)
    return 0


def _stats(args: argparse.Namespace) -> int:
    from sensors.simulation.set_report import set_statistics

    statistics = set_statistics(args.root)
    print(statistics)
    if args.csv is not None:
        from std_toolkit.io.atomic import write_bytes_atomic

        write_bytes_atomic(args.csv, statistics.depth.to_csv().encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
