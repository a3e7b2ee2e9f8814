"""Masks from what the photos prove, where the object has parts of the colour of the table."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.scanning.masks.candidates import _inner, find_candidates
from std_toolkit.scanning.masks.proven_masks import segment_on_table, without_islands
from std_toolkit.scanning.masks.standing import choose_candidate
from std_toolkit.scanning.photos.views import Grid
from tests.std_toolkit.scanning.test_table_model import CORNERS, HIGH, photos_of_a_box


def test_texture_is_an_island_and_a_large_opening_is_not() -> None:
    clear = np.ones((100, 100), bool)
    outline = np.zeros_like(clear)
    outline[20:80, 20:80] = True
    clear[22:78, 22:78] = False
    clear[30:36, 30:40] = True
    clear[50:70, 40:70] = True
    found = without_islands(clear, outline)
    assert not found[30:36, 30:40].any()
    assert found[50:70, 40:70].all()
    assert found[~outline].all()
    nothing = np.zeros_like(clear)
    assert not without_islands(nothing, outline).any()


def test_the_inner_part_of_a_bent_object_is_within_it() -> None:
    """An angle made smaller about its middle would lie outside of it."""
    part = np.zeros((10, 30, 30), bool)
    part[:, :8] = part[:, :, :8] = True
    grid = Grid((0.0, 0.0, 0.0), 0.01, part.shape)
    vertices, faces = _inner(part, grid)
    assert len(faces)
    nearest = np.rint(vertices / 0.01).astype(int)[:, ::-1]
    assert part[tuple(nearest.clip(0, np.array(part.shape) - 1).T)].all()
    assert vertices[:, 2].min() < 0.01  # it stands on the table


@pytest.mark.slow
def test_a_panel_of_the_colour_of_the_table_stays_in_the_mask() -> None:
    views = photos_of_a_box(panel=True)
    found, compared = find_candidates(views, CORNERS, threads=1)
    assert len(found) == 1
    middle, _ = views[0].project(np.array([[0.0, 0.0, HIGH / 2]]))
    assert choose_candidate(found, views, pick=(0, *middle[0]))[1] == 0
    with pytest.raises(ToolkitError, match="no object at this pixel"):
        choose_candidate(found, views, pick=(0, 2.0, 2.0))
    done = segment_on_table(views, found, 0, compared, threads=1)
    for view, true in zip(done, views, strict=True):
        assert true.mask is not None
        both = (view.shown & true.mask).sum() / (view.shown | true.mask).sum()
        assert both > 0.8
        assert (true.mask & ~view.shown).sum() < 0.02 * true.mask.sum()
