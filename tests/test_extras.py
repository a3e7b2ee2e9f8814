"""What each command imports is installed by what the guide tells the user to install.

The imports are read from the source (`import_closure`), what an extra installs from pyproject.toml
and the metadata of the installed packages.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from std_toolkit.cli.command import Command, Program
from std_toolkit.cli.programs import PROGRAMS
from std_toolkit.errors import EXTRAS
from tests.import_closure import Source

REPOSITORY = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
GUIDE = REPOSITORY / "docs" / "install.md"
_HINT = re.compile(r"std-toolkit\[([^]{]+)\]")

pytestmark = pytest.mark.slow


@cache
def installed_by(*extras: str) -> frozenset[str]:
    """Distributions that come with this one and some of its extras."""
    wanted = [line for extra in extras for line in PROJECT["optional-dependencies"][extra]]
    left = [Requirement(line) for line in (*PROJECT["dependencies"], *wanted)]
    seen: set[tuple[str, frozenset[str]]] = set()
    while left:
        requirement = left.pop()
        name = canonicalize_name(requirement.name)
        if (name, frozenset(requirement.extras)) in seen:
            continue
        seen.add((name, frozenset(requirement.extras)))
        try:
            further = [Requirement(line) for line in requires(name) or ()]
        except PackageNotFoundError:  # of another system
            continue
        chosen = ("", *requirement.extras)
        left += [
            r
            for r in further
            if r.marker is None or any(r.marker.evaluate({"extra": e}) for e in chosen)
        ]
    return frozenset(name for name, _ in seen)


@cache
def _distributions() -> dict[str, list[str]]:
    return {k: [canonicalize_name(n) for n in v] for k, v in packages_distributions().items()}


def not_installed(packages: set[str], *extras: str) -> set[str]:
    """Of top-level packages those that an installation with the extras does not have."""
    known = _distributions()
    return {
        p for p in packages if not installed_by(*extras) & set(known.get(p, [canonicalize_name(p)]))
    }


@cache
def source() -> Source:
    return Source(REPOSITORY)


def programs() -> list[Program]:
    return [import_module(module).PROGRAM for module in PROGRAMS.values()]


# Code that only commands of an extra run, though the source leads others there, too: reports read
# the records of the grasp task and the names of the methods, other asset sources make no shapes,
# and metrics of arrays no tensors.
ONLY_WITH = {
    "sim": (
        "benchmark.evaluation.tasks.grasp:plan_runs",
        "benchmark.evaluation.tasks.grasp_dump:GraspNetData",
        "benchmark.tabletop.trial:Trial",
        "sensors.assets.procedural.shape_library:_body",
    ),
    "train": ("benchmark.methods.registry:", "benchmark.metrics.depth.figures:namespace"),
}
COMMANDS = [(program, command) for program in programs() for command in program.commands]


def promised(program: str, command: str) -> set[str]:
    """The extras whose row in the guide names a command, its whole program, or an option of all."""
    found = set()
    for extra, use in re.findall(r"^\| `(\w+)` \| (.*?) \|", GUIDE.read_text("utf-8"), re.M):
        for words in re.findall(r"`((?:std-|--)[^`]+)`", use):
            name, *rest = words.split()
            of_command = not rest or rest[0] == command or rest[0].startswith("--")
            if name.startswith("--") or (name == program and of_command):
                found.add(extra)
    return found


def imports_of(program: Program, command: Command) -> dict[str, list[str]]:
    """Packages that a command may import, and the way to each."""
    extras = promised(program.name, command.name)
    closed = {c.run for p in programs() for c in p.commands} - {command.run}
    closed.update(place for extra in ONLY_WITH.keys() - extras for place in ONLY_WITH[extra])
    return source().third_party(command.run, command.options, without=closed)


def test_every_program_is_looked_at() -> None:
    assert {p.name for p in programs()} == set(PROJECT["scripts"])
    assert len(COMMANDS) > 30
    for place in (place for places in ONLY_WITH.values() for place in places):
        module, _, name = place.partition(":")
        assert name in {"", *vars(import_module(module))}


@pytest.mark.parametrize(
    ("program", "command"), COMMANDS, ids=[f"{p.name} {c.name}" for p, c in COMMANDS]
)
def test_the_guide_names_what_a_command_needs(program: Program, command: Command) -> None:
    imports = imports_of(program, command)
    assert "msgspec" in imports
    extras = promised(program.name, command.name)
    missing = sorted(not_installed(set(imports), *extras))
    assert not missing, f"with {extras}: " + "; ".join(
        f"no {name}: {' > '.join(imports[name])}" for name in missing
    )


def command(words: str) -> tuple[Program, Command]:
    return next((p, c) for p, c in COMMANDS if f"{p.name} {c.name}" == words)


def test_the_core_brings_the_compiler() -> None:
    """Rendering, checks and the BOP distances are compiled."""
    for words in ("std-curate render", "std-curate check", "std-bench bop"):
        assert "numba" in imports_of(*command(words))
    assert all(
        "numba" in installed_by(*extras) for extras in [(), ("restore",), ("gui",), ("web",)]
    )


def test_a_missing_requirement_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """numba was once in extras alone, and the plain installation did not render."""
    kept: dict[str, Any] = dict(PROJECT)
    kept["dependencies"] = [d for d in PROJECT["dependencies"] if not d.startswith("numba")]
    monkeypatch.setattr(f"{__name__}.PROJECT", kept)
    installed_by.cache_clear()
    try:
        with pytest.raises(AssertionError, match=r"no numba: .*ground_truth"):
            test_the_guide_names_what_a_command_needs(*command("std-curate render"))
    finally:
        installed_by.cache_clear()


def test_every_hint_names_an_extra_that_brings_the_package() -> None:
    wrong = []
    blocks = list(source().handled())
    assert len(blocks) >= 10
    for where, packages, handlers in blocks:
        hints = _HINT.findall(handlers)
        if hints:
            left = not_installed(packages, *(e for h in hints for e in h.split(",")))
        elif "missing_extra" in handlers:
            left = not_installed(packages - EXTRAS.keys())
        else:
            continue  # it goes on without
        if left:
            wrong.append(f"{where}: {hints} does not bring {left}")
    assert wrong == []


def test_every_module_of_the_table_comes_with_its_extra() -> None:
    for module, extra in EXTRAS.items():
        assert not not_installed({module}, extra), module
        assert not_installed({module}), f"{module} is in the core"


def test_every_extra_that_is_named_exists() -> None:
    pages = [*(REPOSITORY / "docs").glob("*.md"), REPOSITORY / "README.md"]
    texts = [path.read_text(encoding="utf-8") for path in (*source().files.values(), *pages)]
    named = {extra for text in texts for hint in _HINT.findall(text) for extra in hint.split(",")}
    assert {"restore", "sim"} <= named <= set(PROJECT["optional-dependencies"])
    rows = set(re.findall(r"^\| `(\w+)` \|", GUIDE.read_text(encoding="utf-8"), re.M))
    assert rows == set(PROJECT["optional-dependencies"]) - {"mutants"}
