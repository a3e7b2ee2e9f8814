"""What an installation holds: every file that the packages need, and every program."""

from __future__ import annotations

import importlib
import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("std_toolkit", "annotator", "sensors", "benchmark")


@pytest.fixture
def project() -> dict[str, Any]:
    return tomllib.loads((REPOSITORY / "pyproject.toml").read_text())


def package_of(path: Path) -> Path:
    """The folder of the innermost package that holds a file."""
    return next(p for p in path.parents if (p / "__init__.py").is_file())


def test_files_beside_the_modules_are_installed(project: dict[str, Any]) -> None:
    """Pages, styles and scripts are left out of a wheel unless they are named."""
    patterns: dict[str, list[str]] = project["tool"]["setuptools"]["package-data"]
    files = [
        path
        for name in PACKAGES
        for path in (REPOSITORY / name).rglob("*")
        if path.is_file() and path.suffix not in (".py", ".pyc") and "__pycache__" not in path.parts
    ]
    assert files
    left_out = []
    for path in files:
        package = package_of(path)
        name = ".".join(package.relative_to(REPOSITORY).parts)
        wanted = [*patterns["*"], *patterns.get(name, [])]
        # setuptools' * ends at a folder.
        inner = path.relative_to(package).as_posix()
        if not any(fnmatchcase(inner, p) and inner.count("/") == p.count("/") for p in wanted):
            left_out.append(str(path.relative_to(REPOSITORY)))
    assert left_out == []


def test_every_folder_with_modules_is_a_package() -> None:
    folders = {p.parent for name in PACKAGES for p in (REPOSITORY / name).rglob("*.py")}
    assert [f for f in folders if not (f / "__init__.py").is_file()] == []


def test_every_program_can_be_called(project: dict[str, Any]) -> None:
    programs: dict[str, str] = project["project"]["scripts"]
    assert "std-annotate" in programs
    for target in programs.values():
        module, _, function = target.partition(":")
        assert callable(getattr(importlib.import_module(module), function))
