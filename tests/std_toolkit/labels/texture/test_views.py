"""Views in which two poses predict different textures are found without any image."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image
from textured_views import CAMERA, HALF, box_mesh, textured_picture

from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.labels.refine.problem import RefineView
from std_toolkit.labels.texture.views import Telling, Views, frame_ranges
from std_toolkit.rendering.texture import TexturedSurface

COUNT = 36


def labelled_mesh() -> trimesh.Trimesh:
    """A white box with a picture on its front, the side towards -y, alone."""
    picture = np.full((256, 384, 3), 235, np.uint8)
    # The lower right sixth of the picture is that side's.
    picture[128:, 256:] = np.asarray(textured_picture(2))[128:, 256:]
    return box_mesh(Image.fromarray(picture))


def ring() -> Views:
    """Views from all around the upright axis, 10 deg apart; frame 0 looks at the front."""
    poses = []
    for k in range(COUNT):
        turn = SE3(so3_exp([0, 0, 2 * np.pi * k / COUNT]), np.zeros(3))
        # x right, y down and z forward of a camera before the front.
        R = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
        poses.append(turn @ SE3(R, np.array([0.0, -0.5, 0.0])))

    def read(k: int) -> RefineView | None:
        raise AssertionError(f"view {k} is not needed")

    return Views([CAMERA] * COUNT, poses, list(range(COUNT)), read)


@pytest.fixture(scope="module")
def telling() -> Telling:
    surface = TexturedSurface.from_mesh(labelled_mesh())
    assert surface is not None
    return Telling(ring(), surface, SE3.identity(), 0.11)


def test_front_and_back_tell_a_half_turn_and_the_sides_do_not(telling: Telling) -> None:
    front, back, side = (telling.difference(k, HALF) for k in (0, 18, 9))
    assert front > 0.5
    assert back > 0.5
    assert side < 0.1


def test_the_best_views_are_front_and_back(telling: Telling) -> None:
    best = telling.best(HALF)
    assert len(best) == 2
    away = [min(k % 18, 18 - k % 18) for k in best]  # from front or back, in steps of 10 deg
    assert max(away) <= 4
    # From both sides: the second is independent of the first.
    assert 12 <= (best[0] - best[1]) % COUNT <= 24


def test_a_view_that_is_compared_anyway_suffices_if_it_tells_nearly_as_well(
    telling: Telling,
) -> None:
    first = telling.best(HALF)[0]
    beside = (first + 1) % COUNT
    assert telling.difference(beside, HALF) > 0.8 * telling.difference(first, HALF)
    assert telling.best(HALF, [beside])[0] == beside


def test_frames_that_decide_are_neighbours(telling: Telling) -> None:
    frames = telling.frames(HALF)
    assert 2 <= len(frames) <= 14
    assert all(telling.difference(k, HALF) > 0.25 for k in frames)


def test_nothing_tells_a_turn_that_changes_nothing(telling: Telling) -> None:
    assert telling.best(SE3.identity()) == []
    assert telling.frames(SE3.identity()) == ()


def test_frames_in_words() -> None:
    assert frame_ranges([30, 34, 38]) == "frames 30 to 38"
    assert frame_ranges([7]) == "frame 7"
    assert frame_ranges([]) == ""
