"""Contacts in a grid of signed distances, against answers of graspnetAPI."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmark.metrics.grasp.ap import JudgedObject, average_precision, judge_grasps, precision_at
from benchmark.metrics.grasp.grasp import Grasps
from benchmark.metrics.grasp.sdf_contacts import SdfMesh
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "exact"), [("primitives", 19.915), ("lumpy", 23.274)])
def test_figures_of_graspnetapi(test_data: Path, name: str, exact: float) -> None:
    """Selection, collisions, frictions and average precision of three objects on a table."""
    path = test_data.parent / "reference" / f"graspnet_oracle_{name}.npz"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    known = np.load(path)
    objects = [
        JudgedObject(known[f"vertices_{k}"], known[f"faces_{k}"], known[f"points_{k}"])
        for k in range(3)
    ]
    poses = [SE3.from_matrix(T) for T in known["poses"]]
    scene = Grasps.from_array(known["grasps"]), objects, poses, SE3.from_matrix(known["table"])
    judged = judge_grasps(*scene, contacts="sdf")
    np.testing.assert_array_equal(judged.friction, known["friction"])
    np.testing.assert_array_equal(judged.collided | judged.empty, known["collision_or_empty"])
    chosen = known["selected"][:, 13:16]
    np.testing.assert_allclose(judged.grasps.translations, chosen, atol=1e-12)
    table = precision_at(judged.friction)
    np.testing.assert_allclose(table, known["precision"], atol=1e-12)
    assert average_precision([table]).ap == pytest.approx(float(known["ap"]), abs=1e-9)
    # The exact contacts are the default.
    table = precision_at(judge_grasps(*scene).friction)
    assert average_precision([table]).ap == pytest.approx(exact, abs=1e-3)


def ball() -> SdfMesh:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    return SdfMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_distances_of_a_ball() -> None:
    sdf = ball()
    points = np.array([[0, 0, 0], [0.01, 0, 0], [0.02, 0.02, 0.02], [0.3, 0, 0]])
    cells = (points - sdf.origin) / sdf.cell
    wanted = np.array([-0.03, -0.02, np.sqrt(3) * 0.02 - 0.03, 1.0])  # the last is off the grid
    np.testing.assert_allclose(sdf.distances(cells), wanted, atol=sdf.cell / 2)


def test_fingers_meet_a_ball_at_its_ends() -> None:
    grasp = Grasps.make(np.eye(3)[None], [[-0.02, 0, 0]], widths=0.064, depths=0.02)
    contacts = ball().contacts(grasp)
    assert contacts.found.all()
    np.testing.assert_allclose(contacts.points[0, :, 1], [-0.03, 0.03], atol=5e-4)
    assert ball().friction_scores(grasp).tolist() == [0.2]
    beside = grasp.replaced(translations=grasp.translations + np.array([0, 0, 0.05]))
    assert ball().friction_scores(beside).tolist() == [-1.0]


def test_a_mesh_without_faces_is_refused() -> None:
    with pytest.raises(ToolkitError, match="no faces"):
        SdfMesh(np.zeros((3, 3)), np.zeros((0, 3), int))
