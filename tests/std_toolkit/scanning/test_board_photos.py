"""Photos of another zoom, board files of another sheet, and words that are no folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("manifold3d")

from std_toolkit.cli.scanning import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.io.images import write_color, write_png
from std_toolkit.poses.board_scale import BoardDetection
from std_toolkit.poses.board_sheet import make_board_sheet
from std_toolkit.scanning.board.board_photos import check_layout, check_zoom
from std_toolkit.scanning.masks.object_masks import own_masks
from std_toolkit.scanning.photos.photos import Photos
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import View
from tests.std_toolkit.scanning.ball import look_at

SIZE = (640, 480)
LENS = Camera(640, 480, 560, 560, 322.0, 236.0, (-0.08, 0.03, 0.0, 0.0))


def corners(paper: str = "a4") -> dict[int, np.ndarray]:
    document = make_board_sheet(paper).document()  # type: ignore[arg-type]
    return {int(k): np.array(v) / 1000 for k, v in document.items() if k.isdecimal()}


def detections(zooms: list[float], layout: dict[int, np.ndarray]) -> list[BoardDetection]:
    """The a4 sheet as photos of these zooms show it, with the corners of a board file."""
    sheet = corners()
    ids = sorted(set(sheet) & set(layout))
    found = []
    rng = np.random.default_rng(0)
    for n, zoom in enumerate(zooms):
        e, a = np.deg2rad((22, 50)[n % 2]), 2 * np.pi * n / len(zooms)
        eye = 0.5 * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        camera = Camera(640, 480, 560 * zoom, 560 * zoom, 322.0, 236.0, LENS.distortion)
        xyz = np.concatenate([sheet[i] for i in ids])
        uv = camera.project(look_at(eye, np.zeros(3)).inverse() @ xyz)
        uv = uv + rng.normal(0, 0.15, uv.shape)
        inside = ((uv > 0) & (uv < np.array(SIZE))).all(axis=1)
        every = np.concatenate([np.arange(4) + 4 * i for i in ids])
        stated = np.concatenate([layout[i] for i in ids])
        found.append(BoardDetection(every[inside], stated[inside], uv[inside]))
    return found


NAMES = [f"{n:03d}.jpg" for n in range(12)]


@pytest.mark.parametrize("zoom", [1.25, 0.8, 1.1])
def test_photos_of_another_zoom_are_named(zoom: float) -> None:
    found = detections([zoom if n % 3 == 0 else 1.0 for n in range(12)], corners())
    told = rf"4 of 12 photos.*{zoom:.2f} times.*000\.jpg, 003\.jpg, 006\.jpg, 009\.jpg"
    with pytest.raises(ToolkitError, match=told):
        check_zoom(found, SIZE, NAMES)


def test_refocusing_is_no_zoom() -> None:
    found = detections([1.0 + 0.02 * (-1) ** (n // 2) for n in range(12)], corners())
    check_zoom(found, SIZE, NAMES)
    # A photo that shows two tags tells little of its focal length.
    few = BoardDetection(found[3].ids[:16], found[3].xyz[:16], found[3].uv[:16] * 1.002)
    check_zoom([*found[:3], few, *found[4:]], SIZE, NAMES)


def test_the_board_file_of_another_sheet_is_recognised() -> None:
    right = detections([1.0] * 12, corners())
    check_layout(right, SIZE, Path("board.json"))
    # The same ids in a full grid of six columns.
    pitch = 0.03
    square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.0125
    grid = {i: square + np.array([pitch * (i % 6), -pitch * (i // 6), 0]) for i in corners()}
    with pytest.raises(ToolkitError, match=r"board\.json: the tags lie otherwise than this file"):
        check_layout(detections([1.0] * 12, grid), SIZE, Path("board.json"))


@pytest.mark.real
def test_the_real_photos_of_another_layout(tmp_path: Path) -> None:
    """The handed photos have the ids of a sheet of `std-scan board` in another layout."""
    import os

    from std_toolkit.poses.board_scale import Board, detect_board
    from std_toolkit.poses.board_sheet import write_board_pdf

    data = Path(os.environ.get("STD_TEST_DATA", Path(__file__).parents[4] / "shared/data"))
    folder = data / "tabletop_board_rgb"
    photos = sorted((folder / "color").glob("*.jpg"))[::8][:8]
    if not photos:
        pytest.skip("needs the recording")
    other = write_board_pdf(tmp_path / "board_a4.pdf")[1]
    wrong = [detect_board(p, board=Board.read(other)) for p in photos]
    with pytest.raises(ToolkitError, match="the tags lie otherwise than this file says"):
        check_layout(wrong, SIZE, other)
    right = [detect_board(p, board=Board.read(folder / "board_mm.json")) for p in photos]
    check_layout(right, SIZE, folder / "board_mm.json")
    check_zoom(right, SIZE, [p.name for p in photos])


def test_the_hint_on_masks_names_the_right_files(tmp_path: Path) -> None:
    view = View(
        "000000.jpg", np.zeros((48, 64, 3), np.uint8), LENS, look_at(np.ones(3), np.zeros(3))
    )
    posed = PosedPhotos(
        views=[view], corners=np.zeros((0, 3)), points=np.zeros((0, 3)), on_table=True, facts={},
        warnings=[], digest="", photos=Photos((), (), (64, 48), 1.0),
    )  # fmt: skip
    with pytest.raises(ToolkitError, match=r"such as 000000\.png$"):
        own_masks(tmp_path, posed)
    write_png(tmp_path / "000000.png", np.full((48, 64), 255, np.uint8))
    assert own_masks(tmp_path, posed)["000000.jpg"].all()


def test_a_folder_that_is_not_there_is_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["no_such_folder", "--board", "board_a4.json", "--out", "o"]) == 2
    assert "no such folder of photos" in capsys.readouterr().err
    (tmp_path / "photos").mkdir()
    write_color(tmp_path / "photos" / "1.png", np.zeros((48, 64, 3), np.uint8))
    assert main(["photos", "--out", "o"]) != 0
    assert "no such folder" not in capsys.readouterr().err
