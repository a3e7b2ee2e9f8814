"""Pages are data: every text is escaped, every id is safe, empty sections are left out."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from std_toolkit.html.page import (
    Bullets,
    Columns,
    Details,
    Fact,
    Figure,
    Gallery,
    Heading,
    Legend,
    LegendEntry,
    Page,
    Paragraph,
    Picture,
    Plot,
    Section,
    Terms,
    Verdict,
)
from std_toolkit.html.templates import slug

EVIL = """x" onload='alert(1)'><script>alert(1)</script>"""


def test_no_text_becomes_markup() -> None:
    picture = Figure(Picture(b"x", EVIL, 4, 3, [(0, EVIL)]), EVIL, {0: EVIL})
    blocks = [
        Paragraph(EVIL, EVIL, EVIL), Bullets([Paragraph(EVIL)]), Heading(EVIL, color=EVIL),
        Plot(EVIL, "{}"), Terms({EVIL: EVIL}), Legend([LegendEntry(EVIL, EVIL)]),
        Gallery([picture], heads=[EVIL]), Details(EVIL, [Paragraph(EVIL)]),
        Columns([Paragraph(EVIL)]),
    ]  # fmt: skip
    page = Page(
        kind=EVIL, title=EVIL, tab_title=EVIL, footer=EVIL, intro=blocks,
        verdicts=[Verdict(EVIL, EVIL, EVIL)], facts=[Fact(EVIL, EVIL, EVIL)],
        sections=[Section(EVIL, EVIL, blocks, EVIL)],
    ).html()  # fmt: skip
    assert "<script>alert" not in page
    assert "onload='" not in page and 'x" ' not in page
    for name in re.findall(r'\bid="([^"]*)"', page):
        assert re.fullmatch(r"[A-Za-z0-9_-]+", name)


@given(st.text(max_size=20), st.text(max_size=20))
def test_an_id_is_safe_and_of_one_name(first: str, second: str) -> None:
    assert re.fullmatch(r"[A-Za-z0-9_-]*", slug(first))
    assert first == second or slug(first) != slug(second)


def test_what_is_empty_is_left_out() -> None:
    empty = [Plot("p", None), Bullets([]), Gallery([]), Columns([Plot("p", None)]), Legend([])]
    sections = [Section("none", "Nothing", empty), Section("some", "Some", [Paragraph("text")])]
    page = Page(kind="k", title="t", footer="", sections=sections).html()
    assert "Nothing" not in page and "Some" in page
    assert "Plotly, Inc." not in page  # no figure, no library


def test_a_page_with_a_figure_carries_the_library_once() -> None:
    figures = [Details("more", [Columns([Plot("a", "{}"), Plot("b", "{}")])])]
    page = Page(kind="k", title="t", footer="", sections=[Section("s", "S", figures)]).html()
    assert page.count("plotly.js v") == 1 and "MIT license" in page
    assert len(page) < 2_200_000


@pytest.mark.parametrize("name", ["large", "outlines", "plotly"])
def test_a_name_does_not_take_an_id_of_the_page(name: str) -> None:
    blocks = [Plot(name, "{}"), Paragraph("text")]
    sections = [Section(name, "S", blocks)]
    page = Page(kind="k", title="t", footer="", sections=sections, outlines=True).html()
    ids = re.findall(r'\bid="([^"]*)"', page)
    assert len(ids) == len(set(ids))
