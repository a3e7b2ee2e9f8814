"""A table has the same cells on the terminal, in Markdown, in LaTeX and in HTML."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.html.table import Cell, Column, Row, Table, escape_latex

# Two blanks separate the columns of a terminal; a true minus is a dash in LaTeX.
_TEXT = st.text("abcZ019 _%&#<>|\\{}$^~.δ°", min_size=1, max_size=12).map(
    lambda s: re.sub(r"\s+", " ", s).strip() or "x"
)
_CELL = st.builds(
    lambda text, note, best: Cell(text=text, note=note and f"[{note}]", mark=best),
    _TEXT,
    st.sampled_from(["", "1, 2", "a & b"]),
    st.sampled_from(["", "best"]),
)


@st.composite
def tables(draw: st.DrawFn) -> Table:
    count = draw(st.integers(1, 4))
    columns = [
        Column(heading=f"head {i}", unit=draw(st.sampled_from(["", "mm", "%"])), numeric=i > 0)
        for i in range(count)
    ]
    kinds = st.sampled_from(["", "published", "bound"])
    row = st.builds(Row, st.lists(_CELL, min_size=count, max_size=count), kinds)
    return Table(columns=columns, rows=draw(st.lists(row, min_size=1, max_size=5)))


class Cells(HTMLParser):
    """Texts of the cells of every row."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        elif tag == "small":
            self.rows[-1][-1] += " "

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1] and data.strip():
            self.rows[-1][-1] += data


def _ordered(table: Table) -> list[Row]:
    return [row for group in table.groups for row in group]


@given(tables())
def test_all_forms_have_the_same_cells(table: Table) -> None:
    rows = _ordered(table)
    plain = [[cell.plain for cell in row.cells] for row in rows]

    found = [[text.strip() for text in row] for row in Cells(table.html()).rows[1:]]
    assert found == [[text.replace("`", "") for text in row] for row in plain]

    lines = table.markdown().splitlines()[2:]
    for line, row in zip(lines, plain, strict=True):
        cells = line[2:-2].split(" | ")
        read = [re.sub(r"\\\|", "|", c.replace("&lt;", "<")) for c in cells]
        assert [re.sub(r"^\*+|\*+(?= |$)", "", c) for c in read] == row

    body = [line for line in table.latex().splitlines() if line.endswith(r" \\")][1:]
    for line, row in zip(body, rows, strict=True):
        for cell in row.cells:
            assert escape_latex(cell.text) in line and escape_latex(cell.note) in line

    text = table.terminal().splitlines()[1:]
    for line, row in zip(text, rows, strict=True):
        rest = line.removeprefix("* ") if row.kind == "published" else line
        for cell in row.cells:
            assert rest.startswith(cell.plain)
            rest = rest.removeprefix(cell.plain).lstrip()
        assert not rest


def test_measured_rows_come_before_published_ones() -> None:
    column = Column(heading="method", numeric=False)
    rows = [Row([Cell(text=name)], kind) for name, kind in (("A", "published"), ("b", ""))]
    table = Table(columns=[column], rows=rows)  # type: ignore[list-item]
    assert table.terminal() == "method\nb\n* A"
    assert table.markdown().splitlines()[-2:] == ["| b |", "| *A* |"]
    assert table.html().count("<tbody>") == 2  # sorted apart


def test_a_figure_is_written_as_its_column_says() -> None:
    rmse = Column(heading="RMSE", unit="mm", factor=1e3, digits=1, published_digits=0)
    assert rmse.cell(0.0123, interval=(0.01, 0.02)).plain == "12.3 [10.0, 20.0]"
    assert rmse.cell(0.0123, published=True).plain == "12"
    assert rmse.cell(math.nan, interval=(math.nan, 0.1)).plain == ""
    assert rmse.cell(None, missing="–").plain == "–"


def test_notes_are_under_every_heading() -> None:
    column = Column(heading="method", numeric=False)
    table = Table(
        columns=[column], rows=[Row([Cell(text="a")])], title="std", notes=["36 of 22,500 frames"]
    )
    for text in (table.terminal(), table.markdown(), table.latex(), table.html()):
        assert "36 of 22,500 frames" in text


def test_a_row_needs_a_cell_for_each_column() -> None:
    with pytest.raises(ValueError, match="one cell for each column"):
        Table(columns=[Column(heading="a")], rows=[Row([])])


def test_html_is_escaped() -> None:
    evil = '"><script>alert(1)</script>'
    column = Column(heading=evil, unit=evil)
    cell = Cell(text=evil, note=evil, tag=evil, color=evil, shade=evil)
    text = Table(columns=[column], rows=[Row([cell])], title=evil, notes=[evil]).html()
    assert "<script" not in text
    assert "&gt;" in text and "alert(1)" in text
