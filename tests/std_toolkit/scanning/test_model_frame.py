"""The frame of a model by its category, and the symmetry that is written with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.symmetry import Symmetry
from std_toolkit.geometry.symmetry_search import DetectedSymmetry
from std_toolkit.labels.entry.symmetry_argument import parse_symmetry
from std_toolkit.scanning.model.model_frame import model_frame, write_symmetry

ANGLE = 0.6
T_WORLD_OBJ = SE3(so3_exp(np.array([0, 0, ANGLE])), np.array([0.2, -0.1, 0.05]))


def test_the_longer_side_of_a_box_is_along_x() -> None:
    box = trimesh.creation.box((0.12, 0.05, 0.2))
    T = model_frame(T_WORLD_OBJ @ np.asarray(box.vertices), np.asarray(box.faces))
    placed = T @ (T_WORLD_OBJ @ np.asarray(box.vertices))
    assert np.allclose(np.ptp(placed, axis=0), (0.12, 0.05, 0.2), atol=1e-6)
    assert np.allclose(placed.min(axis=0), -placed.max(axis=0), atol=1e-9)
    assert np.allclose(T.R[:, 2], (0, 0, 1))


@pytest.mark.parametrize("direction", [0.0, 2.0, 4.0])
def test_the_handle_of_a_mug_is_at_plus_x(direction: float) -> None:
    body = trimesh.creation.cylinder(0.04, 0.1)
    handle = trimesh.creation.box((0.03, 0.01, 0.05))
    handle.apply_translation((0.055, 0, 0))
    mug = trimesh.util.concatenate([body, handle])
    turned = SE3(so3_exp(np.array([0, 0, direction])), np.array([0.1, 0.2, 0.05]))
    T = model_frame(turned @ np.asarray(mug.vertices), np.asarray(mug.faces), "mug")
    placed = T @ (turned @ np.asarray(mug.vertices))
    middle = placed[len(body.vertices) :].mean(axis=0) - placed[: len(body.vertices)].mean(axis=0)
    assert np.degrees(np.arctan2(middle[1], middle[0])) == pytest.approx(0, abs=1)
    assert middle[0] > 0.05


def test_a_written_symmetry_is_read_for_labels(tmp_path: Path) -> None:
    turn = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    found = DetectedSymmetry(Symmetry((), (turn,)), Symmetry((), (turn,)), 0.001)
    write_symmetry(tmp_path, found)
    model = parse_symmetry([str(tmp_path / "symmetry.json")], centre=(0, 0, 0))
    assert model.continuous[0].axis == [0.0, 0.0, 1.0]
    assert not model.discrete
