"""Views of a small scene."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyvista")

from views_desk import Desk, write_scene


@pytest.fixture
def open_desk(tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    """Views of a scene; options of `write_scene` as a dict, of `Desk` as they are."""
    desks = []

    def start(scene: dict[str, Any] | None = None, **options: Any) -> Desk:
        root = tmp_path / f"scene{len(desks)}"
        desk = Desk(write_scene(root, **(scene or {})), **options)
        desks.append(desk)
        return desk

    yield start
    for desk in desks:
        desk.close()


@pytest.fixture
def desk(open_desk: Callable[..., Desk]) -> Desk:
    return open_desk()
