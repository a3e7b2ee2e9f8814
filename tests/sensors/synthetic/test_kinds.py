"""Objects of all kinds are closed, of the stated size, and symmetric as stated."""

import numpy as np
import pytest

from sensors.synthetic.kinds import JUDGING, LOOKS, SETTING, Kind, kind_named
from sensors.synthetic.solids import deformed
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.ray_caster import RayCaster

KINDS = (*SETTING, *JUDGING)


def test_setting_and_judging_share_no_kind() -> None:
    names = [k.name for k in KINDS]
    assert len(set(names)) == len(names) >= 24
    for kinds in (SETTING, JUDGING):
        assert {look for k in kinds for look in k.looks} == set(LOOKS)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_meshes_are_closed_centred_and_of_the_stated_size(kind: Kind) -> None:
    sizes = set()
    for seed in range(3):
        mesh = kind.mesh(np.random.default_rng(seed))
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
        low, high = kind.largest_mm
        assert 30 <= low <= 1000 * mesh.extents.max() <= high <= 250
        assert mesh.extents.min() > 0.008
        assert np.allclose(mesh.bounds[0], -mesh.bounds[1], atol=1e-9)
        assert len(mesh.faces) < 25_000
        sizes.add(tuple(np.round(mesh.extents / mesh.extents.max(), 4)))
    assert len(sizes) == 3 or kind.name == "ball", "proportions are random"


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_stated_symmetries_move_the_surface_onto_itself(kind: Kind) -> None:
    mesh = kind.mesh(np.random.default_rng(5))
    surface = RayCaster(mesh.vertices, mesh.faces)
    for T in kind.symmetry.transforms(steps=7):
        # The sides of a polygon with 72 corners are up to 0.1 % of its radius inside of the circle.
        assert surface.distance(T @ mesh.vertices).max() < 0.002 * mesh.extents.max()
    half_turn = np.diag([-1.0, 1.0, -1.0])
    if not any(np.allclose(T.R, half_turn, atol=1e-6) for T in kind.symmetry.transforms(72)):
        assert surface.distance(mesh.vertices @ half_turn.T).max() > 0.02 * mesh.extents.max()


def test_a_deformed_mesh_has_the_stated_size_and_stays_centred() -> None:
    mesh = kind_named("house").mesh(np.random.default_rng(0))
    other = deformed(mesh, np.array([1.02, 0.97, 1.0]))
    assert np.allclose(other.extents / mesh.extents, [1.02, 0.97, 1.0])
    bulged = deformed(mesh, np.ones(3), bulge=0.03)
    assert np.allclose(bulged.bounds[0], -bulged.bounds[1], atol=1e-9)
    middle = np.abs(mesh.vertices[:, 1]) < 0.1 * mesh.extents[1]
    growth = np.linalg.norm(bulged.vertices - mesh.vertices, axis=1)
    assert growth[middle].max() > 0.01 * mesh.extents[0]
    assert bulged.is_watertight


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(ToolkitError, match="no such kind"):
        kind_named("teacup")
