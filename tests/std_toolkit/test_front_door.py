"""`import std_toolkit` offers the steps, and loads nothing before one is used."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import std_toolkit

HEAVY = ("numpy", "scipy", "cv2", "pycolmap", "open3d", "torch", "trimesh", "pydantic")
NAMES = [name for name in std_toolkit.__all__ if name != "__version__"]


def test_the_import_loads_no_library() -> None:
    code = f"import sys, std_toolkit; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_there(name: str) -> None:
    assert getattr(std_toolkit, name).__name__ == name


def test_names_are_offered_to_editors() -> None:
    assert set(std_toolkit.__all__) <= set(dir(std_toolkit))


def test_type_checkers_see_the_names_where_they_are() -> None:
    tree = ast.parse(Path(std_toolkit.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    found = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert sorted(found) == sorted(NAMES)
    for name, module in found.items():
        assert module is not None
        assert getattr(std_toolkit, name) is getattr(importlib.import_module(module), name)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="'std_toolkit' has no attribute 'scenery'"):
        _ = std_toolkit.scenery  # type: ignore[attr-defined]
    with pytest.raises(ImportError):
        importlib.import_module("std_toolkit.scenery")
