"""`detect_symmetry`: solids of known groups, BOP's annotation of LM-O, expectations for YCB."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from std_toolkit.geometry import SE3, Symmetry, mssd, rotation_angle, so3_exp
from std_toolkit.geometry.mesh import load_mesh, surface_error
from std_toolkit.geometry.symmetry_search import check_symmetry, detect_symmetry
from tests.std_toolkit.geometry.symmetry_table import YCB, Expected

SHORT_YCB = ("003_cracker_box", "024_bowl", "025_mug", "036_wood_block")
LMO, SHORT_LMO = ("1", "5", "6", "8", "9", "10", "11", "12"), ("5", "11")


def sorted_by_time(names: tuple[str, ...], short: tuple[str, ...]) -> list[object]:
    return [
        pytest.param(n, marks=pytest.mark.slow if n in short else pytest.mark.long) for n in names
    ]


def tilted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh turned and moved, so that no axis is one of its frame."""
    T = SE3(so3_exp(np.array([0.0, 0.0, 0.6])), np.array([0.02, -0.01, 0.05]))
    return mesh.apply_transform(T.matrix())


@pytest.mark.parametrize(
    ("solid", "count"),
    [
        (trimesh.creation.box((0.05, 0.08, 0.12)), 3),
        (trimesh.creation.box((0.06, 0.06, 0.12)), 7),
        (trimesh.creation.box((0.07, 0.07, 0.07)), 23),
        (trimesh.creation.cylinder(0.04, 0.1, sections=3), 5),
    ],
    ids=["box", "square", "cube", "prism"],
)
def test_discrete_groups(solid: trimesh.Trimesh, count: int) -> None:
    found = detect_symmetry(tilted(solid.copy()))
    assert not found.shape.continuous
    assert len(found.shape.discrete) == count
    assert max(c.distance_m for c in found.checked) < 1e-3
    assert found.appearance == found.shape


def test_round_solids() -> None:
    can = detect_symmetry(trimesh.creation.cylinder(0.04, 0.1, sections=48))
    assert [axis for axis, _ in can.shape.continuous] == [(0.0, 0.0, 1.0)]
    assert len(can.shape.discrete) == 1  # upside down
    cone = detect_symmetry(trimesh.creation.cone(0.04, 0.1, sections=48))
    assert cone.shape.continuous and not cone.shape.discrete
    ball = detect_symmetry(trimesh.creation.icosphere(subdivisions=3, radius=0.03))
    assert ball.shape.is_spherical


def test_handle_leaves_no_symmetry() -> None:
    can = trimesh.creation.cylinder(0.04, 0.1, sections=48)
    handle = trimesh.creation.box((0.03, 0.008, 0.06)).apply_translation([0.05, 0, 0.018])
    assert detect_symmetry(trimesh.util.concatenate([can, handle])).shape.is_trivial


def test_colors_break_a_symmetry() -> None:
    can = trimesh.creation.cylinder(0.04, 0.1, sections=72)
    can = can.subdivide().subdivide()
    x, y, z = can.triangles_center.T
    stripes = np.sin(3 * np.arctan2(y, x)) * np.where(np.abs(z) < 0.049, 1, 0) > 0.2
    marked = stripes | (z > 0.049)
    can.visual.face_colors = np.where(marked[:, None], [200, 30, 30, 255], [230, 230, 230, 255])
    found = detect_symmetry(can)
    assert found.shape.continuous
    assert not found.appearance.continuous
    angles = [rotation_angle(SE3.from_matrix(T).R) for T in found.appearance.discrete]
    assert np.allclose(sorted(angles), [2 * np.pi / 3] * 2, atol=1e-6)


def test_known_error_tightens_the_tolerance() -> None:
    """A block that is 2 % wider than deep is square for a scan, and not for a measured mesh."""
    block = trimesh.creation.box((0.0612, 0.0588, 0.12))
    assert len(detect_symmetry(block).shape.discrete) == 7
    assert len(detect_symmetry(block, error_m=1e-4).shape.discrete) == 3


def test_surface_error_is_the_height_of_facets() -> None:
    radius, sections = 0.05, 24
    height = radius * (1 - np.cos(np.pi / sections))
    assert surface_error(trimesh.creation.cylinder(radius, 0.2, sections=sections)) == (
        pytest.approx(height, rel=0.1)
    )
    assert surface_error(trimesh.creation.box((0.1, 0.1, 0.1))) == 0


def test_check_of_a_declared_symmetry() -> None:
    box = trimesh.creation.box((0.05, 0.08, 0.12))
    half, quarter = (
        Symmetry(discrete=(tuple(SE3(so3_exp(np.array([0, 0, a])), np.zeros(3)).flat()),))
        for a in (np.pi, np.pi / 2)
    )
    assert check_symmetry(box, Symmetry()) is None
    right, wrong = check_symmetry(box, half), check_symmetry(box, quarter)
    assert right is not None and right.distance_m < 1e-6
    assert wrong is not None and wrong.distance_m > 0.01


@pytest.mark.parametrize("name", sorted_by_time(tuple(YCB), SHORT_YCB))
def test_ycb_meshes(name: str, test_data: Path) -> None:
    found = detect_symmetry(load_mesh(test_data / "ycb_meshes" / name / "textured.obj"))
    for expected, symmetry in zip(YCB[name], (found.shape, found.appearance), strict=True):
        assert_as_expected(symmetry, expected)


def assert_as_expected(symmetry: Symmetry, expected: Expected) -> None:
    turns = symmetry.discrete_transforms()[1:]
    if expected.order == 0:
        assert len(symmetry.continuous) == 1
        across = bool(turns)
    else:
        assert not symmetry.continuous
        # The main axis is that of most turns; a group of n of them has n - 1 about it.
        groups: list[list[np.ndarray]] = []
        for T in turns:
            v = np.linalg.svd(T.R - np.eye(3))[2][2]
            same = next((g for g in groups if abs(g[0] @ v) > 0.98), None)
            if same is None:
                groups.append([v])
            else:
                same.append(v)
        order = max((len(g) for g in groups), default=0) + 1
        assert order >= expected.order if expected.at_least else order == expected.order
        across = len(groups) > 1
    assert expected.across in (None, across)


@pytest.mark.parametrize("number", sorted_by_time(LMO, SHORT_LMO))
def test_as_bop_annotates_lmo(number: str, test_data: Path) -> None:
    folder = test_data / "lmo_poses"
    info = json.loads((folder / "models_info.json").read_text())[number]
    mesh = load_mesh(folder / f"models/obj_{int(number):06d}.ply", unit="mm")
    found = detect_symmetry(mesh)
    annotated = [np.reshape(T, (4, 4)) for T in info.get("symmetries_discrete", [])]
    for symmetry in (found.shape, found.appearance):
        assert not symmetry.continuous
        assert len(symmetry.discrete) == len(annotated)
    for ours, theirs in zip(found.shape.discrete, annotated, strict=True):
        # The published matrices are rotations to 1e-2 only.
        u, _, v = np.linalg.svd(theirs[:3, :3])
        turn = SE3(u @ v, theirs[:3, 3] / 1000)
        apart = mssd(SE3.from_matrix(ours), turn, mesh.vertices)
        assert apart < 0.03 * info["diameter"] / 1000
