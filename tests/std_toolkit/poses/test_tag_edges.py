"""Corners of tags by their edges."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from std_toolkit.poses.tag_edges import edge_corners
from tests.std_toolkit.poses.test_board_file import tag_image


def photo(blur: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Grey image of one tag seen from the side, blurred in light, and its corners (4, 2)."""
    image, board = tag_image([7], size=480, gap=160)
    H = np.array([[0.09, 0.03, 12.3], [-0.01, 0.08, 21.7], [0.0001, 0.00005, 1.0]])
    large = 8 * np.array([[1, 0, 0.4375], [0, 1, 0.4375], [0, 0, 0.125]])
    light = (image[..., 0] / 255.0 * 0.8 + 0.02).astype(np.float32)
    # The view is drawn eight times as large, then averaged: its pixels see areas.
    drawn = cv2.warpPerspective(light, large @ H, (8 * 120, 8 * 100), borderValue=0.82)
    small = cv2.resize(drawn, (120, 100), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), blur)
    noise = np.random.default_rng(seed).normal(size=small.shape)
    grey = np.clip(255 * small ** (1 / 2.2) + noise, 0, 255).astype(np.uint8)
    corners = np.array(board["7"])[:, :2]
    uv = cv2.perspectiveTransform(corners[None].astype(np.float64), H)[0]
    return grey, uv


@pytest.mark.parametrize("blur", [0.6, 1.0])
def test_corners_of_a_blurred_tag_are_not_drawn_inwards(blur: float) -> None:
    grey, uv = photo(blur)
    middle = uv.mean(axis=0)
    inward = (middle - uv) / np.linalg.norm(middle - uv, axis=1, keepdims=True)
    found = edge_corners(grey, (uv + 0.7 * inward)[None])[0]
    assert np.linalg.norm(found - uv, axis=1).max() < 0.12
    assert abs(float(((found - uv) * inward).sum(axis=1).mean())) < 0.06


def test_a_corner_beside_a_hidden_edge_keeps_its_place() -> None:
    grey, uv = photo(0.8)
    start = uv + 0.5
    grey[:, :56] = 128
    found = edge_corners(grey, start[None])[0]
    # Only the lower right corner has two edges of which more than half is seen.
    seen = int(uv.sum(axis=1).argmax())
    others = [k for k in range(4) if k != seen]
    assert np.array_equal(found[others], start[others])
    assert np.linalg.norm(found[seen] - uv[seen]) < 0.15


def test_a_blank_image_changes_nothing() -> None:
    corners = np.array([[[20.0, 20], [60, 20], [60, 60], [20, 60]]])
    assert np.array_equal(edge_corners(np.full((80, 80), 200, np.uint8), corners), corners)
