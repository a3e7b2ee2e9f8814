"""`std-bench`: score depth restorers, pose methods and grasp planners."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from std_toolkit.cli.command import Command, Program, print_json

if TYPE_CHECKING:
    from benchmark.evaluation.config import BopConfig, NetworkConfig
    from benchmark.methods.pose.priors.options import PriorsCommand


@dataclass(frozen=True, kw_only=True)
class ListOptions:
    """List the methods or the splits that there are."""

    what: Literal["methods", "splits"]
    """what to list"""
    task: Literal["depth", "pose", "grasp"] = "depth"
    """whose methods"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class CheckDataOptions:
    """Report which files of a split are there and which are missing."""

    root: Path
    """folder above the data sets, or of the split"""
    splits: tuple[str, ...] = field(metadata={"option": "split"})
    """names of `std-bench list splits`"""
    json: bool = False
    """print JSON"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return PROGRAM.main(arguments)


def score(config: NetworkConfig | BopConfig) -> int:
    """Score methods or result files; returns the exit status."""
    from benchmark.evaluation.evaluate import score_config

    scored = score_config(config)
    if config.json:
        print_json(scored.records)
    elif scored.results:
        print(scored.table)
    for title, error in scored.campaign.failed.items():
        print(f"error: {title}: {error}", file=sys.stderr)
    return 1 if scored.campaign.failed or scored.campaign.failed_frames else 0


def list_names(options: ListOptions) -> int:
    """Print methods or splits with a line about each; returns the exit status."""
    import inspect

    from benchmark.methods.registry import METHODS
    from std_toolkit.errors import ToolkitError

    about: dict[str, str] = {}
    if options.what == "splits":
        from benchmark.data.splits import get_split, splits

        about = {name: get_split(name).about for name in splits.names()}
    else:
        methods = METHODS[options.task]
        for name in methods.names():
            try:
                about[name] = (inspect.getdoc(methods.get(name)) or "").partition("\n")[0]
            except ToolkitError as error:
                about[name] = f"not usable here: {error.problem}"
        if options.task == "grasp":
            about["oracle"] = "Knows where the objects are: what can be reached at all."
    if options.json:
        print_json([{"name": name, "about": text} for name, text in about.items()])
    else:
        width = 24 if options.what == "splits" else 16
        print("\n".join(f"{name:{width}} {text}" for name, text in about.items()))
    return 0


def check_data(options: CheckDataOptions) -> int:
    """Print what of some splits is there; returns the exit status."""
    from benchmark.data.check import check_split

    reports = [check_split(options.root, name) for name in options.splits]
    if options.json:
        print_json([report.record() for report in reports])
    else:
        print("\n".join(report.text() for report in reports))
    return 0 if all(report.is_complete for report in reports) else 1


def write_priors(options: PriorsCommand) -> int:
    """Make shape priors; returns the exit status."""
    from benchmark.methods.pose.priors.make_priors import make_priors
    from benchmark.methods.pose.priors.prior_file import save_priors
    from std_toolkit.log import logger

    priors = make_priors(options)
    save_priors(options.out, priors)
    logger.info("%s: %d categories", options.out, len(priors.points))
    return 0


def _command(name: str, about: str, options: str, run: Callable[[Any], int]) -> Command:
    return Command(
        name=name, about=about, options=options, run=f"benchmark.cli.bench:{run.__name__}"
    )


_CONFIG = "benchmark.evaluation.config"
PROGRAM = Program(
    name="std-bench",
    about="Score methods that restore depth, and what rests on depth: poses and grasps. What is\n"
    "scored already is kept: run the same command again to resume. `std-report` makes tables and\n"
    "pages of the results.",
    commands=(
        _command("depth", "score depth restorers", f"{_CONFIG}:DepthConfig", score),
        _command("pose", "score category-level pose methods", f"{_CONFIG}:PoseConfig", score),
        _command("grasp", "clear tables in simulation", f"{_CONFIG}:GraspConfig", score),
        _command(
            "bop", "score result files of instance-level poses", f"{_CONFIG}:BopConfig", score
        ),
        _command("list", "list methods or splits", "benchmark.cli.bench:ListOptions", list_names),
        _command(
            "check-data",
            "report what of a split is there, and what is missing",
            "benchmark.cli.bench:CheckDataOptions",
            check_data,
        ),
        _command(
            "priors",
            "make the shape priors of spd and sgpa from meshes",
            "benchmark.methods.pose.priors.options:PriorsCommand",
            write_priors,
        ),
    ),
    default="depth",
)

if __name__ == "__main__":
    sys.exit(main())
