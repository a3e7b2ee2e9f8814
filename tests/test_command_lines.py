"""Help of every command: each option once, with a text, and soon."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys

import pytest

from annotator import cli as annotate
from benchmark.cli import bench, report, restore, train
from sensors.record import cli as record
from sensors.simulation import cli as simulate
from std_toolkit.cli import main as curate
from std_toolkit.cli import scanning as scan
from std_toolkit.cli.command import Command, Program
from tests.timings import UNIT, processor_time_of

MODULES = (curate, bench, train, report, restore, simulate, annotate, record, scan)
PROGRAMS: tuple[Program, ...] = tuple(module.PROGRAM for module in MODULES)
COMMANDS = [(program, command) for program in PROGRAMS for command in program.commands]


def words_of(program: Program, command: Command) -> list[str]:
    return [command.name, "--help"] if len(program.commands) > 1 else ["--help"]


@pytest.mark.parametrize(
    ("program", "command"), COMMANDS, ids=[f"{p.name} {c.name}" for p, c in COMMANDS]
)
def test_each_option_has_one_text(
    program: Program, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        program.main(words_of(program, command))
    assert end.value.code == 0
    page = capsys.readouterr().out
    # An option begins its line; its text follows there or below.
    names = re.findall(r"^  \[?(?:-h, )?(--?[\w-]+|[A-Z_]+)", page, re.M)
    assert len(names) == len(set(names)) >= 5
    texts = re.split(r"^  (?=\S)", page.partition("options\n")[2], flags=re.M)[1:]
    for text in texts:
        told = re.sub(r"^\S+|\{.*?\}|\((default: .*|required)\)", "", text, flags=re.S)
        assert re.search(r"\b[a-z]{2,}", told), text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "words", "units"),
    [
        (module.__name__, words, units)
        for module, program in zip(MODULES, PROGRAMS, strict=True)
        for words, units in [
            # Where there are commands, the overview needs no parser.
            (["--help"], 2.0 if len(program.commands) > 1 else 5.0),
            *((words_of(program, command), 5.0) for command in program.commands),
        ]
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else str(value),
)
def test_help_takes_little_processor_time(module: str, words: list[str], units: float) -> None:
    code = f"import sys; from {module} import main; sys.exit(main({words}))"
    taken, unit = [], []
    # The least counts: other processes on the machine make the same work take longer.
    while not taken or (min(taken) > units * min(unit) and len(taken) < 15):
        unit.append(processor_time_of(UNIT))
        taken.append(processor_time_of(code))
    assert min(taken) <= units * min(unit), (taken, unit)


@pytest.mark.parametrize("words", ["--help", "priors --help", "list splits"])
def test_a_reader_that_stops_early_is_no_error(words: str) -> None:
    """As `std-bench --help | head`."""
    program = shlex.join([sys.executable, "-m", "benchmark.cli.bench"])
    line = f"{program} {words} | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
