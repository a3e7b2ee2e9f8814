"""`std-train`: train depth restorers, and pack frames for that."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmark.cli.train_commands import (
    PACK_GRASPS,
    build_grasp_pack_parser,
    build_recipe_parser,
    pack_grasps_command,
)
from benchmark.cli.train_commands import run as run_recipe
from std_toolkit import __version__
from std_toolkit.cli.command import exit_status
from std_toolkit.cli.command_line import add_job_arguments, job_options
from std_toolkit.errors import ToolkitError
from std_toolkit.log import log_to_stderr, logger

PACK, EXPORT, RECIPE = "pack", "export", "recipe"


def build_parser() -> argparse.ArgumentParser:
    """The parser of training; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-train",
        description="Train a network that restores depth, on frames that `std-train pack` made "
        "ready. Interrupted or killed, the same command goes on from the last checkpoint and ends "
        "with the same weights. `std-train pack --help` tells how to pack, "
        "`std-train export --help` how to give trained weights away, `std-train recipe` runs whole "
        "experiments.",
    )
    add = parser.add_argument
    add("--version", action="version", version=f"std-toolkit {__version__}")
    add("--debug", action="store_true", help="show the traceback of an error")

    what = parser.add_argument_group("what is trained")
    add = what.add_argument
    add(
        "--method",
        metavar="NAME",
        help="swindrnet, nlspn, lidf, cleargrasp, dfnet, or package.module:TRAINABLE",
    )
    add("--preset", default="compact", help="size of the network: published or compact")
    add("--set", nargs="+", default=[], metavar="NAME=VALUE", dest="settings", help="of networks")
    add("--data", nargs="+", type=Path, metavar="DIR", help="packed frames")
    add("--validation", nargs="+", type=Path, default=[], metavar="DIR", help="packed frames")
    add("--hold-out", type=float, default=0.1, metavar="SHARE", help="of scenes, else (0.1)")
    add("--share", type=float, default=1.0, metavar="X", help="train on this share of the scenes")
    add("--out", type=Path, metavar="RUN", help="folder of the training")
    add("--weights", type=Path, metavar="FILE", help="begin with these weights")
    add("--imagenet", type=Path, metavar="FILE", help="begin with these of a classifier")

    how = parser.add_argument_group("how; what is not given is as published for the method")
    add = how.add_argument
    add("--steps", type=int, metavar="N")
    add("--epochs", type=int, metavar="N")
    add("--phases", nargs="+", default=[], metavar="NAME=STEPS", help="of methods with several")
    add("--batch-size", type=int, metavar="N", help="of a step, over all devices")
    add("--learning-rate", type=float, metavar="X")
    add("--weight-decay", type=float, metavar="X")
    add("--optimizer", choices=("adam", "adamw", "sgd"))
    add("--decay", choices=("linear", "steps"), help="of the learning rate (as published)")
    add("--loss", nargs="+", default=[], metavar="NAME=VALUE", help="form=released, ...")
    colors = ("published", "on", "jitter", "off")
    add("--colors", choices=colors, default="published", help="augmentation of colour")
    add("--geometry", choices=("published", "on", "off"), default="published", help="of geometry")
    add("--holes", type=float, default=0.0, metavar="SHARE", help="frames that lose depth (0)")
    add("--seed", type=int, default=0)
    add("--precision", choices=("fp32", "bf16"), default="fp32")
    add("--accumulate", type=int, default=1, metavar="N", help="parts of a step, one by one")
    add("--validate-every", type=int, metavar="STEPS")
    add("--checkpoint-every", type=int, metavar="STEPS")

    where = parser.add_argument_group("where it runs")
    add = where.add_argument
    add("--accelerator", choices=("auto", "cpu", "gpu"), default="auto")
    add("--devices", type=int, default=1, metavar="N", help="of a machine")
    add("--nodes", type=int, default=1, metavar="N", help="machines, started by torchrun or Ray")
    add("--engine", choices=("local", "ray"), default="local", help="ray: Ray Train")
    add("--ray-address", metavar="HOST:PORT", help="of a running Ray cluster")
    add("--readers", type=int, default=2, metavar="N", help="processes that read, per device")
    add("--log-every", type=int, default=50, metavar="STEPS")
    return parser


def build_pack_parser() -> argparse.ArgumentParser:
    """The parser of packing; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-train pack",
        description="Pack the frames of a split at training size, for reading without decoding. "
        "Run the same command again to go on.",
    )
    add = parser.add_argument
    add("folder", type=Path, metavar="DIR", help="where the packed frames go")
    add("--debug", action="store_true", help="show the traceback of an error")
    add("--split", required=True, metavar="NAME", help="see `std-bench list splits`")
    add("--data", required=True, type=Path, metavar="ROOT", help="folder of the data set")
    add("--size", nargs=2, type=int, default=(224, 224), metavar=("W", "H"), help="(224 224)")
    add("--depth", choices=("float32", "float16"), default="float32")
    add("--color", choices=("cubic", "area", "nearest"), default="cubic", help="how it is resized")
    add("--shard", type=int, default=64, metavar="N", help="frames per file (64)")
    add("--nocs", action="store_true", help="also NOCS and classes, for pose networks")
    add(
        "--raw",
        choices=("sensor", "cut"),
        default="sensor",
        help="cut: exact depth without specular and transparent objects, for the sensor's",
    )
    add_job_arguments(parser)
    return parser


def build_export_parser() -> argparse.ArgumentParser:
    """The parser of giving weights away; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-train export",
        description="Write the best weights of a training in half precision, with their SHA-256 "
        "and a model card: data, steps, machine, time, scores.",
    )
    add = parser.add_argument
    add("run", type=Path, metavar="RUN", help="folder of the training")
    add("--debug", action="store_true", help="show the traceback of an error")
    add("--out", required=True, type=Path, metavar="DIR", help="where the files go")
    add("--results", nargs="+", type=Path, metavar="DIR", help="of std-bench, for the card")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    builder, work = _COMMANDS.get(given[0] if given else "", (build_parser, _train))
    args = builder().parse_args(given[1:] if work is not _train else given)
    log_to_stderr(logging.INFO)
    return exit_status(lambda: work(args), program="std-train", debug=args.debug)


