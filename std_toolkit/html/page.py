"""The page of all reports: one self-contained HTML file.

A page is data: sections of blocks, which the templates render to HTML. Reports write no HTML
themselves, so that every text is escaped in one place.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, Protocol

from std_toolkit.errors import ToolkitError
from std_toolkit.html.templates import environment


class Block(Protocol):
    """A part of a section: a `Table`, or one of the classes below."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph:
    """A paragraph with an optional bold `lead`; `tone` "good" or "bad" colours the lead."""

    text: str
    lead: str = ""
    tone: str = ""
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: Sequence[Paragraph]
    kind: ClassVar[str] = "bullets"

    @property
    def empty(self) -> bool:
        return not self.items


@dataclass(frozen=True)
class Heading:
    """A subheading with a colour sample."""

    text: str
    level: int = 3
    color: str = ""
    kind: ClassVar[str] = "heading"


@dataclass(frozen=True)
class Plot:
    """A Plotly figure as JSON, safe inside a script (`figure_json`); None for no figure."""

    name: str
    figure: str | None
    kind: ClassVar[str] = "plot"

    @property
    def empty(self) -> bool:
        return self.figure is None


@dataclass(frozen=True)
class Terms:
    """Definitions of the columns of a table."""

    meanings: Mapping[str, str]
    kind: ClassVar[str] = "terms"


@dataclass(frozen=True)
class Links:
    """Other pages and files of the same site: text and address relative to this page."""

    items: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "links"


@dataclass(frozen=True)
class LegendEntry:
    """A colour or a gradient (CSS), its width in pixels, and its meaning."""

    background: str
    text: str
    width: int = 11


@dataclass(frozen=True)
class Legend:
    """A legend of colours."""

    entries: Sequence[LegendEntry]
    kind: ClassVar[str] = "legend"

    @property
    def empty(self) -> bool:
        return not self.entries


@dataclass(frozen=True)
class Picture:
    """An image and outlines above it.

    Attributes:
        data: the image file.
        mime: its type, such as "image/jpeg".
        width, height: size of the image in pixels, the unit of the outlines.
        outlines: (object id, SVG path data).
    """

    data: bytes
    mime: str
    width: int
    height: int
    outlines: list[tuple[int, str]] = field(default_factory=list)

    @staticmethod
    def read(folder: Path, name: str, *, width: int = 1200, quality: int = 75) -> Picture:
        """A picture file as WebP, reduced if it is wider than `width`.

        Args:
            folder: of the picture; others may have written it.
            name: of an image file in it.
            width: largest width in pixels.
            quality: quality of the compression, 0 to 100.

        Raises:
            ToolkitError: it is no file of the folder itself, or cannot be read.
        """
        import cv2

        from std_toolkit.io.images import read_color

        path = folder / name
        if Path(name).name != name or path.is_symlink():
            raise ToolkitError(
                "is no file of this folder", path=folder, field="picture", value=name
            )
        image = cv2.cvtColor(read_color(path), cv2.COLOR_RGB2BGR)
        if image.shape[1] > width:
            size = (width, round(width * image.shape[0] / image.shape[1]))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])[1]
        return Picture(data.tobytes(), "image/webp", image.shape[1], image.shape[0])


@dataclass(frozen=True)
class Figure:
    """A picture with its caption; `colors` of the outlines by object id."""

    picture: Picture
    caption: str = ""
    colors: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Gallery:
    """Pictures side by side; a click enlarges one.

    Attributes:
        figures: the pictures.
        layout: "wide", "small" (as many in a row as fit) or "fixed".
        abreast: pictures in a row of the layout "fixed".
        heads: titles above the panels of every picture.
    """

    figures: Sequence[Figure]
    layout: str = "fixed"
    abreast: int = 1
    heads: Sequence[str] = ()
    kind: ClassVar[str] = "gallery"

    @property
    def empty(self) -> bool:
        return not self.figures


@dataclass(frozen=True)
class Columns:
    """Blocks side by side if there is room."""

    blocks: Sequence[Block]
    kind: ClassVar[str] = "columns"

    @property
    def shown(self) -> list[Block]:
        return shown(self.blocks)

    @property
    def empty(self) -> bool:
        return not self.shown


@dataclass(frozen=True)
class Details:
    """Blocks that are hidden until a click on the title."""

    title: str
    blocks: Sequence[Block]
    open: bool = False
    kind: ClassVar[str] = "details"


@dataclass(frozen=True)
class Section:
    """A section; empty sections are omitted.

    Attributes:
        anchor: its element id, unique on the page.
        title: its heading, and its link in the navigation.
        blocks: its content.
        mark: a small warning beside the heading.
    """

    anchor: str
    title: str
    blocks: Sequence[Block]
    mark: str = ""

    @property
    def shown(self) -> list[Block]:
        return shown(self.blocks)


@dataclass(frozen=True)
class Verdict:
    """A line in the head of the page; `state` is "pass", "fail" or empty."""

    text: str
    word: str = ""
    state: str = ""


@dataclass(frozen=True)
class Fact:
    """A figure in the head of the page."""

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page; the same content gives the same bytes.

    Attributes:
        kind: kind of report, such as "Label check".
        title: its heading.
        sections: its content.
        footer: program that made it.
        tab_title: title of the browser tab; empty for `title`.
        verdicts, intro, facts: the head of the page.
        outlines: whether the page has a switch that hides the outlines above the pictures.
    """

    kind: str
    title: str
    sections: Sequence[Section]
    footer: str
    tab_title: str = ""
    verdicts: Sequence[Verdict] = ()
    intro: Sequence[Block] = ()
    facts: Sequence[Fact] = ()
    outlines: bool = False

    def html(self) -> str:
        """The page as one file."""
        sections = [section for section in self.sections if section.shown]
        drawn = any(_has_plot(section.shown) for section in sections)
        program = environment().get_template("page.js").render()
        plotly = _plotly() if drawn else None
        return (
            environment()
            .get_template("page.html")
            .render(
                page=self,
                sections=sections,
                plotly=plotly,
                program=program,
                policy=_policy(program, plotly),
            )
        )


def shown(blocks: Sequence[Block]) -> list[Block]:
    """The blocks that are not empty."""
    return [block for block in blocks if not getattr(block, "empty", False)]


def _has_plot(blocks: Sequence[Block]) -> bool:
    return any(b.kind == "plot" or _has_plot(getattr(b, "blocks", ())) for b in blocks)


@lru_cache(maxsize=1)
def _plotly() -> dict[str, str]:
    """Plotly, compressed to a third of its 5 MB, and the notice of its licence."""
    from plotly.offline import get_plotlyjs

    source = get_plotlyjs()
    notice = source[: source.index("*/")].replace("/**", "").replace("\n* ", "\n").strip()
    packed = gzip.compress(source.encode(), 9, mtime=0)
    return {
        "notice": notice,
        "data": base64.b64encode(packed).decode("ascii"),
        "digest": script_digest(source),
    }


def _policy(program: str, plotly: Mapping[str, str] | None) -> str:
    """Content security policy: the page runs its own scripts alone and loads nothing.

    Plotly compiles functions for its 3D views, which `unsafe-eval` permits; a script that got into
    the page as text still does not run.
    """
    scripts = f"'{script_digest(program)}'"
    if plotly is not None:
        scripts += f" '{plotly['digest']}' 'unsafe-eval'"
    return (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
        f"script-src {scripts}; base-uri 'none'; form-action 'none'"
    )


def script_digest(source: str) -> str:
    """The source of a script as a content security policy names it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode("ascii")
