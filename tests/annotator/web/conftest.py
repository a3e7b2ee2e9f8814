"""Servers for the tests of the browser front end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from scene_on_disk import write_scene
from serving import Served, start


@contextmanager
def _servers(folder: Path) -> Iterator[Callable[..., Served]]:
    running: list[Served] = []

    def begin(scene: Path | None = None, *options: str) -> Served:
        if scene is None:
            scene = folder / f"scene_{len(running)}"
            write_scene(scene)
        running.append(start(scene, folder / f"web_{len(running)}.log", *options))
        return running[-1]

    yield begin
    for server in running:
        if server.process.poll() is None:
            server.process.kill()
            server.process.wait()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Serves a small labelled scene, or the one given; all servers end with the test."""
    with _servers(tmp_path) as begin:
        yield begin


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One server of a small labelled scene for the tests of a module: none may count on where an
    earlier one left the object."""
    with _servers(tmp_path_factory.mktemp("served")) as begin:
        yield begin()
