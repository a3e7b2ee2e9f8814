"""A real window on a small scene, and hands that press its keys and answer its questions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("pyvistaqt")

from bench import Bench
from pytestqt.qtbot import QtBot
from window_scene import write_window_scene


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Opening a window takes a second, so tests with one are slow."""
    for item in items:
        if "open_bench" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def own_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The list of recent scenes of whoever runs the tests stays as it is."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A scene of six frames with camera poses and two objects, one of them labelled."""
    return write_window_scene(tmp_path / "scene")


@pytest.fixture
def open_bench(qtbot: QtBot) -> Iterator[Callable[..., Bench]]:
    """Opens windows, and closes them after the test; unsaved edits stay in the journal."""
    benches: list[Bench] = []

    def start(root: Path | None = None, **options: object) -> Bench:
        bench = Bench(qtbot, **options)  # type: ignore[arg-type]
        benches.append(bench)
        if root is not None:
            bench.open(root)
        return bench

    yield start
    for bench in benches:
        bench.leave()


@pytest.fixture
def bench(open_bench: Callable[..., Bench], root: Path) -> Bench:
    """A window with the scene open, its views drawn and in full detail."""
    return open_bench(root)
