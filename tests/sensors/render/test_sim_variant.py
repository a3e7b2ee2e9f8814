"""The choice of a variant survives crashes of the ones that do not work."""

from __future__ import annotations

import logging
import sys

import numpy as np
import pytest

from sensors.render import variant as choosing
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera

WORKS = f"print({choosing.DONE!r})"
ABORTS = (
    "import os, sys; print('LLVM ERROR: Cannot select: f32 = fminimum', file=sys.stderr);"
    "sys.stderr.flush(); os.abort()"
)


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    monkeypatch.delenv(choosing.ANSWER_VARIABLE, raising=False)
    # Set by the choice itself: make monkeypatch take it away again.
    monkeypatch.setenv(choosing.ANSWER_VARIABLE, "")
    choosing.try_variant.cache_clear()
    yield
    choosing.try_variant.cache_clear()


def children(monkeypatch, **by_variant):
    """Let the child process of each variant run other code."""
    table = repr(by_variant).replace("{", "{{").replace("}", "}}")
    script = f"code = {table}; exec(code[{{variant!r}}])"
    monkeypatch.setattr(choosing, "_TEST", script)
    monkeypatch.setattr(choosing, "_has_cuda", lambda: "cuda_ad_rgb" in by_variant)


def test_an_aborting_compiler_only_rules_itself_out(monkeypatch, caplog) -> None:
    children(monkeypatch, llvm_ad_rgb=ABORTS, scalar_rgb=WORKS)
    with caplog.at_level(logging.WARNING, logger="std_toolkit"):
        assert choosing.choose_variant() == "scalar_rgb"
    assert "LLVM ERROR: Cannot select" in caplog.text
    assert "libllvm19" in caplog.text


def test_the_first_that_works_is_taken_and_remembered(monkeypatch) -> None:
    children(monkeypatch, cuda_ad_rgb=WORKS, llvm_ad_rgb=ABORTS, scalar_rgb=ABORTS)
    assert choosing.choose_variant() == "cuda_ad_rgb"
    children(monkeypatch, llvm_ad_rgb=WORKS, scalar_rgb=WORKS)
    assert choosing.choose_variant() == "cuda_ad_rgb"  # workers inherit the answer


def test_where_nothing_works_every_reason_is_told(monkeypatch) -> None:
    children(monkeypatch, llvm_ad_rgb=ABORTS, scalar_rgb="import no_such_renderer")
    with pytest.raises(ToolkitError, match=r"no CUDA driver.*LLVM ERROR.*no_such_renderer"):
        choosing.choose_variant()


def test_silence_is_no_success(monkeypatch) -> None:
    children(monkeypatch, scalar_rgb="pass")
    assert "status 0" in str(choosing.try_variant("scalar_rgb"))


def test_a_wanted_variant_is_tested_too(monkeypatch) -> None:
    children(monkeypatch, llvm_ad_rgb=ABORTS)
    with pytest.raises(ToolkitError, match="does not work here"):
        choosing.choose_variant("llvm_ad_rgb")


@pytest.mark.slow
def test_the_real_test_runs_here() -> None:
    assert choosing.try_variant("scalar_rgb") is None
    assert "mitsuba" not in vars(sys.modules[choosing.__name__])


@pytest.mark.slow
def test_the_gpu_makes_the_images_of_the_processor() -> None:
    """The same kernels on CUDA; skipped, with the reason, where there is no GPU."""
    problem = choosing.try_variant("cuda_ad_rgb")
    if problem is not None:
        pytest.skip(f"cuda_ad_rgb: {problem}")
    from sensors.render.mitsuba_renderer import MitsubaRenderer
    from sensors.render.sim_renderer import RenderOptions
    from sensors.render.sim_scene import Projector
    from sensors.render.smoke import looking_down, smallest_scene

    camera = Camera(96, 64, 90.0, 90.0, 47.5, 31.5)
    T, options = looking_down(), RenderOptions(samples=64, chunk=1)
    projector = Projector(np.ones((8, 8), np.float32), 90.0, T)
    found = []
    for variant in ("llvm_ad_rgb", "cuda_ad_rgb"):
        loaded = MitsubaRenderer(variant=variant, check=False).load(smallest_scene())
        infrared = loaded.infrared(camera, T, projector, ambient=0.2, options=options)
        color = loaded.color(camera, T, ambient=1.0, options=options)
        found.append((infrared, color.radiance.mean(axis=2)))
    for processor, gpu in zip(*found, strict=True):
        assert abs(gpu.mean() / processor.mean() - 1) < 0.02
        assert np.corrcoef(gpu.ravel(), processor.ravel())[0, 1] > 0.95
