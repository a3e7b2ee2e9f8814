"""Early checks: an object that moved on the board, and one that the board is seen through."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, so3_exp
from std_toolkit.scanning.board.board_photos import PhotoCameras
from std_toolkit.scanning.board.object_checks import check_opaque, check_rest
from std_toolkit.scanning.photos.views import View
from tests.std_toolkit.scanning.ball import look_at

CAMERA = Camera(640, 480, 600, 600, 319.5, 239.5)
MIDDLE = np.array([0.1, 0.1, 0.0])
REACH = (np.zeros(2), np.array([0.2, 0.2]))
COUNT = 24


def ring() -> dict[int, SE3]:
    angles = 2 * np.pi * np.arange(COUNT) / COUNT
    return {
        i: look_at(MIDDLE + np.array([0.4 * np.cos(a), 0.4 * np.sin(a), 0.25]), MIDDLE)
        for i, a in enumerate(angles)
    }


def check(moves: dict[int, SE3]) -> None:
    """The check on 40 features of an object that `moves` in some photos."""
    rng = np.random.default_rng(0)
    points = MIDDLE + rng.uniform([-0.03, -0.03, 0.015], [0.03, 0.03, 0.08], (40, 3))
    poses = ring()
    uv = {
        i: CAMERA.project(T.inverse() @ (moves.get(i, SE3.identity()) @ points))
        + rng.normal(size=(40, 2)) * 0.3
        for i, T in poses.items()
    }
    same = np.stack([np.arange(40)] * 2, axis=1)
    pairs = [(i, (i + k) % COUNT, same) for i in poses for k in (1, 2)]
    names = [f"{i:02d}.jpg" for i in poses]
    check_rest(pairs, uv, poses, PhotoCameras.one(CAMERA, len(poses)), names, reach=REACH)


def test_an_object_at_rest_passes() -> None:
    check({})


def test_photos_from_two_heights_that_share_nothing_are_no_move() -> None:
    """A low and a high round of 12 photos, which share nothing on one side of the object."""
    rng = np.random.default_rng(0)
    points = MIDDLE + rng.uniform([-0.03, -0.03, 0.015], [0.03, 0.03, 0.08], (40, 3))
    poses, uv, pairs = {}, {}, []
    same, none = np.stack([np.arange(40)] * 2, axis=1), np.zeros((0, 2), np.int64)
    for i in range(24):
        a, e = 2 * np.pi * (i % 12) / 12, np.deg2rad((20, 42)[i // 12])
        away = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        poses[i] = look_at(MIDDLE + 0.5 * away, MIDDLE)
        uv[i] = CAMERA.project(poses[i].inverse() @ points)
        pairs.append((i, i // 12 * 12 + (i + 1) % 12, same))
        pairs.append((i % 12, i % 12 + 12, none if i % 12 > 6 else same))
    check_rest(
        pairs,
        uv,
        poses,
        PhotoCameras.one(CAMERA, len(poses)),
        [f"{i}.jpg" for i in poses],
        reach=REACH,
    )


@pytest.mark.parametrize("moved", [False, True])
def test_rounds_that_share_nothing_are_a_move_only_if_it_stands_elsewhere(moved: bool) -> None:
    """A low box: the low round shows its sides, the high one its top, and no photo both."""
    rng = np.random.default_rng(0)
    size = [0.03, 0.03, 0.04]
    points = MIDDLE + rng.uniform(np.negative(size) * [1, 1, -0.4], size, (2, 40, 3))
    points[1] += [0.05, 0.03, 0] if moved else 0
    poses, uv, pairs = {}, {}, []
    same, none = np.stack([np.arange(40)] * 2, axis=1), np.zeros((0, 2), np.int64)
    for i in range(48):
        a, e = 2 * np.pi * (i % 24) / 24, np.deg2rad((22, 50)[i // 24])
        away = np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
        poses[i] = look_at(MIDDLE + 0.5 * away, MIDDLE)
        uv[i] = CAMERA.project(poses[i].inverse() @ points[i // 24])
        pairs.append((i, i // 24 * 24 + (i + 1) % 24, same))
        pairs.append((i % 24, i % 24 + 24, none))
    names = [f"{i}.jpg" for i in poses]
    if not moved:
        check_rest(pairs, uv, poses, PhotoCameras.one(CAMERA, len(poses)), names, reach=REACH)
        return
    with pytest.raises(ToolkitError, match=r"moved on the board between 23\.jpg and 24\.jpg"):
        check_rest(pairs, uv, poses, PhotoCameras.one(CAMERA, len(poses)), names, reach=REACH)


@pytest.mark.parametrize("turn", [0.0, 1.5])
def test_an_object_that_moved_is_named_with_the_photos(turn: float) -> None:
    R = so3_exp(np.array([0, 0, turn]))
    moved = SE3(R, MIDDLE - R @ MIDDLE + np.array([0.03, 0.04, 0.0]))
    with pytest.raises(ToolkitError, match=r"moved on the board between 09\.jpg and 10\.jpg"):
        check(dict.fromkeys(range(10, COUNT), moved))


@pytest.mark.slow
def test_a_board_that_is_seen_through_the_object() -> None:
    import trimesh

    inner = trimesh.creation.cylinder(0.02, 0.08)
    vertices = np.asarray(inner.vertices) + MIDDLE + [0, 0, 0.05]
    faces = np.asarray(inner.faces, np.int64)
    image = np.zeros((480, 640, 3), np.uint8)
    views = [View(f"{i:02d}.jpg", image, CAMERA, T) for i, T in ring().items()]
    grid = np.mgrid[:11, :11].reshape(2, -1).T * 0.02
    board = np.column_stack([grid, np.zeros(len(grid))])
    # The board around the object, which is opaque; then all of it.
    beside = np.linalg.norm(grid - MIDDLE[:2], axis=1) > 0.09
    front = {
        v.name: v.project(board[beside & (((board - MIDDLE) @ v.T_world_cam.R[:, 2]) < 0)])[0]
        for v in views
    }
    check_opaque(views, front, vertices, faces)
    through = {v.name: v.project(board)[0] for v in views}
    with pytest.raises(ToolkitError, match=r"transparent: 24 photos.*--revolve"):
        check_opaque(views, through, vertices, faces)
