"""Command lines made from option dataclasses."""

from __future__ import annotations

import enum
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import msgspec
import pytest

from std_toolkit.cli.command import Command, Program
from std_toolkit.cli.command_options import parse_options, words_of
from std_toolkit.errors import ToolkitError


class Policy(enum.Enum):
    AUTO = "auto"
    MODELS = "models"


@dataclass(frozen=True, kw_only=True)
class Jobs:
    workers: Annotated[int | None, msgspec.Meta(ge=1)] = None
    """processes at a time"""
    bar: bool = field(default=True, metadata={"option": None})


@dataclass(frozen=True, kw_only=True)
class Named:
    """Options whose names are not those of their fields."""

    split: tuple[str, ...] = field(metadata={"option": "split"})
    """which splits"""
    settings: tuple[str, ...] = field(default=(), metadata={"option": "set"})
    """a method's own"""
    phases: Mapping[str, int] = field(default_factory=dict)
    """steps of each phase"""
    jobs: Jobs = field(default_factory=lambda: Jobs(workers=3, bar=False))

    def __post_init__(self) -> None:
        if not self.split:
            raise ToolkitError("needs at least one value", field="split")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Draw the objects of a scene."""

    scene: Path
    """scene folder"""
    policy: Policy = Policy.AUTO
    """which renderer"""
    share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
    """of the frames"""
    jobs: Jobs = field(default_factory=Jobs)


CALLS: list[Options] = []


def draw(options: Options) -> None:
    CALLS.append(options)


def refuse(options: Options) -> int:
    raise ToolkitError("no poses", path=options.scene)


def gate(options: Options) -> int:
    return 1


def program(*names: str, default: str = "") -> Program:
    return Program(
        name="std-draw",
        about="Draw scenes.",
        commands=tuple(
            Command(
                name=name,
                about=f"to {name}",
                options=f"{__name__}:Options",
                run=f"{__name__}:{name}",
            )
            for name in names or ("draw", "refuse", "gate")
        ),
        default=default,
    )


@pytest.fixture(autouse=True)
def _no_calls() -> None:
    CALLS.clear()


def test_nested_options_are_flat_and_enums_go_by_value() -> None:
    words = ["draw", "scene", "--policy", "models", "--workers", "2", "--share", "1"]
    assert program().main(words) == 0
    assert [
        Options(scene=Path("scene"), policy=Policy.MODELS, share=1.0, jobs=Jobs(workers=2))
    ] == CALLS


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["draw"], "SCENE"),
        (["draw", "s", "--policy", "nothing"], "expected one of auto, models"),
        (["draw", "s", "--share", "x"], "--share"),
        (["draw", "s", "--wrong", "1"], "--wrong"),
        (["draw", "s", "--share"], "--share: expected FLOAT"),
        (["draw", "s", "--share", "1.5"], "--share: must be at most 1 (got 1.5)"),
        (["draw", "s", "--workers", "0"], "--workers: must be at least 1 (got 0)"),
        (["drew", "s"], "drew: no command of std-draw; expected one of draw, refuse, gate"),
        (["--print-completion", "cmd"], "expected one of bash, zsh, fish"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program().main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert told in error
    assert error.count("\n") == 1
    assert not CALLS


def test_failures_and_failed_gates_are_status_1(capsys: pytest.CaptureFixture[str]) -> None:
    assert program().main(["refuse", "s"]) == 1
    assert capsys.readouterr().err.startswith("error: ")
    assert program().main(["gate", "s"]) == 1


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (RuntimeError("Symlink loop from '/a/b.mtl'"), "/a/b.mtl: is a link that leads to itself"),
        (ValueError("embedded null byte"), "named with a zero byte"),
        (MemoryError("Unable to allocate 8 GiB"), "memory does not suffice: Unable to allocate 8"),
    ],
)
def test_odd_names_and_full_memory_are_no_defects(
    error: Exception, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: Options) -> int:
        raise error

    monkeypatch.setattr(sys.modules[__name__], "refuse", fail)
    assert program().main(["refuse", "s"]) == 1
    said = capsys.readouterr().err
    assert told in said and "defect" not in said and said.count("\n") == 1


def test_metadata_name_require_and_hide_options(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--split", "a", "b", "--set", "x=1", "--phases", "one=3", "two=4"]
    options, _ = parse_options(Named, words, "std-draw")
    assert options == Named(split=("a", "b"), settings=("x=1",), phases={"one": 3, "two": 4})
    assert options.jobs == Jobs(workers=3, bar=False)
    with pytest.raises(SystemExit):
        parse_options(Named, ["--help"], "std-draw")
    page = capsys.readouterr().out
    assert "--set" in page
    assert "a method's own" in page
    assert "--set STR ..." in page
    assert "bar" not in page


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "--split: needed"),
        (["--split"], "at least one"),
        (["--split", "a", "--phases", "one"], "--phases: expected NAME=VALUE"),
        (["--split", "a", "--phases", "one=x"], "--phases: expected NAME=INT"),
    ],
)
def test_what_options_refuse_themselves_is_wrong_usage(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = Command(name="n", about="", options=f"{__name__}:Named", run=f"{__name__}:gate")
    assert Program(name="std-n", about="", commands=(command,)).main(words) == 2
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "options",
    [
        Options(scene=Path("a b"), policy=Policy.MODELS, share=0.25, jobs=Jobs(workers=2)),
        Named(split=("a", "b"), phases={"one": 3}, jobs=Jobs(workers=4, bar=False)),
    ],
)
def test_words_of_options_are_parsed_to_them(options: Options | Named) -> None:
    assert parse_options(type(options), words_of(options), "std-draw")[0] == options


def test_default_command_takes_what_names_none() -> None:
    assert program(default="draw").main(["--share", "0", "s"]) == 0
    assert [options.share for options in CALLS] == [0]


def test_help_tells_commands_and_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert program().main(["--help"]) == 0
    assert "to refuse" in capsys.readouterr().out
    with pytest.raises(SystemExit) as end:
        program().main(["draw", "--help"])
    assert end.value.code == 0
    page = capsys.readouterr().out
    assert "of the frames" in page
    assert "processes at a time" in page


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        program().main(["--print-completion", shell])
    except SystemExit as end:
        assert not end.code
    assert "refuse" in capsys.readouterr().out


def test_overview_imports_neither_parser_nor_commands() -> None:
    code = (
        "import sys\nfrom std_toolkit.cli.command import Command, Program\n"
        "c = Command(name='c', about='', options='no:O', run='no:f')\n"
        "Program(name='p', about='', commands=(c, c)).main(['--help'])\n"
        "sys.exit('tyro' in sys.modules)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.DEVNULL).returncode == 0


class Scene(msgspec.Struct, frozen=True, kw_only=True):
    """Options that are written to a file, too."""

    views: int = 3
    """frames"""
    hidden: Annotated[int, msgspec.Meta(extra={"option": None})] = 4


@dataclass(frozen=True, kw_only=True)
class Collected:
    size: tuple[int, int] = field(default=(4, 3), metadata={"size": True})
    """of images"""
    names: tuple[str, ...] = field(default=(), metadata={"option": "name", "repeat": True})
    """may be repeated"""
    take: Mapping[str, str] = field(default_factory=dict, metadata={"repeat": True})
    """may be repeated"""
    sets: Mapping[str, str] = field(default_factory=dict, metadata={"option": "set"})
    """several after the option"""
    scene: Scene = field(default_factory=lambda: Scene(hidden=5))


def test_sizes_repeated_options_and_structs() -> None:
    words = ["--name", "a", "--size", "8x6", "--name", "b", "--take", "m=A", "--take", "n=B"]
    options, _ = parse_options(Collected, [*words, "--views", "2"], "std-draw")
    expected = Collected(
        size=(8, 6), names=("a", "b"), take={"m": "A", "n": "B"}, scene=Scene(views=2, hidden=5)
    )
    assert options == expected
    assert parse_options(Collected, [], "std-draw")[0] == Collected()
    both, _ = parse_options(Collected, ["--set", "m=A", "n=B"], "std-draw")
    assert both.sets == {"m": "A", "n": "B"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--size", "large"], "--size: expected a size such as 1280x720"),
        (["--take", "m=A", "--take", "m=B"], "--take: given twice"),
        (["--set", "m=A", "--set", "n=B"], "--set: given twice"),
        (["--hidden", "1"], "--hidden"),
    ],
)
def test_wrong_sizes_and_pairs_are_wrong_usage(
    words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = Command(name="n", about="", options=f"{__name__}:Collected", run=f"{__name__}:gate")
    assert Program(name="std-n", about="", commands=(command,)).main(words) == 2
    assert told in capsys.readouterr().err
