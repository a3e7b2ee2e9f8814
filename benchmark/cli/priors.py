"""`std-bench priors`: mean shapes of categories, from meshes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from std_toolkit.cli.command import exit_status
from std_toolkit.log import logger


def build_parser() -> argparse.ArgumentParser:
    """The parser; imports no heavy library."""
    parser = argparse.ArgumentParser(
        prog="std-bench priors",
        description="Make the shape priors that spd and sgpa deform: the mean shape of every "
        "category of a collection of meshes. Give them to `std-train` by --set priors=FILE; "
        "trained weights hold them.",
    )
    add = parser.add_argument
    add("--assets", default="builtin", help="builtin, shapenet, folder, or another asset source")
    add("--root", type=Path, metavar="DIR", help="its files")
    add("--unit", choices=("m", "cm", "mm"), help="of the files, where they tell real sizes")
    add("--split", choices=("train", "test", "all"), default="train", help="of shapes (train)")
    add("--categories", nargs="+", metavar="NAME", help="all but distractors where not given")
    add("--instances", type=int, default=50, metavar="N", help="shapes of a category (50)")
    add("--points", type=int, default=1024, metavar="N", help="of a prior (1024)")
    add(
        "--how",
        choices=("autoencoder", "barycentre"),
        default="autoencoder",
        help="mean embedding of an auto-encoder, as published, or mean by optimal transport",
    )
    add("--epochs", type=int, default=50, metavar="N", help="of the auto-encoder (50)")
    add("--seed", type=int, default=0)
    add("--device", default="cpu", metavar="NAME", help="of the auto-encoder")
    add("--out", type=Path, required=True, metavar="FILE", help="such as priors.safetensors")
    add("--debug", action="store_true", help="show the traceback of an error")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Entry point; returns the exit status."""
    args = build_parser().parse_args(arguments)
    return exit_status(
        lambda: _run(args),
        program="std-bench",
        debug=args.debug,
        on_interrupt="nothing was written",
    )


def _run(args: argparse.Namespace) -> int:
    from benchmark.methods.pose.priors.make_priors import PriorOptions, make_priors
    from benchmark.methods.pose.priors.prior_file import save_priors
    from std_toolkit.errors import ToolkitError

    if args.out.suffix != ".safetensors":
        raise ToolkitError("priors are kept as *.safetensors", path=args.out)
    priors = make_priors(
        PriorOptions(
            assets=args.assets,
            root=args.root,
            unit=args.unit,
            split=args.split,
            categories=tuple(args.categories) if args.categories else None,
            instances=args.instances,
            points=args.points,
            how=args.how,
            epochs=args.epochs,
            seed=args.seed,
            device=args.device,
        )
    )
    save_priors(args.out, priors)
    logger.info("%s: %d categories", args.out, len(priors.points))
    return 0
