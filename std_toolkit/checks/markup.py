"""Small pieces of HTML: numbers, tables, pictures, plots. All text is escaped here."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from std_toolkit.checks.overlay import Picture

MINUS = "\u2212"
DASH = '<span class="none">–</span>'


@dataclass(frozen=True)
class Cell:
    """A table cell: HTML, numeric or not, over a limit or not."""

    html: str
    numeric: bool = False
    over: bool = False


def number(value: float | None, digits: int = 1, *, sign: bool = False) -> str:
    """A number with fixed digits and a true minus; a dash for a missing one."""
    if value is None:
        return DASH
    text = f"{value:+.{digits}f}" if sign else f"{value:.{digits}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def amount(value: float | None, digits: int = 1, *, sign: bool = False, over: bool = False) -> Cell:
    """A numeric cell."""
    return Cell(number(value, digits, sign=sign), numeric=True, over=over)


def percent(value: float | None, digits: int = 0) -> Cell:
    """A share 0..1 as a cell in percent."""
    return Cell(DASH if value is None else f"{100 * value:.{digits}f} %", numeric=True)


def text(value: str, *, small: str = "") -> Cell:
    """A text cell, with a second faint line."""
    note = f"<small>{words(small)}</small>" if small else ""
    return Cell(words(value) + note if value else DASH + note)


def tag(kind: str, label: str | None = None) -> Cell:
    """A coloured word."""
    return Cell(f'<span class="tag {escape(kind)}">{escape(label or kind)}</span>')


def chip(color: str, label: str) -> str:
    """A colour sample and its name."""
    return f'<span><i class="chip" style="background:{color}"></i>{escape(label)}</span>'


def table(heads: Sequence[tuple[str, str]], rows: Sequence[Sequence[Cell]]) -> str:
    """A table. Heads are (title, unit); a column is numeric if its first cell is."""
    if not rows:
        return ""
    numeric = [c.numeric for c in rows[0]]
    head = "".join(
        f"<th{' class=n' if n else ''}>{escape(title)}<small>{escape(unit)}</small></th>"
        if unit
        else f"<th{' class=n' if n else ''}>{escape(title)}</th>"
        for (title, unit), n in zip(heads, numeric, strict=True)
    )
    body = "".join(f"<tr>{''.join(_cell(c) for c in row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def plot(name: str, figure: str | None) -> str:
    """A place for a figure and its JSON; nothing for no figure."""
    if figure is None:
        return ""
    return (
        f'<div class="plot" id="plot-{name}"></div>'
        f'<script type="application/json" data-plot="plot-{name}">{figure}</script>'
    )


def picture(image: Picture, colors: Mapping[int, str], caption: str = "") -> str:
    """An image with its outlines; a click enlarges it."""
    data = base64.b64encode(image.data).decode("ascii")
    paths = "".join(
        f'<path class="halo" d="{d}"/><path class="line" stroke="{colors[i]}" d="{d}"/>'
        for i, d in image.outlines
    )
    svg = f'<svg viewBox="0 0 {image.width} {image.height}">{paths}</svg>' if paths else ""
    note = f"<figcaption>{caption}</figcaption>" if caption else ""
    return (
        f'<figure><div class="picture" data-w="{image.width}" data-h="{image.height}">'
        f'<img alt="" width="{image.width}" height="{image.height}" '
        f'src="data:{image.mime};base64,{data}">{svg}</div>{note}</figure>'
    )


def section(name: str, title: str, *parts: str) -> str:
    """A section with an anchor; nothing if all its parts are empty."""
    body = "".join(parts)
    return f'<section id="{name}"><h2>{escape(title)}</h2>{body}</section>' if body else ""


def definitions(meanings: Mapping[str, str]) -> str:
    """What the columns of a table mean."""
    return (
        '<dl class="terms">'
        + "".join(f"<dt>{escape(k)}</dt><dd>{words(v)}</dd>" for k, v in meanings.items())
        + "</dl>"
    )


def words(value: str) -> str:
    """Escaped text in which commands between backticks look like commands."""
    parts = escape(value).split("`")
    return "".join(f"<code>{p}</code>" if i % 2 else p for i, p in enumerate(parts))


def paragraph(value: str) -> str:
    return f"<p>{words(value)}</p>"


def _cell(cell: Cell) -> str:
    names = [n for n, on in (("n", cell.numeric), ("over", cell.over)) if on]
    return f'<td class="{" ".join(names)}">{cell.html}</td>' if names else f"<td>{cell.html}</td>"
