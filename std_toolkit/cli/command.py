"""Programs of several commands: a table, the overview, exit status, one-line errors.

A command names a dataclass of options and a function that takes an instance of it, both as
`module:name`, so that `PROGRAM --help` imports neither. `command_options` reads the options.

Exit status of every program: 0 done, 1 failed or a gate failed, 2 wrong usage, 130 interrupted
(SIGINT), 143 terminated (SIGTERM).
"""

import gc
import importlib
import logging
import os
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from std_toolkit.cli.command_options import (
    UsageError,
    parse_options,
    print_completion,
    values_of,
)
from std_toolkit.errors import ToolkitError, is_interrupt, missing_extra
from std_toolkit.jobs.interrupt import GRACE_S, ended_by_signals, status_after
from std_toolkit.log import log_to_stderr
from std_toolkit.plugins import error_of_plugin

WRONG_USAGE = 2
SHELLS = ("bash", "zsh", "fish")
COMPLETION = "--print-completion"
_EVERYWHERE = ("--quiet", "--debug")


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of a program.

    Attributes:
        name: the word that chooses it, or two words of a group: "project create".
        about: one line for the help of the program.
        options: `module:Class` of its options, a dataclass.
        run: `module:function` that takes the options and returns the exit status (None is 0).
    """

    name: str
    about: str
    options: str
    run: str


@dataclass(frozen=True, kw_only=True)
class Program:
    """A console script.

    Attributes:
        name: what the user types.
        about: one paragraph for `--help`.
        commands: in the order of use.
        default: name of the command that runs if the first word names none; "" to require one.
        rewrite: converts the words of older command lines.
        on_interrupt: how to go on, printed after SIGINT (Ctrl-C) or SIGTERM.
        grace_s: seconds from such a signal until the process ends in any case; None for a program
            that finishes what it has begun.
    """

    name: str
    about: str
    commands: tuple[Command, ...]
    default: str = ""
    rewrite: Callable[[list[str]], list[str]] | None = None
    on_interrupt: str = "run the same command again to resume"
    grace_s: float | None = GRACE_S

    def main(
        self, arguments: Sequence[str] | None = None, *, is_process: bool | None = None
    ) -> int:
        """Run one command; returns the exit status and raises `SystemExit` for `--help` only.

        Args:
            arguments: words after the name; None takes those of the process.
            is_process: whether the process ends with this program, in any case after a signal;
                None if `arguments` are those of the process.
        """
        words = list(sys.argv[1:] if arguments is None else arguments)
        is_process = arguments is None if is_process is None else is_process
        if is_process:
            # Libraries make many objects that stay. To look for garbage after every 700 of them, as
            # Python does by default, takes up to 4 % of the processor time.
            gc.set_threshold(20_000)
        message = f"interrupted; {self.on_interrupt}"
        signals: list[int] = []
        try:
            with ended_by_signals(message, grace_s=self.grace_s if is_process else None) as signals:
                return self._main(words if self.rewrite is None else self.rewrite(words))
        except UsageError as error:
            print(f"error: {error}", file=sys.stderr)
            return WRONG_USAGE
        except BrokenPipeError:
            # `std-curate info SCENE | head` is not an error.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except BaseException as error:
            if not signals and not is_interrupt(error):
                raise
            # Before the command began: its options, and libraries, were imported.
            print("interrupted; nothing was begun", file=sys.stderr)
            return status_after(signals)

    def _main(self, words: list[str]) -> int:
        words = self._joined(words)
        first = next((word for word in words if word not in _EVERYWHERE), None)
        alone = len(self.commands) == 1
        named = {} if alone else {command.name: command for command in self.commands}
        chosen = named.get(first or "")
        if chosen is None and first == "--version":
            from std_toolkit import __version__

            print(f"std-toolkit {__version__}")
            return 0
        if chosen is None and first == COMPLETION:
            return self._print_completion(words[words.index(COMPLETION) + 1 :])
        if alone:
            return self._run(self.commands[0], words)
        if chosen is None and (first in ("-h", "--help") or (first is None and not self.default)):
            print(self.help())
            return 0 if first else WRONG_USAGE
        if chosen is None and any(name.startswith(f"{first} ") for name in named):
            group = [name for name in named if name.startswith(f"{first} ")]
            if {"-h", "--help"} & {*words}:
                print(self.help(group))
                return 0
            raise UsageError(f"{first}: expected one of {', '.join(group)}")
        if chosen is None:
            if not self.default or (first and first[0] != "-" and first.replace("-", "").isalpha()):
                reason = f"no command of {self.name}; expected one of {', '.join(named)}"
                raise UsageError(f"{first}: {reason}")
            chosen, rest = named[self.default], words
        else:
            place = words.index(chosen.name)
            rest = [*words[:place], *words[place + 1 :]]
        return self._run(chosen, rest)

    def _joined(self, words: list[str]) -> list[str]:
        """The words, where the two of a command in a group are one."""
        places = [i for i, word in enumerate(words) if word not in _EVERYWHERE][:2]
        pair = " ".join(words[i] for i in places)
        if len(places) < 2 or not any(command.name == pair for command in self.commands):
            return words
        return [pair, *(word for i, word in enumerate(words) if i not in places)]

    def _title(self, command: Command) -> str:
        return self.name if len(self.commands) == 1 else f"{self.name} {command.name}"

    def _run(self, command: Command, words: list[str]) -> int:
        options, common = parse_options(_load(command.options), words, self._title(command))
        log_to_stderr(logging.WARNING if common.quiet else logging.INFO)
        from std_toolkit.jobs.door import opened

        if common.limits is not None:
            from std_toolkit.settings import use

            try:
                use(read_settings(common.limits))
            except ToolkitError as error:
                raise UsageError(str(error)) from error

        def run() -> int:
            with opened(values_of(options), self._title(command)):
                return _load(command.run)(options) or 0

        return exit_status(
            run,
            program=self.name,
            debug=common.debug,
            on_interrupt=self.on_interrupt,
        )

    def help(self, group: Sequence[str] = ()) -> str:
        """The overview: what the program is for and its commands, or those of a group."""
        shown = [command for command in self.commands if not group or command.name in group]
        width = max(len(command.name) for command in shown) + 2
        lines = [f"usage: {self.name} COMMAND [OPTIONS]", "", self.about, "", "commands:"]
        lines += [f"  {command.name:{width}}{command.about}" for command in shown]
        lines += [
            "",
            "options:",
            f"  COMMAND --help{'':{max(width - 14, 1)}}options of a command",
            "  --version",
            f"  {COMPLETION} {{{','.join(SHELLS)}}}",
        ]
        if self.default:
            lines += ["", f"Without COMMAND: `{self.name} {self.default}`."]
        return "\n".join(lines)

    def _print_completion(self, words: list[str]) -> int:
        if len(words) != 1 or words[0] not in SHELLS:
            raise UsageError(f"{COMPLETION}: expected one of {', '.join(SHELLS)}")
        kinds = {c.name: _load(c.options) for c in self.commands}
        print_completion(kinds, words[0], self.name)
        return 0


def print_json(value: Any) -> None:
    """Print lists, dicts, dataclasses and Structs as JSON; NaN and infinity as null."""
    import msgspec

    print(msgspec.json.format(msgspec.json.encode(value)).decode())


def exit_status(
    run: Callable[[], int],
    *,
    program: str,
    debug: bool = False,
    on_interrupt: str = "run the same command again to resume",
    grace_s: float | None = None,
) -> int:
    """Run a command. Exit status: what it returns, 1 for an error, 130 or 143 after a signal.

    Args:
        program: name of the program, for the hint of an unexpected error.
        debug: let exceptions pass, with their traceback.
        on_interrupt: how to go on, printed after SIGINT (Ctrl-C) or SIGTERM.
        grace_s: see `ended_by_signals`; None within `Program.main`, which has its own.
    """
    signals: list[int] = []
    try:
        with ended_by_signals(f"interrupted; {on_interrupt}", grace_s=grace_s) as signals:
            status = int(run())
            if signals and status:
                raise KeyboardInterrupt  # what failed may have failed by that
            return status
    except BaseException as error:
        # A library may turn an interrupt into an error or an exit of its own.
        if not signals and not is_interrupt(error):
            return _failure(error, program, debug)
    print(f"interrupted; {on_interrupt}", file=sys.stderr)
    return status_after(signals)


def _failure(error: BaseException, program: str, debug: bool) -> int:
    """Report an error in one line; raises it again if it is none of the command, or to debug it."""
    plugin = error_of_plugin(error)
    ends = not isinstance(error, Exception) and plugin is None
    if debug or isinstance(error, BrokenPipeError) or ends:
        raise error
    if isinstance(error, ToolkitError):
        shown: BaseException | str = error
    elif plugin is not None and not isinstance(error, OSError) and missing_extra(error) is None:
        shown = plugin
    elif isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        shown = f"{where}{error.strerror or error}"
    elif (outside := _outside_of_the_toolkit(error)) is not None:
        shown = outside
    elif missing_extra(error) is None and (guess := error_of_plugin(error, in_use=True)):
        shown = guess
    else:  # a bug in the toolkit: still one line, and how to get the traceback
        shown = missing_extra(error) or ToolkitError(
            f"unexpected {type(error).__name__}: {error}",
            hint=f"a defect of std-toolkit; `{program} --debug ...` prints the traceback",
        )
    print(f"error: {shown}", file=sys.stderr)
    return 1


def _outside_of_the_toolkit(error: BaseException) -> ToolkitError | None:
    """The error for names that no file can have, and for memory that is used up; else None."""
    said = str(error)
    if isinstance(error, RuntimeError) and (found := re.match("Symlink loop from '(.*)'", said)):
        return ToolkitError("is a link that leads to itself", path=found[1])
    if isinstance(error, ValueError) and said.startswith("embedded null"):
        return ToolkitError("a file or folder is named with a zero byte")
    if isinstance(error, MemoryError):
        hint = "use smaller images or meshes, fewer --workers, or a computer with more"
        return ToolkitError(f"the memory does not suffice: {said or 'none left'}", hint=hint)
    return None


def _load(reference: str) -> Any:
    module, _, name = reference.partition(":")
    return getattr(importlib.import_module(module), name)


def read_settings(path: Path) -> tuple[Any, ...]:
    """The limits in a TOML file, as `std-curate settings` prints them.

    Raises:
        ToolkitError: the file cannot be read, or what `settings_of` raises.
    """
    from std_toolkit.io.foreign_files import read_toml
    from std_toolkit.settings import settings_of

    try:
        tables = read_toml(path, dict[str, Any])
    except ToolkitError as error:
        raise error.revised(hint="`std-curate settings` prints such a file") from error
    return settings_of(tables, path)
