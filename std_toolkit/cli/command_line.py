"""What all commands share: the flags of the job layer, exit status, an error as one line.

The flags of the job layer, the same for every command that works over frames.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable

from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.options import ENGINES


def exit_status(
    run: Callable[[], int],
    *,
    program: str,
    debug: bool = False,
    on_interrupt: str = "run the same command again to go on",
) -> int:
    """Run a command. Exit status: what it returns, 1 for an error, 130 if it was interrupted.

    Args:
        program: name of the program, for the advice on a defect of ours.
        debug: let errors through, with their traceback.
        on_interrupt: what Ctrl-C means for the work done so far.
    """
    try:
        return int(run())
    except ToolkitError as error:
        if debug:
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # `std-curate info SCENE | head` is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if debug:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"error: {where}{error.strerror or error}", file=sys.stderr)
        return 1
    except Exception as error:  # a defect of ours: still one line, and how to tell us more
        if debug:
            raise
        shown = ToolkitError(
            f"unexpected {type(error).__name__}: {error}",
            hint=f"a defect of std-toolkit; `{program} --debug ...` shows where",
        )
        print(f"error: {shown}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted; {on_interrupt}", file=sys.stderr)
        return 130


def add_job_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("where the work runs")
    group.add_argument("--workers", type=int, help="processes at a time (default: usable cores)")
    group.add_argument("--engine", choices=ENGINES, default="local")
    group.add_argument("--ray-address", help="address of a running Ray cluster")


def job_options(args: argparse.Namespace) -> JobOptions:
    return JobOptions(engine=args.engine, workers=args.workers, ray_address=args.ray_address)
