"""Choosing a renderer where GL is missing, broken or bound to something else."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.rendering import choose
from std_toolkit.rendering.choose import ANSWER_VARIABLE, choose_renderer, find_gl, get_renderer
from std_toolkit.rendering.renderer import Renderer
from tests.skips import need_gl

PINHOLE = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
LENS = Camera(640, 480, 600.0, 600.0, 320.0, 240.0, (0.1, 0.0, 0.0, 0.0))


@pytest.fixture
def fresh_probe(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """Forget what was found before, and forget again afterwards."""
    monkeypatch.setenv(ANSWER_VARIABLE, "")
    find_gl.cache_clear()
    yield monkeypatch
    find_gl.cache_clear()


@pytest.fixture
def notices(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    texts: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            texts.append(record.getMessage())

    logger = logging.getLogger("std_toolkit")
    monkeypatch.setattr(logger, "handlers", [Keep()])
    level = logger.level
    logger.setLevel(logging.INFO)  # forgets what it answered at another level
    yield texts
    logger.setLevel(level)


def test_no_gl_gives_the_ray_caster_with_a_notice(
    fresh_probe: pytest.MonkeyPatch, notices: list[str]
) -> None:
    fresh_probe.setenv(ANSWER_VARIABLE, "none")
    assert choose_renderer("pyrender", cameras=[PINHOLE]) == "raycast"
    assert any("cannot create a GL context" in text for text in notices)


def test_a_probe_that_crashes_harms_nobody(
    fresh_probe: pytest.MonkeyPatch, notices: list[str]
) -> None:
    fresh_probe.setattr(choose, "_PROBE", "import os; os.abort()")
    fresh_probe.setattr(choose, "loaded_platform", lambda: None)
    fresh_probe.delenv("PYOPENGL_PLATFORM", raising=False)
    platform, reason = find_gl()
    assert platform is None
    assert "exit status" in reason
    assert choose_renderer("pyrender") == "raycast"
    assert notices


def test_a_platform_that_cannot_be_used_is_not_tried(fresh_probe: pytest.MonkeyPatch) -> None:
    fresh_probe.setattr(choose, "loaded_platform", lambda: None)
    fresh_probe.setenv("PYOPENGL_PLATFORM", "glx")
    fresh_probe.setattr(choose, "_probe", lambda _: pytest.fail("was tried"))
    platform, reason = find_gl()
    assert platform is None
    assert "glx" in reason


def test_distortion_gives_the_ray_caster_with_a_notice(notices: list[str]) -> None:
    assert choose_renderer("pyrender", cameras=[PINHOLE, LENS]) == "raycast"
    assert any("distortion" in text for text in notices)


def test_asked_for_renderers_are_kept() -> None:
    assert choose_renderer("raycast", cameras=[LENS]) == "raycast"
    with pytest.raises(ToolkitError, match="known: pyrender, raycast"):
        choose_renderer("povray")


def test_plug_ins_are_renderers(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "std_toolkit.rendering.raycast:RaycastRenderer"
    assert choose_renderer(name, cameras=[LENS]) == name
    assert isinstance(get_renderer(name), Renderer)
    with pytest.raises(ToolkitError, match="not a renderer"):
        get_renderer("std_toolkit.rendering.mesh:_unit".replace("_unit", "OrderedDict"))


@pytest.mark.slow
def test_gl_that_pyrender_can_use_is_found() -> None:
    """A renderer that draws wrongly must not pass for a machine without GL."""
    need_gl("egl")
    environment = {**os.environ, "PYOPENGL_PLATFORM": "egl"}
    code = "from std_toolkit.rendering.choose import find_gl; print(find_gl())"
    environment.pop(ANSWER_VARIABLE, None)
    found = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    assert found.stdout.startswith("('egl'"), found.stdout + found.stderr


def test_the_platform_that_is_loaded_is_the_only_one_tried(
    fresh_probe: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def probe(platform: str) -> None:
        tried.append(platform)

    fresh_probe.setattr(choose, "_probe", probe)
    fresh_probe.delenv("PYOPENGL_PLATFORM", raising=False)
    for loaded in ("osmesa", "egl"):
        fresh_probe.setattr(choose, "loaded_platform", lambda loaded=loaded: loaded)
        fresh_probe.setenv(ANSWER_VARIABLE, "")
        find_gl.cache_clear()
        assert find_gl()[0] == loaded
    assert tried == ["osmesa", "egl"]
