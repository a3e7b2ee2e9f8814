"""Dropped objects lie still, apart from each other, the same for the same seed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dropped import check_settled, procedural_objects, simple_objects

from sensors.physics import PhysicalObject, SettleOptions, drift, settle, settle_from
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3, so3_exp

pytest.importorskip("mujoco", reason="needs the extra [sim]")


@pytest.fixture(scope="module")
def objects() -> list[PhysicalObject]:
    return simple_objects()


@pytest.fixture(scope="session")
def parts_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("parts")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_simple_bodies_settle(objects: list[PhysicalObject], seed: int) -> None:
    settled = settle(objects, seed)
    check_settled(objects, settled.poses)
    centres = np.array([T.t for T in settled.poses])
    assert np.abs(centres[:, :2]).max() < SettleOptions().half_width_m


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_procedural_scenes_settle(parts_folder: Path, seed: int) -> None:
    things = procedural_objects(seed, parts_folder)
    check_settled(things, settle(things, seed).poses)


def test_seeds_differ_and_repeat(objects: list[PhysicalObject]) -> None:
    first, again, other = (settle(objects, s) for s in (5, 5, 6))
    for a, b, c in zip(first.poses, again.poses, other.poses, strict=True):
        np.testing.assert_array_equal(a.matrix(), b.matrix())
        assert np.abs(a.t - c.t).max() > 1e-3


@pytest.mark.slow
def test_another_process_gives_the_same_bits(objects: list[PhysicalObject]) -> None:
    folder = Path(__file__).parent
    script = (
        f"import sys; sys.path.insert(0, {str(folder)!r})\n"
        "from dropped import simple_objects\n"
        "from sensors.physics import settle\n"
        "for T in settle(simple_objects(), 5).poses: print(T.matrix().tobytes().hex())\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder.parents[2],
    )
    assert run.stdout.split() == [T.matrix().tobytes().hex() for T in settle(objects, 5).poses]


def test_upright_objects_stand_beside_each_other(objects: list[PhysicalObject]) -> None:
    """y of a canonical frame is up; of dropped objects, most lie."""
    standing = []
    for seed in range(3):
        settled = settle(objects, seed, SettleOptions(upright=True))
        check_settled(objects, settled.poses)
        standing += [T.R[2, 1] > np.cos(np.deg2rad(5)) for T in settled.poses]
    assert np.mean(standing) >= 0.8
    crowded = settle(objects, 0, SettleOptions(upright=True, spread_m=0.01))
    check_settled(objects, crowded.poses)


def test_a_measured_arrangement_comes_to_rest(objects: list[PhysicalObject]) -> None:
    """Boxes put down 2 mm into the floor and 3 mm above it end on it, near where they were."""
    box = objects[0]
    upright = so3_exp([np.pi / 2, 0, 0])
    half = box.asset.mesh.extents[1] / 2 * box.diagonal_m
    starts = [SE3(upright, np.array([x, 0.0, half + dz])) for x, dz in ((0, -0.002), (0.2, 0.003))]
    poses = settle_from([box, box], starts)
    for start, end in zip(starts, poses, strict=True):
        assert end.t[2] == pytest.approx(half, abs=2e-4)
        assert np.linalg.norm(end.t[:2] - start.t[:2]) < 0.002
    check_settled([box, box], poses)


def test_an_object_in_the_air_drifts(objects: list[PhysicalObject]) -> None:
    """What `drift` measures is a fall where there is one: g t^2 / 2."""
    high = [SE3(np.eye(3), np.array([0.0, 0.0, 2.0]))]
    assert drift(objects[:1], high, 0.3) == pytest.approx(9.81 * 0.3**2 / 2, rel=0.02)


@pytest.mark.slow
def test_too_many_objects_for_the_floor_are_told(objects: list[PhysicalObject]) -> None:
    options = SettleOptions(half_width_m=0.05, attempts=2, longest_s=1.0)
    with pytest.raises(ToolkitError, match="did not settle in 2 attempts"):
        settle([*objects, *objects], 0, options)


def test_objects_without_rest_are_told(objects: list[PhysicalObject]) -> None:
    with pytest.raises(ToolkitError, match="come to rest"):
        settle_from(objects[:1], [SE3(np.eye(3), np.array([0.0, 0.0, 9.0]))], longest_s=0.3)


def test_bad_input() -> None:
    with pytest.raises(ToolkitError, match="no objects"):
        settle([], 0)
    with pytest.raises(ToolkitError, match="attempts"):
        SettleOptions(attempts=0)
    with pytest.raises(ToolkitError, match="half_width_m"):
        SettleOptions(half_width_m=0.0)
    asset = simple_objects()[0].asset
    with pytest.raises(ToolkitError, match="3 mm to 3 m"):
        PhysicalObject(asset, 120.0, (asset.vertices,))
    with pytest.raises(ToolkitError, match="convex part"):
        PhysicalObject(asset, 0.1, ())
