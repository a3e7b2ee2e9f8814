"""`std-curate info`: what a scene holds, what it lacks, what comes next."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "info",
        help="print what a scene holds and lacks",
        description="Print what a scene holds, what it lacks, and the command that comes next.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE")
    parser.add_argument("--json", action="store_true", help="print the same as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    from std_toolkit.cli.summary import summarise
    from std_toolkit.scene.scene import Scene

    summary = summarise(Scene.open(args.scene))
    if args.json:
        import dataclasses
        import json

        data = dataclasses.asdict(summary)
        data["root"] = str(summary.root)
        print(json.dumps(data, indent=2))
    else:
        print("\n".join(summary.lines()))
    return 0
