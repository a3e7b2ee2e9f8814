"""Convex parts: they hold the shape, they are kept, and CoACD cannot hurt who asks for them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from sensors.assets import Asset, canonical_frame
from sensors.physics import convex_parts
from sensors.physics.convex import decompose

pytest.importorskip("coacd", reason="needs the extra [sim]")


def asset_of(mesh: trimesh.Trimesh) -> Asset:
    vertices, _ = canonical_frame(mesh.vertices, mesh.faces)
    return Asset(
        id="shape", category="other", mesh=trimesh.Trimesh(vertices, mesh.faces, process=False)
    )


def ring() -> Asset:
    return asset_of(trimesh.creation.annulus(0.4, 0.5, 0.3, sections=24))


def outside(parts: tuple[NDArray[np.float64], ...], points: NDArray[np.float64]) -> float:
    """How far the farthest of the points is from being inside any part."""
    planes = [ConvexHull(p).equations for p in parts]
    depth = [(points @ e[:, :3].T + e[:, 3]).max(axis=1) for e in planes]
    return float(np.min(depth, axis=0).max())


def fake_python(monkeypatch: pytest.MonkeyPatch, folder: Path, script: str) -> None:
    """What runs instead of the process of CoACD."""
    program = folder / "python"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr("sensors.physics.convex.sys.executable", str(program))


def test_a_convex_body_costs_no_decomposition(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    fake_python(monkeypatch, tmp_path, "exit 1")
    parts = convex_parts(asset_of(trimesh.creation.box((1, 2, 3))))
    assert len(parts) == 1 and len(parts[0]) == 8


def test_coarse_parts_are_the_hull_of_all_but_vessels(tmp_path: Path) -> None:
    # Two arms, which fill 0.71 of their hull.
    arms = [((0, 0, 0), (3, 1, 1)), ((0, 0, 0), (1, 3, 1))]
    corner = trimesh.boolean.union([trimesh.creation.box(bounds=arm) for arm in arms])
    shape, cache = asset_of(corner), tmp_path / "cache"
    fine = convex_parts(shape, cache)
    (hull,) = convex_parts(shape, cache, coarse=True)
    assert len(fine) > 1
    assert outside((hull,), shape.vertices) < 1e-6
    # The cache keeps them apart, and a vessel stays open.
    assert len(convex_parts(shape, cache)) == len(fine)
    assert len(convex_parts(ring(), cache, coarse=True)) >= 5


def test_parts_hold_the_surface_and_leave_the_hole_open(capfd: pytest.CaptureFixture[str]) -> None:
    shape = ring()
    parts = convex_parts(shape)
    assert len(parts) >= 5
    assert outside(parts, shape.vertices) < 1e-6
    # The bore is free but for the chords between the parts.
    inner = np.linalg.norm(shape.vertices[:, :2], axis=1).min()
    turn = np.linspace(0, 2 * np.pi, 100)
    free = 0.7 * inner * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    for part in parts:
        planes = ConvexHull(part).equations
        assert (free @ planes[:, :3].T + planes[:, 3]).max(axis=1).min() > 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_parts_are_kept_and_damaged_files_made_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shape, cache = ring(), tmp_path / "parts"
    first = convex_parts(shape, cache)
    (file,) = cache.glob("*.npz")
    good = file.read_bytes()
    for damage in (b"", good[:200], good[:-300] + b"\0" * 300):
        file.write_bytes(damage)
        again = convex_parts(shape, cache)
        assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
        assert file.read_bytes() == good
    # Kept ones need no CoACD at all.
    fake_python(monkeypatch, tmp_path, "exit 1")
    assert len(convex_parts(shape, cache)) == len(first)


WORKER = """
import sys
from pathlib import Path
import numpy as np, trimesh
from sensors.assets import Asset, canonical_frame
from sensors.physics import convex_parts
ring = trimesh.creation.annulus(0.4, 0.5, 0.3, sections=24)
v, _ = canonical_frame(ring.vertices, ring.faces)
shape = Asset(id="s", category="other", mesh=trimesh.Trimesh(v, ring.faces, process=False))
parts = convex_parts(shape, Path(sys.argv[1]))
print(len(parts), sum(float(p.sum()) for p in parts))
"""


def worker(cache: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", WORKER, cache], stdout=subprocess.PIPE, text=True
    )


@pytest.mark.slow
def test_workers_share_a_folder(tmp_path: Path) -> None:
    cache = tmp_path / "parts"
    workers = [worker(cache) for _ in range(3)]
    said = [w.communicate(timeout=100)[0] for w in workers]
    assert [w.returncode for w in workers] == [0, 0, 0]
    assert said[0] and len(set(said)) == 1
    assert len(list(cache.iterdir())) == 2  # the file and the folder of locks


@pytest.mark.slow
def test_a_killed_worker_leaves_nothing_that_harms(tmp_path: Path) -> None:
    cache = tmp_path / "parts"
    for wait in (0.0, 0.3):
        killed = worker(cache)
        deadline = time.monotonic() + 60
        while not list(cache.glob(".locks/*")) and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(wait)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
    assert len(convex_parts(ring(), cache)) >= 5
    assert [p.suffix for p in cache.iterdir() if p.name != ".locks"] == [".npz"]


def coacd_on_a_knot(source: Path, target: Path, *, seconds: int) -> subprocess.Popen[bytes]:
    """The process on a body that takes it a while."""
    knot = trimesh.creation.torus(1.0, 0.1, major_sections=120, minor_sections=40)
    np.savez(source, vertices=knot.vertices, faces=knot.faces, preprocess="off", threshold=0.08)
    return subprocess.Popen(
        [sys.executable, "-m", "sensors.physics.coacd_process", source, target, str(seconds)],
        stdin=subprocess.PIPE,
    )


@pytest.mark.slow
def test_the_process_has_its_limit_in_processor_time(tmp_path: Path) -> None:
    """A busy machine then gives the same parts as an idle one."""
    process = coacd_on_a_knot(tmp_path / "in.npz", tmp_path / "out.npz", seconds=1)
    with process:
        assert process.wait(200) == -signal.SIGXCPU
    assert not (tmp_path / "out.npz").exists()


def test_the_process_of_a_killed_caller_ends(tmp_path: Path) -> None:
    source, target = tmp_path / "in.npz", tmp_path / "work" / "out.npz"
    target.parent.mkdir()
    process = coacd_on_a_knot(source, target, seconds=300)
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(60) == 1
    assert not target.parent.exists()


@pytest.mark.parametrize(
    ("script", "lasting"),
    [("kill -ABRT $$", True), ("kill -KILL $$", False), ("kill -XCPU $$", True)],
)
def test_a_crash_of_coacd_leaves_the_hull(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    script: str,
    lasting: bool,
) -> None:
    fake_python(monkeypatch, tmp_path, f"echo noise; echo more >&2; {script}")
    shape, cache = ring(), tmp_path / "parts"
    with caplog.at_level("WARNING", logger="std_toolkit"):
        parts = convex_parts(shape, cache)
    assert "CoACD failed" in caplog.text and "convex hull" in caplog.text
    assert len(parts) == 1 and outside(parts, shape.vertices) < 1e-9
    # A kill is no verdict on the shape: the next one tries again.
    assert len(list(cache.glob("*.npz"))) == int(lasting)


def test_coacd_that_never_ends_is_ended(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake_python(monkeypatch, tmp_path, f"echo $$ > {tmp_path}/pid; exec sleep 100")
    shape = ring()
    monkeypatch.setattr("sensors.physics.convex._PATIENCE", 1)
    made = decompose(shape.vertices, shape.faces, time_limit_s=0.5)
    # A machine may be too busy: the next one tries again.
    assert len(made.parts) == 1 and not made.lasting
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_a_flat_surface_has_a_part_with_volume() -> None:
    sheet = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    (flat,) = convex_parts(asset_of(sheet))
    assert ConvexHull(flat).volume > 1e-5


@pytest.mark.slow
def test_parts_of_an_open_surface_are_no_thicker_than_it() -> None:
    """CoACD remeshes what is not closed, which makes it thicker: the object would hover."""
    corner = np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], dtype=float)
    walls = [[i, (i + 1) % 6, (i + 1) % 6 + 6] for i in range(6)]
    walls += [[i, (i + 1) % 6 + 6, i + 6] for i in range(6)]
    lids = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    vertices = np.concatenate([np.insert(corner, 2, z, axis=1) for z in (0.0, 1.0)])
    faces = np.concatenate([walls, lids[:, ::-1], lids + 6])
    assert trimesh.Trimesh(vertices, faces).is_watertight
    shape = asset_of(trimesh.Trimesh(vertices, faces[1:], process=False))
    parts = convex_parts(shape)
    assert len(parts) >= 2 and outside(parts, shape.vertices) < 1e-6
    corners = np.concatenate(parts)
    low, high = shape.mesh.bounds
    # Flat parts get a little thickness.
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [low, high], atol=3e-4)
    assert all(ConvexHull(p).volume > 0 for p in parts)
    # Points of the surface lie within the parts, but for gaps where two meet.
    points = shape.mesh.sample(3000, seed=0)
    depth = [
        (points @ e[:, :3].T + e[:, 3]).max(axis=1)
        for e in (ConvexHull(p).equations for p in parts)
    ]
    assert np.quantile(np.min(depth, axis=0), 0.98) < 2e-3


@pytest.mark.parametrize("hollow", [True, False])
def test_a_closed_hollow_is_filled(hollow: bool) -> None:
    shell = trimesh.creation.box((1, 1, 1))
    inner = trimesh.creation.box((0.8, 0.8, 0.8))
    inner.invert()
    mesh = trimesh.util.concatenate([shell, inner]) if hollow else shell
    (part,) = convex_parts(asset_of(mesh))
    assert ConvexHull(part).volume == pytest.approx(3**-1.5, rel=1e-6)
