"""How a command ends: its exit status, and an error as one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from std_toolkit.errors import ToolkitError


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
