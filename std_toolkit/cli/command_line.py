"""The flags of the job layer, the same for every command that works over frames."""

from __future__ import annotations

import argparse

from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.options import ENGINES


def add_job_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("where the work runs")
    group.add_argument("--workers", type=int, help="processes at a time (default: usable cores)")
    group.add_argument("--engine", choices=ENGINES, default="local")
    group.add_argument("--ray-address", help="address of a running Ray cluster")


def job_options(args: argparse.Namespace) -> JobOptions:
    return JobOptions(engine=args.engine, workers=args.workers, ray_address=args.ray_address)
