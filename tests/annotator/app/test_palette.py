"""Every word can be read on the surface on which it stands, in both themes."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

import annotator
from annotator.app.palette import (
    DARK,
    LIGHT,
    SURFACES,
    WORDS,
    Palette,
    contrast,
    stepped,
    style_sheet,
)

THEMES = pytest.mark.parametrize("palette", [DARK, LIGHT], ids=["dark", "light"])
PAGE_CSS = Path(annotator.__file__).parent / "web" / "static" / "page.css"


def test_contrast_is_that_of_wcag() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#ffffff", "#ffffff") == 1.0
    # Known of the guideline: the lightest grey that passes on white.
    assert contrast("#767676", "#ffffff") >= 4.5 > contrast("#777777", "#ffffff")
    # A colour, from the definition: 0.2126 R + 0.7152 G + 0.0722 B of linear light.
    assert contrast("#ff0000", "#000000") == pytest.approx((0.2126 + 0.05) / 0.05)


@THEMES
def test_words_stand_out_from_their_surfaces(palette: Palette) -> None:
    low = {
        f"{word} on {surface}": round(value, 2)
        for surface, words in WORDS.items()
        for word in words
        if (value := contrast(getattr(palette, word), getattr(palette, surface))) < 4.5
    }
    assert low == {}


@THEMES
def test_edges_of_what_has_the_focus_and_marks_stand_out(palette: Palette) -> None:
    """As WCAG asks of parts that are not words."""
    for surface in SURFACES:
        assert contrast(palette.accent, getattr(palette, surface)) >= 3.0


@THEMES
def test_colours_are_six_digits_and_words_differ(palette: Palette) -> None:
    colors = dataclasses.asdict(palette)
    assert all(re.fullmatch("#[0-9a-f]{6}", color) for color in colors.values())
    # Icons that are drawn anew know by their colour what they are.
    words = [colors[w] for w in ("text", "muted", "faint", "accent", "good", "warning", "bad")]
    assert len(set(words)) == len(words)


def test_surfaces_are_grey_and_images_lie_on_the_same_dark_one() -> None:
    for palette in (DARK, LIGHT):
        for surface in (*SURFACES, "stage"):
            color = getattr(palette, surface)
            assert color[1:3] == color[3:5] == color[5:7]
    assert LIGHT.stage == DARK.stage


def test_the_page_has_its_colours_from_the_palette() -> None:
    css = PAGE_CSS.read_text(encoding="utf-8")
    known = {f"--{f.name.replace('_', '-')}" for f in dataclasses.fields(Palette)}
    used = set(re.findall(r"var\((--[a-z-]+)", css)) - {"--aspect", "--text-share"}
    assert used <= known
    own = re.findall(r"#[0-9a-f]{3,8}\b(?=[;, ])", css)
    # A shadow, and the veil over a page that has lost its server.
    assert own == ["#0008", "#14161acc"]
    sheet = style_sheet()
    for palette in (DARK, LIGHT):
        assert f"--text:{palette.text};" in sheet


def test_text_sizes_go_from_90_to_150_percent() -> None:
    assert stepped(100, 1) == 110
    assert stepped(150, 1) == 150
    assert stepped(100, -3) == 90
    assert stepped(9999, 0) == 150
