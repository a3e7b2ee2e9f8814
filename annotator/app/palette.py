"""Colours of the front ends, dark and light: the one table of which both make their styles."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from annotator.app.events import Level


@dataclass(frozen=True, kw_only=True)
class Palette:
    """Colours as "#rrggbb", neutral greys on which the colours of images are judged without bias.

    Attributes:
        base: surface of fields and lists.
        window: surface of panels and bars.
        raised: surface of cards, menus and buttons.
        hover: surface under the pointer.
        stage: background of images and clouds, dark in every theme.
        border: edges.
        text, muted: words, and words of less weight.
        faint: words of what is disabled, and edges of switches.
        accent: edges and words that stand out.
        chosen: surface of what is selected, on which `on_chosen` are the words.
        good, warning, bad: words of a verdict.
        good_mark, warning_mark, bad_mark: surfaces of a verdict, with the words `on_mark`.
    """

    base: str
    window: str
    raised: str
    hover: str
    stage: str = "#1b1b1b"
    border: str
    text: str
    muted: str
    faint: str
    accent: str
    chosen: str
    on_chosen: str
    good: str
    warning: str
    bad: str
    good_mark: str
    warning_mark: str
    bad_mark: str
    on_mark: str = "#ffffff"

    def grade(self, grade: str) -> str:
        """Return the colour of the words of a verdict."""
        inks = {"fits": self.good, "doubtful": self.warning, "wrong": self.bad}
        return inks.get(grade, self.muted)

    def level(self, level: Level) -> str:
        """Return the colour of the sign of a message."""
        return {"info": self.accent, "warning": self.warning, "error": self.bad}[level]


DARK = Palette(
    base="#1f1f1f",
    window="#2a2a2a",
    raised="#353535",
    hover="#414141",
    border="#464646",
    text="#e4e4e4",
    muted="#b4b4b4",
    faint="#747474",
    accent="#7db4e6",
    chosen="#35638c",
    on_chosen="#ffffff",
    good="#78c88d",
    warning="#e0b050",
    bad="#f69b8f",
    good_mark="#1f6b3a",
    warning_mark="#7d5a10",
    bad_mark="#8f2f2f",
)

LIGHT = Palette(
    base="#ffffff",
    window="#f1f1f1",
    raised="#fafafa",
    hover="#dedede",
    border="#bdbdbd",
    text="#1c1c1c",
    muted="#505050",
    faint="#8f8f8f",
    accent="#1a5c96",
    chosen="#cde2f5",
    on_chosen="#101010",
    good="#17652f",
    warning="#7a4f00",
    bad="#a8281a",
    good_mark="#1f6b3a",
    warning_mark="#7d5a10",
    bad_mark="#8f2f2f",
)

SURFACES = ("base", "window", "raised", "hover")

# The words that stand on each surface.
WORDS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(SURFACES, ("text", "muted", "accent", "good", "warning", "bad")),
    "chosen": ("on_chosen",),
    **dict.fromkeys(("good_mark", "warning_mark", "bad_mark"), ("on_mark",)),
}

# Text sizes, percent of the usual one.
SMALLEST_TEXT, USUAL_TEXT, LARGEST_TEXT, TEXT_STEP = 90, 100, 150, 10


def stepped(percent: int, steps: int) -> int:
    """Return a text size that is some steps larger, within the limits."""
    return min(max(percent + TEXT_STEP * steps, SMALLEST_TEXT), LARGEST_TEXT)


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours as WCAG 2 defines it, from 1 to 21."""
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(color: str) -> float:
    """Return the relative luminance of an sRGB colour."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (x / 255 for x in _rgb(color))
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _rgb(color: str) -> tuple[int, int, int]:
    r, g, b = bytes.fromhex(color.removeprefix("#"))
    return r, g, b


# Colours of Vuetify's components, which wants them as "r, g, b".
_VUETIFY = {
    "background": "window",
    "surface": "window",
    "surface-light": "raised",
    "surface-bright": "raised",
    "surface-variant": "text",
    "on-surface-variant": "window",
    "on-background": "text",
    "on-surface": "text",
    "primary": "accent",
    "on-primary": "window",
    "error": "bad",
    "warning": "warning",
    "success": "good",
    "info": "accent",
}


def style_sheet() -> str:
    """Return both palettes as variables of a style sheet; `data-theme` of the page chooses."""
    return "\n".join(
        _rules(root, palette, name)
        for root, palette, name in (
            (":root", DARK, "dark"),
            (":root[data-theme=light]", LIGHT, "light"),
        )
    )


def _rules(root: str, palette: Palette, name: str) -> str:
    values = dataclasses.asdict(palette)
    own = "".join(f"--{k.replace('_', '-')}:{v};" for k, v in values.items())
    theirs = "".join(
        f"--v-theme-{k}:{','.join(map(str, _rgb(values[v])))};" for k, v in _VUETIFY.items()
    )
    # Both classes: Vuetify keeps the theme that it was started with.
    themed = f"{root} .v-theme--dark,{root} .v-theme--light"
    emphasis = "--v-medium-emphasis-opacity:.85;--v-high-emphasis-opacity:1;"
    return (
        f"{root}{{{own}color-scheme:{name};}}\n{themed}{{{theirs}{emphasis}color-scheme:{name};}}"
    )