def _pack(args: argparse.Namespace) -> int:
    from benchmark.training.pack import PackOptions, pack_split

    options = PackOptions(
        size=tuple(args.size),
        depth=args.depth,
        color=args.color,
        shard=args.shard,
        nocs=args.nocs,
        raw=args.raw,
    )
    packed = pack_split(args.folder, args.split, args.data, options, job_options(args))
    print(f"{args.folder}: {packed.frames} frames")
    for key, error in packed.failed.items():
        print(f"error: {key}: {error}", file=sys.stderr)
    return 1 if packed.failed else 0


def _export(args: argparse.Namespace) -> int:
    _needs_torch()
    from benchmark.report.page import make_parts
    from benchmark.training.export import export_weights

    tables = [
        text
        for part in (make_parts(args.results) if args.results else [])
        for name, text in part.files.items()
        if name.endswith(".md")
    ]
    print(export_weights(args.run, args.out, scores="\n\n".join(tables)))
    return 0


def _recipe(args: argparse.Namespace) -> int:
    if args.name is not None:
        _needs_torch()
    return run_recipe(args)


def _train(args: argparse.Namespace) -> int:
    for name in ("method", "data", "out"):
        if not getattr(args, name):
            raise ToolkitError(
                "is needed", field=f"--{name}", hint="`std-train --help` tells all options"
            )
    _needs_torch()
    from benchmark.training.config import Machine
    from benchmark.training.fit import fit, process_rank
    from benchmark.training.plan import TrainWishes, plan_training

    if process_rank() > 0:  # the first of several processes tells for all
        logger.setLevel(logging.WARNING)
    wishes = TrainWishes(
        method=args.method,
        preset=args.preset,
        settings=_pairs(args.settings, "--set"),
        loss=_pairs(args.loss, "--loss"),
        data=args.data,
        validation=args.validation,
        hold_out=args.hold_out,
        share=args.share,
        steps=args.steps,
        epochs=args.epochs,
        phases=_steps(args.phases),
        optimizer=args.optimizer,
        decay=args.decay,
        batch_size=args.batch_size,
        learning_rate=args.learning_rate,
        weight_decay=args.weight_decay,
        accumulate=args.accumulate,
        precision=args.precision,
        seed=args.seed,
        colors=args.colors,
        geometry=args.geometry,
        holes=args.holes,
        validate_every=args.validate_every,
        checkpoint_every=args.checkpoint_every,
        weights=args.weights,
        imagenet=args.imagenet,
    )
    config, data, beginning = plan_training(wishes)
    logger.info(
        "%d frames to train on, %d to validate; %d steps of %d frames",
        len(data.of_training),
        len(data.of_validation),
        config.steps,
        config.optimization.batch_size,
    )
    machine = Machine(
        accelerator=args.accelerator,
        devices=args.devices,
        nodes=args.nodes,
        readers=args.readers,
        log_every=args.log_every,
        progress=sys.stderr.isatty(),
    )
    if args.engine == "ray":
        from benchmark.training.ray_launch import fit_on_ray

        best = fit_on_ray(args.out, wishes, machine, args.ray_address)
    else:
        best = fit(args.out, config, data, machine, beginning)
    if process_rank() > 0:
        return 0
    settings = " ".join(f"{name}={value}" for name, value in config.settings.items())
    told = f" --set {settings}" if settings else ""
    from benchmark.training.export import bench_command

    command = bench_command(args.method)
    print(f"{best}: {command} --preset {args.preset} --weights {best}{told}")
    return 0


def _steps(texts: Sequence[str]) -> dict[str, int]:
    found = {}
    for name, text in _pairs(texts, "--phases").items():
        try:
            found[name] = int(text)
        except ValueError:
            raise ToolkitError("expected a whole number", field="--phases", value=text) from None
    return found


def _needs_torch() -> None:
    from importlib.util import find_spec

    missing = [name for name in ("torch", "pytorch_lightning", "kornia") if not find_spec(name)]
    if missing:
        raise ToolkitError(
            f"training needs {', '.join(missing)}", hint="pip install 'std-toolkit[train]'"
        )


def _pairs(texts: Sequence[str], option: str) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise ToolkitError("expected NAME=VALUE", field=option, value=text)
        pairs[name] = value
    return pairs


_COMMANDS = {
    PACK: (build_pack_parser, _pack),
    PACK_GRASPS: (build_grasp_pack_parser, pack_grasps_command),
    EXPORT: (build_export_parser, _export),
    RECIPE: (build_recipe_parser, _recipe),
}

if __name__ == "__main__":
    sys.exit(main())
