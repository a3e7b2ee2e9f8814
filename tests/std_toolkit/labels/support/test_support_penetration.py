"""Objects that run into each other, and those that only seem to."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.synthetic.shapes import bowl, can, mug
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.labels.support.penetration import (
    TABLE,
    Penetration,
    find_penetrations,
    prepare_objects,
)
from std_toolkit.labels.support.plane import Plane
from std_toolkit.labels.support.solid import PlacedObject, solid_of

GROUND = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
BALL = trimesh.creation.icosphere(5, 0.04)
BOX = trimesh.creation.box((0.06, 0.08, 0.1))
BOWL, MUG, CAN = bowl(0.068, 0.055), mug(0.042, 0.095), can(0.034, 0.102)
UPRIGHT = so3_exp([np.pi / 2, 0, 0])  # shapes have y up


def at(name: str, mesh: trimesh.Trimesh, *t: float, R: np.ndarray | None = None) -> PlacedObject:
    return PlacedObject(name, mesh, SE3(np.eye(3) if R is None else R, np.array(t)))


def pulled_apart(a: PlacedObject, b: PlacedObject, found: Penetration) -> list[Penetration]:
    moved = PlacedObject(a.name, a.mesh, SE3(a.T_frame_obj.R, a.T_frame_obj.t + found.separation))
    return find_penetrations([moved, b])


@pytest.mark.parametrize("overlap_mm", [0.8, 3.0, 12.0])
def test_two_balls(overlap_mm: float) -> None:
    direction = np.array([0.6, -0.48, 0.64])
    a, b = at("a", BALL, 0, 0, 0), at("b", BALL, *((0.08 - overlap_mm / 1000) * direction))
    (found,) = find_penetrations([a, b])
    assert (found.first, found.second) == ("a", "b")
    assert 1000 * found.depth_m == pytest.approx(overlap_mm, abs=0.15)
    assert found.sure
    way = found.separation
    assert 1000 * np.linalg.norm(way) == pytest.approx(overlap_mm, rel=0.1, abs=0.3)
    assert way @ direction < -0.99 * np.linalg.norm(way)
    assert pulled_apart(a, b, found) == []


def test_balls_side_by_side() -> None:
    assert find_penetrations([at("a", BALL, 0, 0, 0), at("b", BALL, 0.0802, 0, 0)]) == []


def test_a_contact_within_the_tolerance_is_none() -> None:
    things = [at("a", BOX, 0, 0, 0), at("b", BOX, 0, 0, 0.0996)]
    assert find_penetrations(things) == []
    (found,) = find_penetrations(things, tolerance_m=0.0002)
    assert found.depth_m == pytest.approx(0.0004, abs=2e-5)


def test_stacked_boxes() -> None:
    """Few vertices, large faces: the overlap holds no vertex of the lower box's sides."""
    a, b = at("upper", BOX, 0.01, 0, 0.098), at("lower", BOX, 0, 0, 0)
    (found,) = find_penetrations([a, b])
    assert found.depth_m == pytest.approx(0.002, abs=1e-5)
    assert found.separation == pytest.approx([0, 0, 0.002], abs=3e-4)
    assert pulled_apart(a, b, found) == []
    bottom = np.asarray(BOX.vertices)[found.first_surface.vertices]
    assert (bottom[:, 2] < 0).all()
    assert len(found.first_surface.points) > 100
    assert (np.abs(found.first_surface.points[:, 2] - 0.049) < 0.0011).all()


def test_edges_that_cross_without_a_vertex_inside() -> None:
    a = at("a", trimesh.creation.box((0.2, 0.02, 0.02)), 0, 0, 0)
    b = at("b", trimesh.creation.box((0.02, 0.2, 0.02)), 0, 0, 0.015)
    (found,) = find_penetrations([a, b])
    assert found.depth_m == pytest.approx(0.005, abs=2e-4)
    assert found.separation == pytest.approx([0, 0, -0.005], abs=3e-4)


def test_a_thing_inside_another_one() -> None:
    a = at("pea", trimesh.creation.icosphere(3, 0.01), 0.002, 0, 0)
    b = at("box", BOX, 0, 0, 0)
    (found,) = find_penetrations([a, b])
    assert len(found.first_surface.vertices) == len(a.mesh.vertices)
    assert len(found.second_surface.vertices) == 0
    assert pulled_apart(a, b, found) == []


def test_nested_bowls_do_not_touch() -> None:
    """The middle of the small bowl lies in the hollow of the large one, 2 mm above its floor."""
    small = bowl(0.058, 0.05)
    lower = at("lower", BOWL, 0, 0, 0.0275, R=UPRIGHT)
    assert find_penetrations([lower, at("upper", small, 0, 0, 0.03, R=UPRIGHT)]) == []
    upper = at("upper", small, 0, 0, 0.0265, R=UPRIGHT)
    (found,) = find_penetrations([upper, lower])
    assert found.sure
    # Walls of 3 mm: nothing can be deeper than half of that.
    assert 0.0005 < found.depth_m < 0.0016
    assert pulled_apart(upper, lower, found) == []


def test_a_spoon_in_a_mug() -> None:
    handle = trimesh.creation.cylinder(0.003, 0.15)
    leaning = so3_exp([0, 0.2, 0])
    cup = at("mug", MUG, 0, 0, 0.0475, R=UPRIGHT)
    assert not solid_of(MUG).closed  # the handle is an open tube
    inside = at("spoon", handle, 0.002, 0, 0.085, R=leaning)
    assert find_penetrations([cup, inside]) == []
    through = at("spoon", handle, 0.03, 0, 0.06, R=leaning)
    (found,) = find_penetrations([through, cup])
    assert {found.first, found.second} == {"mug", "spoon"}
    assert pulled_apart(through, cup, found) == []


