"""Every command of every program goes through one door: what it writes is guarded.

The tests walk the table of programs. A new command whose output says nothing of itself fails here,
and every output, input and plug-in option is attacked with the same set.
"""

from __future__ import annotations

import fcntl
import os
import stat
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from std_toolkit.cli.command import Command, Program, _load
from std_toolkit.cli.option_fields import MAPPINGS, option_fields
from std_toolkit.cli.programs import PROGRAMS
from std_toolkit.cli.programs import _load as program_of
from std_toolkit.jobs.door import Writes

# Options that name files or folders that are only read.
# Not required, but one of them is needed, or for another option.
ALSO_NEEDED = {"benchmark.evaluation.config:BopConfig": ("results", "program")}

INPUTS = {
    *(
        "--detections",
        "--verified",
        "--script",
        "A",
        "B",
        "SCENES",
        "--from",
        "--points",
        "--depth-from",
        "--meshes",
        "--scenes",
        "--dump",
        "--data",
        "SET",
    ),
    *("--results", "ROOT", "--root", "SOURCE", "--models", "--cameras", "--hand-eye", "--board"),
    *("--mesh", "--pose", "--correspondences", "RESULTS", "SOURCES", "--weights", "PHOTOS"),
    *("FLIPPED", "--masks", "--environment", "--list-file", "--assets-root", "--validation"),
    *("--imagenet", "RUN", "--validation-data", "RECORDINGS", "--sprayed"),
}
PLUG_INS = {"--method", "--renderer", "--depth", "--format", "--camera", "--planner", "--split"}


def of_path(kind: Any) -> bool:
    return kind is Path or any(of_path(part) for part in typing.get_args(kind))


def options() -> Iterator[tuple[Program, Command, Any]]:
    for name in PROGRAMS:
        program = program_of(name)
        for command in program.commands:
            for option in option_fields(_load(command.options)):
                yield program, command, option


EVERY = list(options())
OUTPUTS = [(p, c, o) for p, c, o in EVERY if "writes" in o.metadata]
READ = [(p, c, o) for p, c, o in EVERY if of_path(o.type) and "writes" not in o.metadata]
NAMED = [
    (p, c, o)
    for p, c, o in EVERY
    if o.title in PLUG_INS
    and str in (o.type, *typing.get_args(o.type))
    and typing.get_origin(o.type) not in MAPPINGS  # NAME=VALUE is no plug-in
]


# What commands need beside, unless one of the options is attacked.
BESIDE = {
    "std-annotate merge": {"--out --into": "--out {}/new"},
    "std-annotate open": {"SCENE": "{}/there"},
    "std-bench grasp": {"--data": "--data {}/there", "--dump": "--dump {}/there"},
    "std-bench order": {"--predictions": "--predictions x={}/there"},
    "std-record record": {"SCENE": "{}/there"},
    "std-restore live": {"--preview --out": "--preview {}/p.jpg"},
    "std-restore restore": {"SOURCES": "{}/there"},
    "std-train mine": {"--meshes --scenes": "--meshes {}/there"},
}
# Where the name of an output decides.
SUFFIXES = {"onnx": ".onnx", "out": ".safetensors"}


def title(value: Any) -> str:
    return str(getattr(value, "name", getattr(value, "title", value))).replace("/", "-")


def needed(command: Command, attacked: Any, folder: Path) -> list[str]:
    """Words for the options that a command needs, except one."""
    positional, named = [], []
    for option in option_fields(_load(command.options)):
        also = option.name in ALSO_NEEDED.get(command.options, ())
        if option.field == attacked.field or (option.default is not option_missing() and not also):
            continue
        kinds = [k for k in (option.type, *typing.get_args(option.type)) if k in (Path, int, float)]
        word = "1" if kinds else "x"
        if of_path(option.type):
            file = option.metadata.get("writes", Writes("new")).kind == "file"
            word = str(folder / f"there{SUFFIXES.get(option.name, '') if file else ''}")
        choices = typing.get_args(option.type)
        if typing.get_origin(option.type) is typing.Literal:
            word = str(choices[0])
        (named if option.name else positional).extend(
            [f"--{option.name}", word] if option.name else [word]
        )
    return [*positional, *named]


def option_missing() -> Any:
    import dataclasses

    return dataclasses.MISSING


