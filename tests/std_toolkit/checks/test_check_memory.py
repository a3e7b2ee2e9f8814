"""What the check keeps of a frame, and what it reads at a time, does not grow with a recording."""

from __future__ import annotations

import errno
import os
import tracemalloc
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from toy_balls import Toy

from std_toolkit.checks import check_step
from std_toolkit.checks.measure import motion_solver
from std_toolkit.checks.measure.array_file import ArrayFile, FiledArray
from std_toolkit.checks.measure.coverage import measure_coverage
from std_toolkit.checks.measure.motion import MotionEquations, pooled_support
from std_toolkit.checks.measure.motion_solver import solve_motion
from std_toolkit.checks.measure.sensor_depth import ErrorTally
from std_toolkit.checks.measure.shared_errors import SharedErrors
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions
from std_toolkit.scene import Scene

POINTS = 100


def array_bytes(item: object) -> int:
    """Bytes of the arrays in memory that an item holds."""
    if isinstance(item, np.ndarray):
        return item.nbytes
    if isinstance(item, dict):
        return sum(map(array_bytes, item.values()))
    if isinstance(item, (list, tuple)):
        return sum(map(array_bytes, item))
    if is_dataclass(item):
        return sum(array_bytes(getattr(item, f.name)) for f in fields(item))
    return 0


@pytest.mark.parametrize("engine", ["serial", "local"])
def test_some_numbers_are_kept_of_a_frame(
    make_scene: Callable[[Toy], Scene], monkeypatch: pytest.MonkeyPatch, engine: str
) -> None:
    """Edges near two contours and histograms of depth errors take over 40 kB a frame."""
    kept = []
    judge = check_step.judge_scene

    def watched(scene, observed, *args, **more):  # type: ignore[no-untyped-def]
        kept.extend(observed)
        return judge(scene, observed, *args, **more)

    monkeypatch.setattr(check_step, "judge_scene", watched)
    jobs = JobOptions(engine=engine, workers=2, progress=False)  # type: ignore[arg-type]
    report = check_step.run_check(make_scene(Toy(frames=4)), jobs=jobs)
    assert report.objects[0].value("motion_mm") is not None and report.materials
    assert all(o.motion is not None for f in kept for o in f.objects.values())
    assert max(array_bytes(f) for f in kept) < 500


def frames_of_edges(count: int) -> list[MotionEquations]:
    """Contours 0.8 px and 0.002 rad off, with noise and edges of other things."""
    random = np.random.default_rng(3)
    motion = np.array([0.002, -0.001, 0.003, 0.01, -0.02, 0.005, 0.01])
    found = []
    for _ in range(count):
        jacobian = random.normal(0, [400, 400, 300, 40, 40, 40, 60], (POINTS, 7))
        offsets = np.stack([jacobian @ motion, *random.uniform(-15, 15, (3, POINTS))], axis=1)
        offsets += random.normal(0, 0.2, offsets.shape)
        offsets[::3, 3] = np.inf
        arrays = offsets, random.uniform(0.2, 1, offsets.shape), np.full(POINTS, 0.1), jacobian
        found.append(MotionEquations(*(a.astype(np.float32) for a in arrays), 500.0))
    return found


def test_equations_read_in_blocks_have_the_same_solution(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    equations = frames_of_edges(7)
    shared = SharedErrors(systematic=0.1, rim=0.3, foot=0.5, foot_part=0.5)
    whole = solve_motion(equations, with_size=True, shared=shared)
    assert whole is not None and whole.size == pytest.approx(0.01, abs=2e-3)
    support = pooled_support(equations, whole.vector)
    assert support.share > support.chance + 0.3
    monkeypatch.setattr(motion_solver, "_BLOCK_FRAMES", 3)
    with ArrayFile(tmp_path) as file:
        filed = [e.filed(file) for e in equations]
        assert pooled_support(filed, whole.vector) == support
        parts = solve_motion(filed, with_size=True, shared=shared)
    assert parts is not None
    assert parts.vector == pytest.approx(whole.vector, rel=1e-9)
    assert parts.covariance == pytest.approx(whole.covariance, rel=1e-9)
    assert (parts.size, parts.size_std, parts.residual_px, parts.gain) == pytest.approx(
        (whole.size, whole.size_std, whole.residual_px, whole.gain), rel=1e-9
    )


def test_the_memory_of_a_solution_does_not_grow_with_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_solver, "_BLOCK_FRAMES", 8)
    with ArrayFile(tmp_path) as file:
        filed = [e.filed(file) for e in frames_of_edges(64)]
        solve_motion(filed[:9])  # compiles
        largest = {}
        for count in (16, 64):
            tracemalloc.start()
            solve_motion(filed[:count])
            largest[count] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    # 48 more frames of 100 points have 0.6 MB of numbers in double precision.
    assert largest[64] < 1.1 * largest[16] + 20_000


def test_the_memory_of_view_directions_does_not_grow_with_pairs_of_views() -> None:
    random = np.random.default_rng(0)
    azimuth, elevation = random.uniform(0, 360, 4000), random.uniform(-20, 80, 4000)
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    d = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    widest = np.degrees(np.arccos((d @ d.T).min()))
    tracemalloc.start()
    found = measure_coverage(azimuth, elevation)
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found is not None and found.parallax_deg == pytest.approx(widest, abs=1e-6)
    assert largest < 20e6  # all pairs: 128 MB


def test_a_tally_in_a_file_counts_the_same(tmp_path: Path) -> None:
    tally, empty, total = ErrorTally(), ErrorTally(), ErrorTally()
    tally.add(np.full(70_000, 1.002), np.ones(70_000))  # more than 16 bits
    with ArrayFile(tmp_path) as file:
        for kept in (tally.filed(file), empty.filed(file), tally.filed(file)):
            total.merge(kept.load())
    assert total.histogram is not None
    assert total.histogram.max() == 140_000 and total.measured_pixels == 140_000
    assert total.sum_abs == 2 * tally.sum_abs


def test_a_file_of_arrays_has_no_name_and_returns_what_was_put(tmp_path: Path) -> None:
    arrays = [np.arange(6, dtype=np.float32).reshape(2, 3), np.zeros((0, 4)), np.array([7], "u1")]
    with ArrayFile(tmp_path / "new") as file:
        kept = [file.put(a) for a in arrays]
        assert not list((tmp_path / "new").iterdir())
        for entry, array in zip(kept, arrays, strict=True):
            found = np.asarray(entry)
            assert found.dtype == array.dtype and np.array_equal(found, array)
        assert np.asarray(kept[0], dtype=np.int64).dtype == np.int64


def test_a_file_of_arrays_that_was_cut_is_refused(tmp_path: Path) -> None:
    with ArrayFile(tmp_path) as file:
        kept = file.put(np.arange(8))
        longer = FiledArray(file, kept.start, (9,), kept.type)
        with pytest.raises(ToolkitError, match="cut short"):
            np.asarray(longer)


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with ArrayFile(tmp_path) as file:
        monkeypatch.setattr(os, "pwrite", full)
        with pytest.raises(ToolkitError, match="No space left on device") as error:
            file.put(np.arange(3))
    assert error.value.path == str(tmp_path)


def test_a_folder_that_cannot_hold_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ToolkitError, match="cannot write a temporary file") as error:
        ArrayFile(tmp_path / "file" / "inside")
    assert error.value.path == str(tmp_path / "file" / "inside")
