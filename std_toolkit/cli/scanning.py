"""Entry point of `std-scan`: the table of its commands."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from std_toolkit.cli.command import Command, Program
from std_toolkit.cli.command_options import UsageError

if TYPE_CHECKING:
    from std_toolkit.scanning.options import BoardCommand, ScanOptions


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command. Exit status: 0 done, 1 a failure, 2 wrong usage."""
    return PROGRAM.main(arguments)


def run_scan(options: ScanOptions) -> int:
    """Scan and print where the model is; 1 if the mesh must not be used."""
    import pycolmap  # noqa: F401, I001 - first: see `std_toolkit.libraries`

    import manifold3d  # noqa: F401 (without it a scan would fail at its end, after minutes)

    from std_toolkit.scanning.scan_step import scan

    if options.all_objects:
        return _run_all(options)
    result = scan(options)
    for line in result.warnings:
        print(f"warning: {line}", file=sys.stderr)
    print(f"{options.out / result.name}.obj: {len(result.faces)} faces")
    for name, value in result.facts.items():
        print(f"  {name}: {value}")
    print(f"report: {options.out / 'report.html'}")
    for fault in result.faults:
        print(f"error: the mesh must not be used: {fault}", file=sys.stderr)
    return 1 if result.faults else 0


def _run_all(options: ScanOptions) -> int:
    """Scan all objects and print what became of each; 1 if one has no mesh to use."""
    from std_toolkit.scanning.library import LIBRARY, in_total, scan_all

    library = scan_all(options)
    for one in library.objects:
        for line in one.warnings:
            print(f"warning: {one.name}: {line}", file=sys.stderr)
    for one in library.objects:
        print(f"{one.name}: {one.status}" + (f", {options.out / one.mesh}" if one.mesh else ""))
    print(f"overview: {options.out / 'report.html'}")
    print(f"library: {options.out / LIBRARY}; label with std-annotate SCENE --meshes {options.out}")
    wrong = [one for one in library.objects if one.status != "done"]
    for one in wrong:
        problem = one.problem if one.status == "failed" else f"must not be used: {one.problem}"
        print(f"error: {one.name}: {problem}; again alone: --pick {one.pick}", file=sys.stderr)
    if wrong:
        print(f"error: {in_total(library)}", file=sys.stderr)
    return 1 if wrong else 0


def make_board(command: BoardCommand) -> int:
    """Write the board and print what to do with it."""
    from std_toolkit.poses.board_sheet import write_board_pdf

    sheet, description = write_board_pdf(
        command.out, paper=command.paper, first_id=command.first_id, middle=command.middle
    )
    print(f"{sheet}: print at 100 %, check its ruler, and lay it flat")
    print(f"{description}: for --board")
    return 0


def with_command(words: list[str]) -> list[str]:
    """A folder or video as the first word is that of the photos, unless it is called as a command.

    Raises:
        UsageError: it could be both, or is neither.

    >>> with_command([".", "--out", "cup"])
    ['photos', '.', '--out', 'cup']
    """
    place = next((i for i, word in enumerate(words) if word[:1] != "-"), None)
    named = {command.name for command in PROGRAM.commands}
    if place is None:
        return words
    if not Path(words[place]).exists():
        if place == 0 and words[0] not in named:
            raise UsageError(
                f"{words[0]}: no such folder of photos, and no command of std-scan, whose commands "
                f"are {', '.join(sorted(named))}"
            )
        return words
    following = [Path(word) for word in words[place + 1 : place + 3]]
    if words[place] in named and following and following[0].is_dir():
        same = following[0].resolve() == Path(words[place]).resolve()
        if same or (len(following) == 2 and following[1].exists()):
            return words
        # The photos of this folder would be left out unnoticed.
        raise UsageError(
            f"{words[place]} is a folder here and a command; write ./{words[place]} for the folder"
        )
    return [*words[:place], "photos", *words[place:]]


def _command(name: str, about: str, options: str, run: str) -> Command:
    options = f"std_toolkit.scanning.options:{options}"
    return Command(name=name, about=about, options=options, run=f"std_toolkit.cli.scanning:{run}")


PROGRAM = Program(
    name="std-scan",
    about="Make a metric, watertight, textured CAD model of an object from photos.",
    commands=(
        _command(
            "photos",
            "make the model from photos of the object on the board (default)",
            "ScanOptions",
            "run_scan",
        ),
        _command("board", "make the board to print", "BoardCommand", "make_board"),
    ),
    default="photos",
    rewrite=with_command,
)


if __name__ == "__main__":
    sys.exit(main())