def run(program: Program, command: Command, option: Any, value: Path | str, folder: Path) -> int:
    words = [command.name] if len(program.commands) > 1 else []
    given = [f"--{option.name}", str(value)] if option.name else [str(value)]
    rest = needed(command, option, folder)
    words += [*given, *rest] if not option.name else [*rest, *given]
    for other, more in BESIDE.get(f"{program.name} {command.name}", {}).items():
        if option.title not in other.split():
            words += [word.format(folder) for word in more.split()]
    return program.main(words)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "there").mkdir()
    return tmp_path


def refused(
    capsys: pytest.CaptureFixture[str], status: int, path: Path | str, words: str = ""
) -> None:
    err = capsys.readouterr().err
    assert status in (1, 2), err
    lines = [line for line in err.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, err
    assert "defect" not in lines[0]
    assert str(path) in lines[0], lines[0]
    assert words in lines[0], lines[0]


def test_every_path_is_an_input_or_says_how_it_is_written_to() -> None:
    wrong = [
        f"{program.name} {command.name} {option.title}"
        for program, command, option in EVERY
        if of_path(option.type) and option.title not in INPUTS and "writes" not in option.metadata
    ]
    assert not wrong, f"say `writes` in the metadata, or add to INPUTS: {wrong}"
    assert all(isinstance(o.metadata["writes"], Writes) for _, _, o in OUTPUTS)


@pytest.mark.parametrize(("program", "command", "option"), OUTPUTS, ids=title)
def test_an_output_is_no_pipe(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    pipe = place / f"pipe{SUFFIXES.get(option.name, '')}"
    os.mkfifo(pipe)
    refused(capsys, run(program, command, option, pipe, place), pipe, "pipe or device")
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize(("program", "command", "option"), [*READ, *NAMED], ids=title)
def test_an_input_is_no_pipe_and_no_device(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    pipe = place / "pipe.py"
    os.mkfifo(pipe)
    of_code = option.title in PLUG_INS
    for path in (pipe, Path("/dev/zero")):
        value = f"{path}:X" if of_code and path == pipe else path
        refused(capsys, run(program, command, option, value, place), path, "pipe or device")


@pytest.mark.parametrize(
    ("program", "command", "option"),
    [row for row in OUTPUTS if row[2].metadata["writes"].kind in ("new", "results")],
    ids=title,
)
def test_a_folder_of_the_user_is_left_alone(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    mine = place / "mine"
    mine.mkdir()
    (mine / "report.html").write_text("mine")
    refused(capsys, run(program, command, option, mine, place), mine)
    assert [p.name for p in mine.iterdir()] == ["report.html"]
    refused(capsys, run(program, command, option, Path("/"), place), "/: ")


@pytest.mark.parametrize(
    ("program", "command", "option"),
    [row for row in OUTPUTS if row[2].metadata["writes"].kind in ("new", "results", "parts")],
    ids=title,
)
def test_a_folder_is_no_file(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    mine = place / "mine.txt"
    mine.write_text("mine")
    refused(capsys, run(program, command, option, mine, place), mine)
    assert mine.read_text() == "mine"


@pytest.mark.parametrize(
    ("program", "command", "option"),
    [row for row in OUTPUTS if row[2].metadata["writes"].kind in ("results", "parts")],
    ids=title,
)
def test_a_link_within_an_output_is_not_written_through(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    out, outside = place / "out", place / "outside"
    outside.mkdir()
    (out / ".std").mkdir(parents=True)
    name = f"{program.name} {command.name}" if len(program.commands) > 1 else program.name
    (out / ".std" / f"{name.replace(' ', '-')}.lock").touch()
    (out / "depth").symlink_to(outside)
    refused(capsys, run(program, command, option, out, place), out / "depth", "symbolic link out")
    assert not list(outside.iterdir())


@pytest.mark.parametrize(
    ("program", "command", "option"),
    [row for row in OUTPUTS if row[2].metadata["writes"].kind in ("results", "files")],
    ids=title,
)
def test_one_program_at_a_time_writes_to_a_folder(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    out = place / "out"
    (out / ".std").mkdir(parents=True)
    name = f"{program.name}-{command.name}.lock"
    if option.metadata["writes"].kind == "files":
        name = "files.lock"
    with (out / ".std" / name).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        refused(capsys, run(program, command, option, out, place), out, "another process")


@pytest.mark.parametrize(
    ("program", "command", "option"),
    [row for row in OUTPUTS if row[2].metadata["writes"].kind == "file"],
    ids=title,
)
def test_a_file_is_no_folder(
    program: Program, command: Command, option: Any, place: Path, capsys: Any
) -> None:
    mine = place / f"mine{SUFFIXES.get(option.name, '')}"
    mine.mkdir()
    refused(capsys, run(program, command, option, mine, place), mine, "is a folder")
