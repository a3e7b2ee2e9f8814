"""Toy scenes for the tests of the checks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from toy_balls import Toy, write_toy

from std_toolkit.scene import Scene


@pytest.fixture()
def make_scene(tmp_path: Path) -> Callable[[Toy], Scene]:
    """Writes a toy scene with true poses and labels into a new folder."""
    made = 0

    def make(toy: Toy) -> Scene:
        nonlocal made
        made += 1
        return write_toy(tmp_path / f"toy{made}", toy)

    return make
