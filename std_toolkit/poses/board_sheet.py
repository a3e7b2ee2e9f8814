"""A printable board: tags around a free middle for the object, as PDF with its description.

The frame of the board: origin in the middle of the sheet, x to the right, y up the sheet, z out of
the paper, so that an object that stands on the sheet has z upwards.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.poses.board_scale import Board

Paper = Literal["a4", "a3", "letter"]
Middle = Literal["white", "grey", "pattern"]

PAPER_MM: dict[Paper, tuple[float, float]] = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "letter": (215.9, 279.4),
}

# Smallest id of each sheet, with room for its tags: a photo tells which sheet it shows.
_FIRST_IDS: dict[Paper, int] = {"a4": 0, "a3": 60, "letter": 120}

DICTIONARY = "DICT_APRILTAG_36h11"

# Printers leave a border blank.
_MARGIN_MM = 9.0

# Width of a tag in parts of the distance between tags: the white gap is one and a half cells.
_TAG_SHARE = 0.84

# Cells of a tag across, its black border included.
_CELLS = 8

_RULER_MM = 100.0

# Grey of the middle, 0 black to 1 white; a pattern has blocks of this size and these greys.
_MIDDLE_GREY, _BLOCK_MM, _PATTERN = 0.5, 5.0, (0.35, 0.45, 0.55, 0.65)

_PT = 72 / 25.4


@dataclass(frozen=True)
class BoardSheet:
    """Tags on a sheet of paper.

    Attributes:
        paper_mm: width and height of the sheet.
        tag_mm: edge of a tag with its black border.
        places: (id, x, y) of the tags' centres, millimetres from the middle of the sheet.
        paper: name of its size.
        middle: what is printed where the object stands.
    """

    paper_mm: tuple[float, float]
    tag_mm: float
    places: tuple[tuple[int, float, float], ...]
    paper: Paper = "a4"
    middle: Middle = "white"

    @property
    def ids(self) -> tuple[int, int]:
        """Smallest and largest id."""
        numbers = [i for i, _, _ in self.places]
        return min(numbers), max(numbers)

    def middle_cells(self) -> list[tuple[float, float, float, float, float]]:
        """Grey rectangles (x, y, width, height, grey) of the middle, mm from the middle."""
        if self.middle == "white":
            return []
        # The white gap around tags stays.
        gap = self.tag_mm / 2 + 1.5 * self.tag_mm / _CELLS
        half = [max(abs(place[k]) for place in self.places) - gap for k in (1, 2)]
        if self.middle == "grey":
            return [(-half[0], -half[1], 2 * half[0], 2 * half[1], _MIDDLE_GREY)]
        columns, rows = (int(2 * h // _BLOCK_MM) for h in half)
        shades = np.random.default_rng(0).choice(_PATTERN, (rows, columns))
        return [
            ((c - columns / 2) * _BLOCK_MM, (r - rows / 2) * _BLOCK_MM, _BLOCK_MM, _BLOCK_MM,
             float(shades[r, c]))
            for r in range(rows) for c in range(columns)
        ]  # fmt: skip

    def document(self) -> dict[str, object]:
        """The board's JSON: corners of each tag in millimetres, in OpenCV's order."""
        half = self.tag_mm / 2
        corners = {
            str(i): [
                [round(x + a * half, 4), round(y + b * half, 4), 0.0]
                for a, b in ((-1, 1), (1, 1), (1, -1), (-1, -1))
            ]
            for i, x, y in self.places
        }
        return {
            "dictionary": DICTIONARY,
            "paper": self.paper,
            "paper_mm": list(self.paper_mm),
            "middle": self.middle,
            **corners,
        }

    def cells(self) -> list[tuple[float, float, float, float]]:
        """Black rectangles (x, y, width, height), mm from the middle, runs of cells as one."""
        rectangles = []
        cell = self.tag_mm / _CELLS
        for number, x, y in self.places:
            black = _tag(number) < 128
            for row in range(_CELLS):
                start = 0
                while start < _CELLS:
                    end = start
                    while end < _CELLS and black[row, end]:
                        end += 1
                    if end > start:
                        left = x - self.tag_mm / 2 + start * cell
                        low = y + self.tag_mm / 2 - (row + 1) * cell
                        rectangles.append((left, low, (end - start) * cell, cell))
                    start = end + 1
        return rectangles


def make_board_sheet(
    paper: Paper = "a4", *, first_id: int | None = None, middle: Middle = "white"
) -> BoardSheet:
    """Tags along the four edges of a sheet.

    Args:
        paper: size of the sheet.
        first_id: smallest id, where several boards are in use; None for that of the size.
        middle: what is printed where the object stands.

    Raises:
        ToolkitError: an unknown size, or ids beyond those of the dictionary.
    """
    if paper not in PAPER_MM:
        raise ToolkitError(
            "unknown paper", field="paper", value=paper, hint=f"one of {', '.join(PAPER_MM)}"
        )
    first_id = _FIRST_IDS[paper] if first_id is None else first_id
    width, height = PAPER_MM[paper]
    columns = 6
    pitch = (width - 2 * _MARGIN_MM) / columns
    # The last line of the sheet holds the ruler.
    rows = int((height - 2 * _MARGIN_MM - 6) / pitch)
    x = (np.arange(columns) - (columns - 1) / 2) * pitch
    y = ((rows - 1) / 2 - np.arange(rows)) * pitch
    edge = [(i, j) for j in range(rows) for i in range(columns)
            if i in (0, columns - 1) or j in (0, rows - 1)]  # fmt: skip
    known = _dictionary().bytesList.shape[0]
    if not 0 <= first_id <= known - len(edge):
        raise ToolkitError(
            f"the dictionary has {known} tags and the board {len(edge)}",
            field="first_id",
            value=first_id,
        )
    places = tuple((first_id + n, float(x[i]), float(y[j])) for n, (i, j) in enumerate(edge))
    return BoardSheet((width, height), round(_TAG_SHARE * pitch, 1), places, paper, middle)


def write_board_pdf(
    path: Path, *, paper: Paper = "a4", first_id: int | None = None, middle: Middle = "white"
) -> tuple[Path, Path]:
    """Write a board as PDF, drawn in exact millimetres, and its description beside it.

    Args:
        path: the PDF; the description has the same name with the suffix .json.
        paper, first_id, middle: see `make_board_sheet`.

    Returns:
        Both files.

    Raises:
        ToolkitError: the suffix is not .pdf, a file in the place of the description is none, or
            see `make_board_sheet`.
    """
    if path.suffix.lower() != ".pdf":
        raise ToolkitError("must end in .pdf", path=path, field="--out", value=path.name)
    sheet = make_board_sheet(paper, first_id=first_id, middle=middle)
    description = path.with_suffix(".json")
    if description.exists() and not _is_description(description):
        raise ToolkitError(
            "is no description of a board and would be replaced", path=description, field="--out",
            hint="give the PDF another name",
        )  # fmt: skip
    write_bytes_atomic(path, _pdf(sheet, description.name))
    text = json.dumps(sheet.document(), indent=1)
    write_bytes_atomic(description, text.encode() + b"\n")
    return path, description


def _is_description(path: Path) -> bool:
    try:
        Board.read(path)
    except ToolkitError:
        return False
    return True


def _pdf(sheet: BoardSheet, description: str) -> bytes:
    """A PDF of one page, in filled rectangles and two lines of text."""
    width, height = sheet.paper_mm
    middle = width / 2, height / 2
    drawn = ["0 g"]

    def box(x: float, y: float, w: float, h: float) -> None:
        """A rectangle in mm from the middle of the sheet."""
        numbers = ((x + middle[0]) * _PT, (y + middle[1]) * _PT, w * _PT, h * _PT)
        drawn.append(" ".join(f"{v:.4f}" for v in numbers) + " re f")

    def text(x: float, y: float, size: float, words: str) -> None:
        escaped = words.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        place = f"{(x + middle[0]) * _PT:.3f} {(y + middle[1]) * _PT:.3f}"
        drawn.append(f"BT /F1 {size} Tf {place} Td ({escaped}) Tj ET")

    for x, y, w, h in sheet.cells():
        box(x, y, w, h)
    low = -middle[1] + 7.0
    box(-_RULER_MM / 2, low, _RULER_MM, 0.25)
    for end in (-_RULER_MM / 2, _RULER_MM / 2 - 0.25):
        box(end, low - 1.5, 0.25, 3.25)
    text(-_RULER_MM / 2 + 4, low + 1, 7, "100 mm: print at 100 %, without fitting to the page")
    # Half crosses: where the object stands, and the x axis.
    light = "0.75 g"
    drawn.append(light)
    for x, y, w, h, grey in sheet.middle_cells():
        drawn.append(f"{grey:g} g")
        box(x, y, w, h)
    drawn.append(light if sheet.middle == "white" else "0.9 g")
    box(-6, -0.15, 24, 0.3)
    box(-0.15, -6, 0.3, 12)
    text(19, -0.9, 7, "x")
    text(-13, -11, 7, "lay flat, object here")
    drawn.append("0.4 g")
    first, last = sheet.ids
    family = "AprilTag 36h11"
    text(-_RULER_MM / 2 + 4, low - 2.6, 5, f"{description}: {family}, ids {first} to {last}, "
         f"tags of {sheet.tag_mm:g} mm, {sheet.paper}")  # fmt: skip
    stream = "\n".join(drawn).encode("latin-1", "replace")
    page = f"/MediaBox [0 0 {width * _PT:.4f} {height * _PT:.4f}]".encode()
    objects = (
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        b"<< /Type /Page /Parent 2 0 R " + page + b" /Contents 4 0 R "
        b"/Resources << /Font << /F1 5 0 R >> >> >>",
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    )
    out = bytearray(b"%PDF-1.4\n")
    starts = []
    for number, body in enumerate(objects, start=1):
        starts.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % s for s in starts)
    out += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (
        len(objects) + 1,
        table,
    )
    return bytes(out)


def _dictionary() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARY))


def _tag(number: int) -> NDArray[np.uint8]:
    """(8, 8) cells of a tag, 0 black and 255 white."""
    return np.asarray(_dictionary().generateImageMarker(number, _CELLS), np.uint8)
