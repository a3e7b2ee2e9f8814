"""The printable board: its size in millimetres, and that its tags are found where it says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.io.images import write_color
from std_toolkit.poses.board_scale import Board, detect_board
from std_toolkit.poses.board_sheet import PAPER_MM, Middle, Paper, make_board_sheet, write_board_pdf

PX_PER_MM = 5
MM_PER_PT = 25.4 / 72


def drawn(pdf: bytes) -> np.ndarray:
    """The black rectangles of a PDF as an image, from its numbers alone."""
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert box is not None
    width, height = (float(v) * MM_PER_PT for v in box.groups())
    image = np.full((round(height * PX_PER_MM), round(width * PX_PER_MM), 3), 255, np.uint8)
    black = pdf[: pdf.index(b"0.75 g")]
    for numbers in re.findall(rb"([-\d.]+) ([-\d.]+) ([-\d.]+) ([-\d.]+) re f", black):
        x, y, w, h = (float(v) * MM_PER_PT for v in numbers)
        top, low = (round((height - v) * PX_PER_MM) for v in (y + h, y))
        image[top:low, round(x * PX_PER_MM) : round((x + w) * PX_PER_MM)] = 0
    return image


@pytest.mark.slow
@pytest.mark.parametrize("paper", ["a4", "a3", "letter"])
def test_tags_are_printed_where_the_description_says(tmp_path: Path, paper: Paper) -> None:
    pdf, description = write_board_pdf(tmp_path / "board.pdf", paper=paper)
    image = drawn(pdf.read_bytes())
    width, height = PAPER_MM[paper]
    assert image.shape[:2] == (round(height * PX_PER_MM), round(width * PX_PER_MM))
    write_color(tmp_path / "print.png", image)
    board = Board.read(description)
    found = detect_board(tmp_path / "print.png", board=board)
    assert len(found.ids) == 4 * len(board.tags)
    mm = (found.uv + 0.5) / PX_PER_MM
    said = found.xyz[:, :2] * [1000, -1000] + [width / 2, height / 2]
    assert np.abs(mm - said).max() < 0.25  # a pixel is 0.2 mm
    # The scale over the whole sheet, which is what matters, is far better.
    spread = np.ptp(mm, axis=0) / np.ptp(said, axis=0)
    assert np.abs(spread - 1).max() < 1e-3


def test_ruler_is_100_mm(tmp_path: Path) -> None:
    pdf, _ = write_board_pdf(tmp_path / "board.pdf")
    widths = re.findall(rb"[-\d.]+ [-\d.]+ ([-\d.]+) 0\.7087 re f", pdf.read_bytes())
    assert any(abs(float(w) * MM_PER_PT - 100) < 0.001 for w in widths)


def test_middle_is_free_and_two_boards_differ() -> None:
    sheet = make_board_sheet("a4")
    farthest = [max(abs(place[k]) for place in sheet.places) for k in (1, 2)]
    assert 2 * min(farthest) - sheet.tag_mm > 100
    other = make_board_sheet("a4", first_id=len(sheet.places))
    assert not {p[0] for p in sheet.places} & {p[0] for p in other.places}


def test_bad_options(tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="unknown paper"):
        make_board_sheet("a0")  # type: ignore[arg-type]
    with pytest.raises(ToolkitError, match="587 tags"):
        make_board_sheet(first_id=580)
    with pytest.raises(ToolkitError, match=r"must end in \.pdf"):
        write_board_pdf(tmp_path / "board.png")


def test_ids_tell_the_sheets_apart() -> None:
    sheets = [make_board_sheet(paper) for paper in PAPER_MM]
    ids = [i for sheet in sheets for i, _, _ in sheet.places]
    assert len(ids) == len(set(ids))
    assert make_board_sheet("letter").paper_mm == (215.9, 279.4)


@pytest.mark.parametrize("middle", ["grey", "pattern"])
def test_a_printed_middle_leaves_the_tags_their_white_gap(tmp_path: Path, middle: Middle) -> None:
    sheet = make_board_sheet("a4", middle=middle)
    cells = np.array(sheet.middle_cells())
    assert cells[:, 2] @ cells[:, 3] > 0.25 * np.prod(sheet.paper_mm)
    assert (cells[:, 4] > 0.3).all() and (cells[:, 4] < 0.7).all()
    gap = 1.4 * sheet.tag_mm / 8
    for _, x, y in sheet.places:
        apart = np.maximum(cells[:, :2] - [x, y], [x, y] - cells[:, :2] - cells[:, 2:4])
        assert (apart.max(axis=1) >= sheet.tag_mm / 2 + gap).all()
    pdf, description = write_board_pdf(tmp_path / "b.pdf", middle=middle)
    assert Board.read(description).tags == Board.read(write_board_pdf(tmp_path / "w.pdf")[1]).tags
    assert b"lay flat, object here" in pdf.read_bytes()
    assert b"AprilTag 36h11, ids 0 to 23" in pdf.read_bytes()


def test_a_file_of_the_user_beside_the_pdf_is_not_replaced(tmp_path: Path) -> None:
    mine = tmp_path / "b.json"
    mine.write_text('{"mine": 1}')
    with pytest.raises(ToolkitError, match=r"b\.json: --out: is no description of a board"):
        write_board_pdf(tmp_path / "b.pdf")
    assert mine.read_text() == '{"mine": 1}' and not (tmp_path / "b.pdf").exists()
    mine.unlink()
    write_board_pdf(tmp_path / "b.pdf")
    write_board_pdf(tmp_path / "b.pdf", first_id=24)
    assert Board.read(mine).tags[0][0] == 24
