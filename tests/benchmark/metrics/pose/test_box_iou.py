"""Overlap of boxes against known answers, closed forms, and what must hold for any boxes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from pose_cases import boxes, oracle, pose, rigid

from benchmark.metrics.pose import BoxIoU, box_iou
from benchmark.metrics.pose.box_iou import common_volume
from std_toolkit.errors import ToolkitError

Box = tuple[np.ndarray, np.ndarray]
CUBE = np.ones(3)


def iou(a: Box, b: Box, definition: BoxIoU = BoxIoU.ORIENTED) -> float:
    return float(box_iou(a[0][None], a[1][None], b[0][None], b[1][None], definition)[0])


@pytest.mark.parametrize("definition", list(BoxIoU))
def test_known_answers(definition: BoxIoU) -> None:
    pairs = oracle()["box_pairs"]
    assert len(pairs) == 150
    parts = [np.array([p[box][of] for p in pairs]) for box in "ab" for of in ("RT", "size")]
    expected = np.array([p[definition.value] for p in pairs])
    assert np.abs(box_iou(*parts, definition) - expected).max() < 1e-9


def test_boxes_along_the_axes() -> None:
    a = pose(t=(1, 2, 3)), np.array([0.4, 0.6, 0.8])
    b = pose(t=(1.1, 2.3, 2.9)), np.array([0.6, 0.2, 1.0])
    # Along x: 0.4, all of a. Along y: up to 2.3 of 2.2 .. 2.4. Along z: 2.6 .. 3.4 in 2.4 .. 3.4.
    common = 0.4 * 0.1 * 0.8
    expected = common / (0.4 * 0.6 * 0.8 + 0.6 * 0.2 * 1.0 - common)
    assert iou(a, b) == pytest.approx(expected, abs=1e-12)
    assert iou(a, b, BoxIoU.AABB) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_a_cube_turned_by_45_degrees(axis: int) -> None:
    """Two unit squares at 45 degrees have a regular octagon in common, of area 2 (sqrt 2 - 1)."""
    turn = pose(np.eye(3)[axis] * np.pi / 4)
    octagon = 2 * (np.sqrt(2) - 1)
    assert iou((np.eye(4), CUBE), (turn, CUBE)) == pytest.approx(octagon / (2 - octagon), abs=1e-12)
    # The box around the turned cube is sqrt 2 wide both ways.
    assert iou((np.eye(4), CUBE), (turn, CUBE), BoxIoU.AABB) == pytest.approx(0.5, abs=1e-12)


def test_a_corner_in_a_cube() -> None:
    """A large cube that stands on a corner, its corner pushed by h into a face: a pyramid.

    A plane at height h cuts the edges of a cube's corner at h * sqrt 3: the volume below is
    (h * sqrt 3)^3 / 6.
    """
    up = np.ones(3) / np.sqrt(3)
    axis = np.cross(up, (0.0, 0.0, 1.0))
    turn = pose(axis / np.linalg.norm(axis) * np.arccos(up[2]), scale=4)
    corner = turn[:3, :3] @ np.full(3, -0.5)
    h = 0.3
    turn[:3, 3] = np.array([0, 0, 0.5 - h]) - corner
    found = common_volume(
        (np.diag([0.5, 0.5, 0.5, 1]))[None], (turn @ np.diag([0.5, 0.5, 0.5, 1]))[None]
    )
    assert found[0] == pytest.approx((h * np.sqrt(3)) ** 3 / 6, rel=1e-12)


def test_boxes_that_touch_or_lie_inside() -> None:
    small = np.full(3, 0.5)
    assert iou((np.eye(4), CUBE), (pose(t=(1, 0, 0)), CUBE)) == 0
    assert iou((np.eye(4), CUBE), (pose(t=(0.25, 0.25, 0.25)), small)) == pytest.approx(1 / 8)
    turned = pose((0.3, 0.5, 0.1)), np.full(3, 0.4)
    assert iou((np.eye(4), CUBE), turned) == pytest.approx(0.4**3, rel=1e-12)
    assert iou(turned, (np.eye(4), CUBE)) == pytest.approx(0.4**3, rel=1e-12)
    flat = np.eye(4), np.array([1.0, 0.0, 1.0])
    for definition in (BoxIoU.ORIENTED, BoxIoU.AABB):
        assert iou(flat, (np.eye(4), CUBE), definition) == 0
    assert iou(flat, flat) == 0


@settings(deadline=None)
@given(boxes)
def test_a_box_is_itself(box: Box) -> None:
    # A corner with equal coordinates has an empty interval, and NOCS' product of eight is then 0.
    for definition in (BoxIoU.ORIENTED, BoxIoU.AABB):
        assert iou(box, box, definition) == pytest.approx(1, abs=1e-9)


@pytest.mark.slow
@settings(deadline=None)
@given(boxes, boxes)
def test_bounds_and_symmetry(a: Box, b: Box) -> None:
    for definition in BoxIoU:
        assert iou(a, b, definition) == pytest.approx(iou(b, a, definition), abs=1e-9)
        assert 0 <= iou(a, b, definition) <= 1 + 1e-9
    # No box is larger than the one around it, nor is what two of them have in common.
    volumes = [np.linalg.det(RT[:3, :3]) * size.prod() for RT, size in (a, b)]
    assert iou(a, b) <= min(volumes) / max(volumes) + 1e-9


@pytest.mark.slow
@given(boxes, boxes, rigid)
@settings(max_examples=200, deadline=None)
def test_moving_both_boxes_changes_nothing(a: Box, b: Box, T: np.ndarray) -> None:
    moved = iou((T @ a[0], a[1]), (T @ b[0], b[1]))
    assert moved == pytest.approx(iou(a, b), abs=1e-9)


def test_the_other_definitions_change_when_both_boxes_move() -> None:
    a = pose(t=(0, 0, 0.8), scale=0.2), np.array([0.3, 0.9, 0.3])
    b = pose((0.1, 0.1, 0.05), (0.01, 0, 0.81), 0.2), np.array([0.3, 0.9, 0.3])
    turns = [pose((0, 0, angle)) for angle in np.deg2rad([0, 20, 45, 70])]

    def spread(definition: BoxIoU) -> float:
        found = [iou((T @ a[0], a[1]), (T @ b[0], b[1]), definition) for T in turns]
        return max(found) - min(found)

    assert spread(BoxIoU.ORIENTED) < 1e-12
    assert spread(BoxIoU.AABB) > 0.1
    assert spread(BoxIoU.NOCS2019) > 0.02


@given(boxes, boxes)
@settings(max_examples=20, deadline=None)
def test_common_volume_is_the_share_of_points(a: Box, b: Box) -> None:
    """Counted on a regular grid of points of box a, 40 each way."""
    steps = (np.arange(40) + 0.5) / 40 - 0.5
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    points = a[0][:3, :3] @ (grid * a[1]).T + a[0][:3, 3:]
    inside_b = np.linalg.solve(b[0][:3, :3], points - b[0][:3, 3:])
    share = (np.abs(inside_b) <= b[1][:, None] / 2).all(axis=0).mean()
    maps = [(RT * np.append(size / 2, 1))[None] for RT, size in (a, b)]
    volume_a = np.linalg.det(a[0][:3, :3]) * a[1].prod()
    assert common_volume(*maps)[0] / volume_a == pytest.approx(share, abs=0.05)


@given(boxes, boxes)
@settings(max_examples=30, deadline=None)
def test_nearly_the_same_box(a: Box, b: Box) -> None:
    """Faces that coincide but for rounding: the volume must not jump."""
    aligned = a[0] @ pose(b[0][:3, 3] * 1e-15), a[1]
    shifted = a[0].copy()
    shifted[:3, 3] += b[0][:3, 3] * 1e-15
    assert iou(a, aligned) == pytest.approx(1, abs=1e-9)
    assert iou(a, (shifted, a[1])) == pytest.approx(1, abs=1e-9)


def test_boxes_of_very_different_size() -> None:
    large = pose((0.2, -0.4, 0.3), scale=1e4), CUBE
    small = pose((0.7, 0.1, 0.2), (10, 20, 30), 1e-2), CUBE
    assert iou(large, small) == pytest.approx(1e-18, rel=1e-6)
    assert iou(small, large) == pytest.approx(1e-18, rel=1e-6)


def test_round_objects_take_the_best_turn() -> None:
    size = np.array([0.3, 0.8, 0.3])
    a, b = pose((0, 2 * np.pi / 20 * 3, 0)), np.eye(4)
    args = a[None], size[None], b[None], size[None]
    for definition in BoxIoU:
        round_ = box_iou(*args, definition, round_about_y=np.array([True]))
        plain = box_iou(*args, definition)
        assert round_[0] == pytest.approx(1, abs=1e-9)
        assert plain[0] < 0.99
    some = box_iou(*(np.repeat(x, 2, axis=0) for x in args), round_about_y=np.array([True, False]))
    assert some[0] == pytest.approx(1)
    assert some[1] == pytest.approx(iou((a, size), (b, size)))


def test_shapes_that_do_not_belong_together() -> None:
    with pytest.raises(ToolkitError, match="needs poses"):
        box_iou(np.eye(4)[None], np.ones((2, 3)), np.eye(4)[None], np.ones((1, 3)))
    with pytest.raises(ToolkitError, match="round_about_y"):
        box_iou(*(np.eye(4)[None], np.ones((1, 3))) * 2, round_about_y=np.array([True, False]))


@pytest.mark.parametrize("definition", list(BoxIoU))
def test_large_boxes_that_are_apart_have_nothing_in_common(definition: BoxIoU) -> None:
    assert iou((pose(), 3 * CUBE), (pose(t=(5, 0, 0)), 3 * CUBE), definition) == 0
