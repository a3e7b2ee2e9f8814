"""Putting objects onto a plane."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.synthetic.shapes import bottle, bowl, can, default_shapes, mug
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, mssd, rotation_angle, so3_exp
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.labels.support.plane import Plane, snap_to_plane
from std_toolkit.labels.support.solid import solid_of

GROUND = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
CARTON = trimesh.creation.box((0.06, 0.04, 0.1))
CAN = can(0.034, 0.102)
# Open at the top, of one sheet, and with a face that is missing in its side.
OPEN_BOX = trimesh.Trimesh(CARTON.vertices, CARTON.faces[3:], process=False)
UPRIGHT = so3_exp([np.pi / 2, 0, 0])  # shapes have y up
TWISTS = st.lists(st.floats(-1, 1), min_size=6, max_size=6)
MESHES = {
    "carton": CARTON,
    "open box": OPEN_BOX,
    "can": CAN,
    "mug": mug(0.042, 0.095),
    "bowl": bowl(0.068, 0.055),
    "bottle": bottle(0.035, 0.19),
    "ball": trimesh.creation.icosphere(3, 0.04),
}


def lowest(mesh: trimesh.Trimesh, T: SE3, plane: Plane) -> float:
    return float(plane.signed_distance(T @ np.asarray(mesh.vertices)).min())


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(MESHES)), TWISTS, TWISTS)
def test_a_dropped_object_touches_and_only_moves_along_the_normal(
    name: str, pose: list[float], slope: list[float]
) -> None:
    mesh, T = MESHES[name], SE3.exp(pose)
    plane = Plane(SE3.exp(slope).R[2], 0.2)
    once = snap_to_plane(mesh, T, plane)
    assert lowest(mesh, once, plane) == pytest.approx(0, abs=1e-9)
    assert (once.R == T.R).all()
    assert np.cross(once.t - T.t, plane.normal) == pytest.approx(np.zeros(3), abs=1e-9)
    twice = snap_to_plane(mesh, once, plane)
    assert twice.t == pytest.approx(once.t, abs=1e-12)


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(MESHES)), TWISTS, TWISTS)
def test_resting_twice_is_resting_once(name: str, pose: list[float], slope: list[float]) -> None:
    mesh, plane = MESHES[name], Plane(SE3.exp(slope).R[2], 0.2)
    once = snap_to_plane(mesh, SE3.exp(pose), plane, mode="rest", largest_tilt=np.pi)
    assert lowest(mesh, once, plane) == pytest.approx(0, abs=1e-9)
    twice = snap_to_plane(mesh, once, plane, mode="rest")
    assert rotation_angle(once.R.T @ twice.R) < 1e-7
    assert twice.t == pytest.approx(once.t, abs=1e-8)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(MESHES)), TWISTS, TWISTS, st.sampled_from(["drop", "rest"]))
def test_moving_table_and_object_together_moves_the_result(
    name: str, pose: list[float], motion: list[float], mode: str
) -> None:
    mesh, T, G = MESHES[name], SE3.exp(pose), SE3.exp(motion)
    options = {"mode": mode, "largest_tilt": np.pi}
    here = snap_to_plane(mesh, T, GROUND, **options)
    there = snap_to_plane(mesh, G @ T, GROUND.moved(G, "elsewhere"), **options)
    error = mssd((G.inverse() @ there), here, np.asarray(mesh.vertices))
    # Two facets may be equally near: the object then lies on either of them.
    turned = rotation_angle(T.R.T @ here.R)
    assert error < 1e-7 or turned == pytest.approx(rotation_angle((G @ T).R.T @ there.R), abs=1e-6)


def test_a_tilted_carton_comes_to_lie_flat_by_the_smallest_turn() -> None:
    tilt = np.radians(20)
    T = SE3(so3_exp([tilt, 0, 0]), np.array([0.3, 0.1, 0.4]))
    rested = snap_to_plane(CARTON, T, GROUND, mode="rest")
    assert pytest.approx(np.eye(3), abs=1e-9) == rested.R
    assert rested.t == pytest.approx([0.3, 0.1, 0.05], abs=1e-9)


def test_a_can_on_its_side_keeps_its_roll() -> None:
    """The hull of a can has 96 narrow sides: laying it onto one of them would turn its texture."""
    for roll in np.radians([0.0, 0.7, 1.3, 2.9]):
        lying = so3_exp([0.0, roll, 0.0])  # its axis y is level
        tilted = so3_exp([0.0, 0.0, 0.0]) @ so3_exp([np.radians(8), 0, 0]) @ lying
        level = snap_to_plane(CAN, SE3(tilted, np.zeros(3)), GROUND, mode="rest")
        axis = level.R[:, 1]
        assert abs(axis[2]) < 1e-3
        # The turn was about a level axis across the can: no roll in it.
        turn = tilted.T @ level.R
        assert np.degrees(rotation_angle(turn)) == pytest.approx(8, abs=0.05)


def test_a_ball_lies_as_it_is() -> None:
    T = SE3(so3_exp([0.3, 0.2, 0.1]), np.array([0.0, 0.0, 0.3]))
    rested = snap_to_plane(MESHES["ball"], T, GROUND, mode="rest")
    assert (rested.R == T.R).all()


def test_a_bowl_stands_on_its_foot_or_on_its_rim() -> None:
    mesh = MESHES["bowl"]
    for up in (1, -1):
        tilted = so3_exp([np.radians(25), 0, 0]) @ so3_exp([up * np.pi / 2, 0, 0])
        rested = snap_to_plane(mesh, SE3(tilted, np.zeros(3)), GROUND, mode="rest")
        assert rested.R[:, 1] == pytest.approx([0, 0, up], abs=1e-6)


def test_what_lies_far_from_any_rest_is_refused_with_the_angle() -> None:
    edge_on = SE3(so3_exp([np.radians(40), 0, 0]), np.zeros(3))
    with pytest.raises(ToolkitError, match=r"turn by 40 degrees .* the limit is 30"):
        snap_to_plane(CARTON, edge_on, GROUND, mode="rest")
    with pytest.raises(ToolkitError, match="unknown mode"):
        snap_to_plane(CARTON, edge_on, GROUND, mode="throw")  # type: ignore[arg-type]


def test_a_toppling_position_is_no_rest() -> None:
    """A sheet of cardboard does not stand on its edge."""
    sheet = trimesh.creation.box((0.2, 0.3, 0.002))
    assert {tuple(np.abs(d).round(6)) for d in solid_of(sheet).resting.down} == {(0, 0, 1)}


def test_a_flat_mesh_lies_on_either_side() -> None:
    board = trimesh.Trimesh([[0, 0, 0], [0.2, 0, 0], [0.2, 0.3, 0], [0, 0.3, 0]], [[0, 1, 2]])
    rested = snap_to_plane(board, SE3.exp([0, 0, 1, 0.3, 0.1, 0]), GROUND, mode="rest")
    assert abs(rested.R[2, 2]) == pytest.approx(1)


@pytest.mark.parametrize("shape", default_shapes(), ids=lambda s: s.name)
def test_upright_objects_stay_upright(shape) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        error = so3_exp(rng.normal(0, np.radians(4), 3))
        rested = snap_to_plane(
            shape.mesh, SE3(error @ UPRIGHT, np.array([0, 0, 0.3])), GROUND, mode="rest"
        )
        assert np.degrees(np.arccos(min(1.0, rested.R[2, 1]))) < 0.01
        assert rested.t[2] == pytest.approx(shape.mesh.extents[1] / 2, abs=1e-6)


@pytest.mark.real
@pytest.mark.parametrize(
    "name", ["003_cracker_box", "004_sugar_box", "006_mustard_bottle", "024_bowl", "025_mug"]
)
def test_scanned_objects_stand_as_they_were_scanned(test_data, name: str) -> None:
    """YCB scans stand along z on their foot, and their feet are not quite flat."""
    mesh = load_mesh(test_data / "ycb_meshes" / name / "textured.obj")
    tilted = SE3(so3_exp([np.radians(7), np.radians(-5), 0.4]), np.array([0, 0, 0.5]))
    rested = snap_to_plane(mesh, tilted, GROUND, mode="rest")
    assert np.degrees(np.arccos(rested.R[2, 2])) < 2
    assert lowest(mesh, rested, GROUND) == pytest.approx(0, abs=1e-9)
    again = snap_to_plane(mesh, rested, GROUND, mode="rest")
    assert rotation_angle(again.R.T @ rested.R) < 1e-7
