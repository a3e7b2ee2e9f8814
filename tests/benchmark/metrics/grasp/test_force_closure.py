"""Friction that a grasp needs: boxes and balls, whose answer is a tangent."""

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from benchmark.metrics.grasp.force_closure import (
    FRICTIONS,
    Contacts,
    GraspedMesh,
    even_points,
    friction_scores,
    needed_friction,
)
from benchmark.metrics.grasp.grasp import Grasps
from std_toolkit.errors import ToolkitError


def closing_on(center: tuple[float, float, float], turn_deg: float = 0.0, width: float = 0.08):
    """Fingers that close along y turned about x, with the middle of the tips at `center`."""
    R = Rotation.from_euler("x", turn_deg, degrees=True).as_matrix()
    t = np.asarray(center, dtype=float) - 0.02 * R[:, 0]
    return Grasps.make(R[None], t[None], widths=width, depths=0.02)


@pytest.mark.parametrize(
    ("turn_deg", "score"),
    [(0, 0.2), (15, 0.4), (25, 0.6), (35, 0.8), (40, 1.0), (-25, 0.6), (48, 1.2), (51, -1.0)],
)
def test_a_box_turned_between_the_fingers_needs_the_tangent(turn_deg: int, score: float) -> None:
    # Long in z, so that a turned line still ends on the two faces that face y.
    box = trimesh.creation.box((0.1, 0.03, 0.2))
    mesh = GraspedMesh(box.vertices, box.faces)
    grasps = closing_on((0, 0, 0), turn_deg)
    contacts = mesh.contacts(grasps)
    assert needed_friction(contacts)[0] == pytest.approx(
        abs(math.tan(math.radians(turn_deg))), abs=1e-5
    )
    assert mesh.friction_scores(grasps)[0] == score
    length = 0.03 / math.cos(math.radians(turn_deg))
    assert np.linalg.norm(contacts.points[0, 1] - contacts.points[0, 0]) == pytest.approx(length)


@pytest.mark.parametrize("offset", [0.0, 0.005, 0.01, 0.015, 0.02, 0.025])
def test_a_ball_grasped_off_its_middle(offset: float) -> None:
    radius = 0.03
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh = GraspedMesh(ball.vertices, ball.faces)
    needed = needed_friction(mesh.contacts(closing_on((0, 0, offset))))[0]
    # Both normals lean by the angle whose sine is offset / radius; faces are flat by a degree.
    assert needed == pytest.approx(math.tan(math.asin(offset / radius)), abs=0.04)


def test_the_middle_of_a_ball_needs_no_friction() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    mesh = GraspedMesh(ball.vertices, ball.faces)
    rng = np.random.default_rng(0)
    grasps = Grasps.make(
        Rotation.random(50, rng=rng).as_matrix(), np.zeros((50, 3)), widths=0.08, depths=0.0
    )
    assert (mesh.friction_scores(grasps) == 0.2).all()


def test_free_air_fails() -> None:
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    mesh = GraspedMesh(box.vertices, box.faces)
    assert mesh.friction_scores(closing_on((0, 0, 0.1)))[0] == -1
    # One finger alone holds nothing: the box lies on one side of the middle.
    assert mesh.friction_scores(closing_on((0, 0.03, 0)))[0] == -1
    # Nor do fingers that the object does not fit between.
    assert mesh.friction_scores(closing_on((0, 0, 0), width=0.03))[0] == -1
    assert not mesh.contacts(closing_on((0, 0, 0), width=0.03)).found[0]
    assert np.isinf(needed_friction(mesh.contacts(closing_on((0, 0, 0.1)))))[0]


def test_the_wall_of_a_cup_is_held_from_both_sides() -> None:
    cup = trimesh.creation.annulus(r_min=0.036, r_max=0.04, height=0.1, sections=128)
    mesh = GraspedMesh(cup.vertices, cup.faces)
    grasps = closing_on((0, 0.038, 0), width=0.02)
    contacts = mesh.contacts(grasps)
    assert np.allclose(np.sort(contacts.points[0, :, 1]), [0.036, 0.04], atol=1e-4)
    assert mesh.friction_scores(grasps)[0] == 0.2
    # With the inner finger in the wall nothing can be said.
    assert mesh.friction_scores(closing_on((0, 0.038, 0), width=0.003))[0] == -1


def test_which_way_the_faces_are_turned_does_not_matter_for_a_shell() -> None:
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    rng = np.random.default_rng(0)
    turned = np.where(rng.uniform(size=(12, 1)) < 0.5, box.faces, box.faces[:, ::-1])
    assert GraspedMesh(box.vertices, turned).friction_scores(closing_on((0, 0, 0)))[0] == 0.2


def test_exact_angles_fall_on_their_step() -> None:
    def leaning(mu: float) -> Contacts:
        n = np.array([[math.sin(math.atan(mu)), -math.cos(math.atan(mu)), 0], [0, 1, 0]])
        return Contacts(np.array([True]), np.array([[[0, -0.02, 0], [0, 0.02, 0]]]), n[None])

    for mu, later in zip(FRICTIONS, (*FRICTIONS[1:], -1.0), strict=True):
        assert friction_scores(leaning(mu))[0] == mu
        assert friction_scores(leaning(mu + 0.01))[0] == later


def test_even_points_are_the_samples_nearest_to_the_middle_of_their_cube() -> None:
    ball = trimesh.creation.icosphere(radius=0.05)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    spacing = 0.02
    count = max(64, round(6 * float(ball.area) / spacing**2))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    samples = np.asarray(trimesh.sample.sample_surface(mesh, count, seed=0)[0])
    best: dict[tuple[int, ...], tuple[float, int]] = {}
    for i, point in enumerate(samples):
        cube = tuple(np.floor(point / spacing).astype(int).tolist())
        apart = float(np.linalg.norm(point - (np.array(cube) + 0.5) * spacing))
        best[cube] = min(best.get(cube, (np.inf, -1)), (apart, i))
    expected = samples[[i for _, i in best.values()]]
    found = even_points(vertices, faces, spacing)
    assert sorted(map(tuple, found)) == sorted(map(tuple, expected))


def test_normals_have_unit_length_on_faces_of_any_size() -> None:
    box = trimesh.creation.box((0.02, 0.05, 0.3))
    mesh = GraspedMesh(np.asarray(box.vertices), np.asarray(box.faces))
    tips = np.zeros((3, 3))
    found = mesh.contacts_of(tips, np.eye(3), np.full(3, 0.4))
    assert found.found.tolist() == [True, True, True]
    expected = np.stack([-np.eye(3), np.eye(3)], axis=1)
    assert np.abs(found.normals - expected).max() < 1e-9


@pytest.mark.parametrize("faces", [np.zeros((0, 3), int), np.zeros(3, int)])
def test_a_mesh_without_faces_is_refused(faces: np.ndarray) -> None:
    with pytest.raises(ToolkitError, match="holds no faces"):
        GraspedMesh(np.eye(3), faces)
