"""Board files and detections."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_color
from std_toolkit.poses import board_scale
from std_toolkit.poses.board_scale import Board, detect_board


def tag_image(ids: list[int], size: int = 120, gap: int = 40) -> tuple[np.ndarray, dict]:
    """A row of tags drawn without blur, and the board that says 1 px = 1 mm."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image = np.full((size + 2 * gap, gap + len(ids) * (size + gap)), 255, np.uint8)
    board = {}
    for k, i in enumerate(ids):
        x = gap + k * (size + gap)
        image[gap : gap + size, x : x + size] = dictionary.generateImageMarker(i, size)
        # Edges of the print lie half a pixel outside the centres of its outer pixels.
        x0, y0 = x - 0.5, gap - 0.5
        corners = [[x0, y0], [x0 + size, y0], [x0 + size, y0 + size], [x0, y0 + size]]
        board[str(i)] = [[*c, 0.0] for c in corners]
    return np.repeat(image[..., None], 3, axis=2), board


def test_tag_corners_in_order_and_at_pixel_centres(tmp_path: Path) -> None:
    image, board = tag_image([3, 17, 5])
    # A lens blurs light, not coded values.
    light = cv2.GaussianBlur((image / 255).astype(np.float32), (0, 0), 1.0)
    write_color(tmp_path / "a.png", (255 * light ** (1 / 2.2)).astype(np.uint8))
    (tmp_path / "board.json").write_text(json.dumps({**board, "tag_size_mm": 120}))
    found = detect_board(tmp_path / "a.png", board=Board.read(tmp_path / "board.json"))
    assert len(found.ids) == 12 and len(set(found.ids.tolist())) == 12
    assert np.abs(found.uv - found.xyz[:, :2] * 1000).max() < 0.05


def test_tags_that_are_not_on_the_board_are_ignored(tmp_path: Path) -> None:
    image, board = tag_image([3, 17])
    write_color(tmp_path / "a.png", image)
    del board["17"]
    (tmp_path / "board.json").write_text(json.dumps(board))
    found = detect_board(tmp_path / "a.png", board=Board.read(tmp_path / "board.json"))
    assert sorted(found.ids) == [12, 13, 14, 15]


def test_charuco(tmp_path: Path) -> None:
    description = {"squares_x": 6, "squares_y": 4, "square_mm": 40, "marker_mm": 30}
    path = tmp_path / "board.json"
    path.write_text(json.dumps({"charuco": {**description, "dictionary": "DICT_5X5_100"}}))
    board = Board.read(path)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    image = cv2.aruco.CharucoBoard((6, 4), 0.04, 0.03, dictionary).generateImage((720, 480))
    write_color(tmp_path / "a.png", np.repeat(image[..., None], 3, axis=2))
    found = detect_board(tmp_path / "a.png", board=board)
    assert len(found.ids) == 15
    spacing = np.linalg.norm(found.xyz[0] - found.xyz[1])
    assert spacing == pytest.approx(0.04)
    assert np.linalg.norm(found.uv[0] - found.uv[1]) == pytest.approx(120, abs=0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not valid JSON"),
        ("[1]", "one JSON object"),
        ("{}", "no tags"),
        ('{"1": [[0,0,0]]}', "4 corners"),
        ('{"1": "x"}', "4 corners"),
        ('{"1": [[0,0,0],[1,0,0],[1,1,0],[null,1,0]]}', "4 corners"),
        ('{"dictionary": "DICT_NONE", "1": []}', "unknown OpenCV marker dictionary"),
        ('{"charuco": 3}', "must be an object"),
        ('{"charuco": {"squares_x": 6}}', "positive number"),
        (
            '{"charuco": {"squares_x": 6, "squares_y": 4, "square_mm": 3, "marker_mm": 4}}',
            "smaller than squares",
        ),
    ],
)
def test_bad_board_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "board.json"
    path.write_text(text)
    with pytest.raises(ToolkitError, match=message) as error:
        Board.read(path)
    assert "board.json" in str(error.value)


def test_missing_board_file(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="not found"):
        Board.read(tmp_path / "none.json")


@pytest.mark.parametrize(("frames", "expected"), [(60, 60), (61, 31), (200, 50)])
def test_many_frames_are_thinned_evenly(
    frames: int, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at: list[str] = []

    def record(_work: object, items: list[str], **_: object) -> object:
        looked_at.extend(items)
        raise ToolkitError("enough")

    monkeypatch.setattr(board_scale, "run_jobs", record)
    board = tmp_path / "board.json"
    _, tags = tag_image([3])
    board.write_text(json.dumps({**tags, "tag_size_mm": 120}))
    scene = SimpleNamespace(frame=lambda number: number, color_path=str)
    with pytest.raises(ToolkitError, match="enough"):
        board_scale.board_views(scene, dict.fromkeys(range(frames)), Board.read(board))
    assert len(looked_at) == expected
    assert len({int(b) - int(a) for a, b in pairwise(looked_at)}) == 1


def test_a_board_may_be_smaller_than_a_millimetre(tmp_path: Path) -> None:
    description = {"squares_x": 6, "squares_y": 4, "square_mm": 0.8, "marker_mm": 0.5}
    path = tmp_path / "board.json"
    path.write_text(json.dumps({"charuco": {**description, "dictionary": "DICT_5X5_100"}}))
    Board.read(path)
    path.write_text(json.dumps({"charuco": {**description, "marker_mm": 0}}))
    with pytest.raises(ToolkitError, match="positive number"):
        Board.read(path)


@pytest.mark.parametrize(
    ("key", "side", "words"),
    [
        ("0", 0.0, "0: a tag has sides of 1 to 5000 mm"),
        ("0", 1e308, "0: a tag has sides of 1 to 5000 mm"),
        ("587", 20.0, "587: DICT_APRILTAG_36h11 has no tag of this id: its ids end at 586"),
        ("-5", 20.0, r"the board has no tags \(got '-5'\)"),
    ],
)
def test_a_tag_that_nobody_can_print_is_named(
    tmp_path: Path, key: str, side: float, words: str
) -> None:
    path = tmp_path / "board.json"
    path.write_text(json.dumps({key: [[0, 0, 0], [side, 0, 0], [side, side, 0], [0, side, 0]]}))
    with pytest.raises(ToolkitError, match=words):
        Board.read(path)