def test_a_sheet_encloses_nothing() -> None:
    """Half a sphere, one triangle thick: a marble in it lies in the open, or pokes through it."""
    half = trimesh.Trimesh(
        BALL.vertices, BALL.faces[BALL.triangles_center[:, 2] < 0], process=False
    )
    assert solid_of(half).sheet
    marble = trimesh.creation.icosphere(3, 0.012)
    cup = at("cup", half, 0, 0, 0)
    assert find_penetrations([cup, at("marble", marble, 0, 0, -0.015)]) == []
    (found,) = find_penetrations([cup, at("marble", marble, 0, 0, -0.035)])
    assert found.depth_m == pytest.approx(0.007, abs=5e-4)
    assert len(found.first_surface.faces) > 0
    assert len(found.second_surface.faces) == 0


def test_a_scan_with_a_hole_is_still_a_solid() -> None:
    hole = BALL.triangles_center[:, 2] < 0.037
    scan = trimesh.Trimesh(BALL.vertices, BALL.faces[hole], process=False)
    a, b = at("scan", scan, 0, 0, 0), at("box", BOX, 0.06, 0, 0)
    (found,) = find_penetrations([a, b])
    assert found.depth_m == pytest.approx(0.01, abs=5e-4)
    assert 0.8 < found.certainty <= 1


def test_things_in_the_table() -> None:
    sunk = at("sunk", BOX, 0, 0, 0.047)
    standing = at("standing", BOX, 0.2, 0, 0.05)
    hovering = at("hovering", BALL, 0.4, 0, 0.08)
    (found,) = find_penetrations([sunk, standing, hovering], plane=GROUND)
    assert (found.first, found.second) == ("sunk", TABLE)
    assert found.depth_m == pytest.approx(0.003)
    assert found.separation == pytest.approx([0, 0, 0.003])
    assert sorted(found.first_surface.vertices) == sorted(
        np.flatnonzero(np.asarray(BOX.vertices)[:, 2] < 0)
    )
    assert len(found.first_surface.faces) == 10


def test_nothing_is_pushed_into_the_table() -> None:
    a, b = at("a", BOX, 0, 0, 0.05), at("b", BOX, 0, 0, 0.06)
    (found,) = find_penetrations([a, b], plane=GROUND)
    assert found.separation[2] >= -1e-6
    assert pulled_apart(a, b, found) == []


TWIST = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6)


@settings(max_examples=15, deadline=None)
@given(TWIST, st.floats(-np.pi, np.pi))
def test_moving_everything_together_changes_nothing(motion: list[float], turn: float) -> None:
    G = SE3.exp(motion)
    R = so3_exp([0, 0, turn]) @ UPRIGHT
    things = [
        at("mug", MUG, 0, 0, 0.0475, R=R),
        at("can", CAN, 0.07, 0.0, 0.049, R=UPRIGHT),
        at("bowl", BOWL, 0.0, 0.1, 0.0275, R=UPRIGHT),
    ]
    moved = [PlacedObject(t.name, t.mesh, G @ t.T_frame_obj) for t in things]
    here = find_penetrations(things, plane=GROUND)
    there = find_penetrations(moved, plane=GROUND.moved(G, "elsewhere"))
    assert [{p.first, p.second} for p in here] == [{p.first, p.second} for p in there]
    for p, q in zip(here, there, strict=True):
        assert q.depth_m == pytest.approx(p.depth_m, abs=2e-5)
        assert len(q.first_surface.points) == pytest.approx(
            len(p.first_surface.points), rel=0.02, abs=3
        )


@pytest.mark.real
def test_scans_that_stand_side_by_side_and_into_each_other(test_data) -> None:
    meshes = test_data / "ycb_meshes"
    cup, fruit = (load_mesh(meshes / name / "textured.obj") for name in ("025_mug", "011_banana"))
    side, wall = at("mug", cup, 0, 0, 0), trimesh.creation.box((0.05, 0.3, 0.3))
    touching = float(np.asarray(cup.vertices)[:, 0].max()) + 0.025
    assert find_penetrations([side, at("wall", wall, touching + 0.001, 0, 0)]) == []
    (found,) = find_penetrations([side, at("wall", wall, touching - 0.004, 0, 0)])
    assert found.depth_m == pytest.approx(0.004, abs=2e-4)
    assert found.sure
    # In the hollow of the mug there is room for a marble.
    middle = np.asarray(cup.vertices)[np.asarray(cup.vertices)[:, 2] > 0.02][:, :2].mean(axis=0)
    marble = at("marble", trimesh.creation.icosphere(3, 0.012), *middle, 0.03)
    assert find_penetrations([side, marble]) == []
    assert len(find_penetrations([side, at("banana", fruit, 0.03, 0.1, 0)])) == 1


@pytest.mark.slow
def test_six_fine_meshes_are_checked_while_a_person_drags() -> None:
    def fine(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        while len(mesh.faces) < 30_000:
            mesh = mesh.subdivide()
        return mesh

    meshes = [fine(m) for m in (BALL, BOX, BOWL, MUG, CAN, can(0.03, 0.06))]
    assert min(len(m.faces) for m in meshes) >= 30_000
    things = [
        at(str(i), m, 0.095 * (i % 3), 0.095 * (i // 3), 0.03, R=UPRIGHT)
        for i, m in enumerate(meshes)
    ]
    prepare_objects(things)
    assert 1 <= len([p for p in find_penetrations(things, plane=GROUND) if p.second != TABLE]) <= 5
    best = np.inf
    for _ in range(15):
        start = time.perf_counter()
        find_penetrations(things, plane=GROUND)
        best = min(best, time.perf_counter() - start)
    # 50 ms is the aim on a quiet machine; tests run beside others.
    assert best < 0.15
