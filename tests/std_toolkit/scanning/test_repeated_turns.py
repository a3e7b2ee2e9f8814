"""Turns that fit equally well: a plain block by its outlines, a texture that is there twice."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.scanning.masks.hull import hull_field
from std_toolkit.scanning.photos.views import Grid, View
from std_toolkit.scanning.surface.measured_surface import Side, side_surface
from std_toolkit.scanning.surface.turned_over import _texture_repeats, find_turn
from tests.std_toolkit.scanning.test_turned_over import OVER, photos, plain, standing


def without_depth(views: list[View]) -> Side:
    grid = Grid.around(np.array([-0.05, -0.1, 0.0]), np.array([0.1, 0.08, 0.09]), 0.0015)
    hull = hull_field(views, grid)
    return Side(
        views=views, maps=[None] * len(views), grid=grid, hull=hull, disputed=hull,
        on_table=True, digest="",
    )  # fmt: skip


@pytest.mark.long
def test_a_plain_block_fits_in_several_turns() -> None:
    block = trimesh.creation.box((0.08, 0.05, 0.06)).apply_translation([0, 0, 0.03])
    first = without_depth(photos(block, SE3.identity(), plain))
    second = without_depth(photos(block, standing(block, OVER), plain))
    surface, other = (side_surface(s, 70, 1) for s in (first, second))
    turn = find_turn(first, surface, second, other)
    assert turn.by == "shape"
    assert turn.ambiguous
    assert "not measured" in turn.facts()["turned over residual"]
    ball = trimesh.creation.icosphere(3, radius=0.03).apply_translation([0, 0, 0.03])
    third = without_depth(photos(ball, SE3.identity(), plain))
    with pytest.raises(ToolkitError, match=r"no turn of the object.*photograph the same object"):
        find_turn(first, surface, third, side_surface(third, 70, 1))


@pytest.mark.parametrize(("twice", "repeats"), [(True, True), (False, False)])
def test_a_texture_that_is_there_twice(twice: bool, repeats: bool) -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.05, 0.05, (80, 3))
    back = SE3(so3_exp(np.array([0, 0, np.pi])), np.zeros(3))
    wrong = back @ q[:40] if twice else rng.uniform(-0.05, 0.05, (40, 3))
    p = np.concatenate([q[:40], wrong])
    inliers = np.arange(80) < 40
    pairs = np.concatenate([q[:40], q[:40]])
    assert _texture_repeats(SE3.identity(), p, pairs, inliers, 0.001, 0.002) == repeats
