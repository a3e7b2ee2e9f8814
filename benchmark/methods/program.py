"""Programs of other environments that are run as methods: started, watched and ended as a group."""

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from benchmark.methods.registry import COMMAND
from std_toolkit.errors import ToolkitError

_TAIL = 300  # characters of the program's last words in an error
_LOOK_S = 0.5
_GRACE_S = 2.0  # from SIGTERM to SIGKILL
_MOST_OUTPUT_BYTES = 512 * 2**20
# Programs that leave the work to a server, which does not end with them.
_CONTAINERS = ("docker", "podman", "nerdctl")


def words_of_command(command: str, folder: str) -> list[str]:
    """Return program and arguments of `command:PROGRAM ARGUMENTS`.

    Args:
        command: what follows `command:`.
        folder: the place for the folder of frames; added as the last argument if it is missing.

    Raises:
        ToolkitError: no program, or quotes that do not close.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise ToolkitError(f"not a command: {error}", field="--method", value=command) from error
    if not words:
        raise ToolkitError(
            "needs a program", field="--method", value=COMMAND, hint=f"{COMMAND}docker run ..."
        )
    return words if any(folder in word for word in words) else [*words, folder]


def run_program(
    words: Sequence[str], logs: Path, timeout_s: float, *, hint: str, option: str = "--method"
) -> None:
    """Run a program in a group of its own, which ends with it; its output goes to files.

    Args:
        words: program and arguments.
        logs: folder for its output.
        timeout_s: seconds after which it is stopped.
        hint: how more time is given.
        option: that names the program.

    Raises:
        ToolkitError: it cannot be started, fails, takes too long, or prints without end.
    """
    out, errors = logs / "stdout", logs / "stderr"
    try:
        with out.open("wb") as to_out, errors.open("wb") as to_errors:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=to_out, stderr=to_errors,
                start_new_session=True,
            )  # fmt: skip
    except FileNotFoundError as error:
        raise ToolkitError("no such program", field=option, value=words[0]) from error
    except (OSError, ValueError) as error:
        raise ToolkitError(f"cannot start the command: {error}", value=words[0]) from error
    if Path(words[0]).name in _CONTAINERS:
        hint += f"; its container may still run: see `{words[0]} ps`"
    try:
        status = _wait(process, (out, errors), words[0], timeout_s, hint)
    finally:
        _end_group(process.pid)
    if status:
        said = (_tail(errors).strip() or _tail(out).strip())[-_TAIL:]
        raise ToolkitError(
            f"the command ended with status {status}: {' '.join(said.split())}", value=words[0]
        )


def _wait(
    process: subprocess.Popen[bytes],
    outputs: Sequence[Path],
    program: str,
    timeout_s: float,
    hint: str,
) -> int:
    """The status of the program.

    Raises:
        ToolkitError: it takes too long, or prints without end.
    """
    ends = time.monotonic() + timeout_s
    while True:
        left = ends - time.monotonic()
        try:
            return process.wait(timeout=min(_LOOK_S, max(left, 0)))
        except subprocess.TimeoutExpired:
            if left <= _LOOK_S:
                raise ToolkitError(
                    f"the command took longer than {timeout_s:g} s", value=program, hint=hint
                ) from None
        if sum(path.stat().st_size for path in outputs) > _MOST_OUTPUT_BYTES:
            raise ToolkitError(
                f"the command printed more than {_MOST_OUTPUT_BYTES // 2**20} MB",
                value=program, hint="is it in a loop?",
            )  # fmt: skip


def _tail(path: Path) -> str:
    """The last words of a program."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 4 * _TAIL))
        return file.read().decode(errors="replace")


def _end_group(leader: int) -> None:
    """End what is left of a group of processes: politely, then in any case."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(leader, number)
        except ProcessLookupError:
            return
        ends = time.monotonic() + _GRACE_S
        while time.monotonic() < ends and _is_group(leader):
            time.sleep(0.05)


def _is_group(leader: int) -> bool:
    with suppress(ChildProcessError):
        os.waitpid(leader, os.WNOHANG)  # one that has ended would count
    try:
        os.killpg(leader, 0)
    except ProcessLookupError:
        return False
    return True
