"""Measured figures: one row of docs/results/*.csv each, shown in pages between invisible comments.

`python tools/figures.py` (or `make figures`) writes the rows' values into README.md, docs/*.md and
the cards of the weights; with `--check` it only prints what is wrong, exit status 1 if anything is.

A page shows the value of the row NAME by `<!--=NAME-->24.2<!--/--> mm`, its interval by
`<!--=NAME:interval-->19.7, 28.5<!--/-->`. Settings and facts of the world, which nobody measured
here, stand in `<!--fact-->...<!--/-->`; any other number with a unit is a problem (`unmarked`).
`commit` of a row is the commit that brought the figure: measured on this tree or its parent's.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RESULTS = "docs/results"

UNITS = (
    *("mm", "cm", "m", "um", "px", "pixels", "pixel", "%", "percent", "deg", "degrees", "degree"),
    *("s", "seconds", "ms", "min", "minutes", "h", "hours", "frames/s"),
    *("kB", "KB", "MB", "GB", "KiB", "MiB", "GiB", "x"),
)
_NAME = r"[a-z0-9_]+(?:[.-][a-z0-9_]+)+"
_UNIT = "(?:" + "|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True)) + ")"
_UNIT += r"(?![\w/])"  # "m" does not begin "mugs", nor "s" "s/frame"
_MARK = re.compile(rf"<!--=({_NAME})(:interval)?-->(.*?)<!--/-->")
_ANY_MARK = re.compile(r"<!--=.*?-->")
_FACT = re.compile(r"<!--fact-->(.*?)<!--/-->", re.DOTALL)
_LINE_START = re.compile(
    r"^[ \t]*(?:(?:[-*+]|\d+\.)[ \t]+)?(<!--(?:=.*?|fact|/)-->)(?![ \t]*$)", re.MULTILINE
)
_CODE = re.compile(
    r"^( *)(```|~~~).*?^\1\2[^\n]*$|(`+)(?!`)(?:(?!\n\n).)+?(?<!`)\3(?!`)", re.MULTILINE | re.DOTALL
)
_MEASURED = re.compile(rf"(?<![\w.°])\d[\d,]*(?:\.\d+)?(?: ?(?!x ?\d){_UNIT})")
_IN_HEADER = re.compile(rf"(?:^|[ \[(]){_UNIT}[\])]?$")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A row; all fields as they are printed.

    Attributes:
        name: dotted key, the first part of which is the file's name.
        claim: what was measured, on what.
        value: the number; `interval`, if any, is its 95 % interval.
        unit: one of `UNITS`, or nothing.
        command: what measures it again.
        commit: that brought it, or nothing.
        machine: in words.
        date: YYYY-MM-DD.
    """

    name: str
    claim: str
    value: str
    unit: str
    interval: str
    command: str
    commit: str
    machine: str
    date: str


COLUMNS = tuple(field.name for field in fields(Figure))


def read_figures(root: Path = ROOT) -> dict[str, Figure]:
    """All rows by name.

    Raises:
        ValueError: a table with other columns, or a name that occurs twice.
    """
    figures: dict[str, Figure] = {}
    for path in sorted((root / RESULTS).glob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.reader(file, strict=True)
            if tuple(next(reader)) != COLUMNS:
                raise ValueError(f"{path}: the columns must be {','.join(COLUMNS)}")
            for cells in reader:
                if len(cells) != len(COLUMNS):
                    raise ValueError(
                        f"{path}:{reader.line_num}: {len(cells)} cells, not {len(COLUMNS)}"
                    )
                figure = Figure(**dict(zip(COLUMNS, cells, strict=True)))
                if figure.name in figures:
                    raise ValueError(f"{path}:{reader.line_num}: {figure.name} is there twice")
                if figure.name.partition(".")[0] != path.stem:
                    raise ValueError(f"{path}:{reader.line_num}: {figure.name} begins otherwise")
                figures[figure.name] = figure
    return figures


def pages(root: Path = ROOT) -> list[Path]:
    """The pages that may show figures."""
    cards = (root / "benchmark/weights").glob("*.md")
    return [root / "README.md", *sorted((root / "docs").glob("*.md")), *sorted(cards)]


def refreshed(text: str, figures: dict[str, Figure]) -> str:
    """The text of a page with the values of today's rows; marks without a row stay."""

    def now(match: re.Match[str]) -> str:
        name, interval, _ = match.groups()
        if name not in figures:
            return match[0]
        value = figures[name].interval if interval else figures[name].value
        return f"<!--={name}{interval or ''}-->{value}<!--/-->"

    return _MARK.sub(now, text)


def used(text: str) -> set[str]:
    """Names of the rows that a page shows."""
    return {match[1] for match in _MARK.finditer(text)}


def wrong_marks(text: str, figures: dict[str, Figure]) -> Iterator[str]:
    """What is wrong with the marks of a page."""
    plain = _CODE.sub("", text)
    if _ANY_MARK.findall(text) != _ANY_MARK.findall(plain):
        yield "a mark in code would be visible"
    for match in _LINE_START.finditer(plain):
        yield f"{match[1]} at the start of a line or list item: GitHub shows the rest unformatted"
    for match in _FACT.finditer(plain):
        if "<!--" in match[1]:
            yield f"<!--fact--> is not closed before {match[1][match[1].index('<!--') :][:40]}"
    rest = _FACT.sub("", _MARK.sub("", plain))
    for stray in re.findall(r"<!--(?:=.*?|/|fact)-->", rest):
        yield f"{stray} without its pair, on one line"
    for match in _MARK.finditer(plain):
        name, interval, shown = match.groups()
        if name not in figures:
            yield f"no row {name}"
            continue
        row = figures[name]
        value = row.interval if interval else row.value
        if shown != value or not value:
            yield f"{name} is {value or 'nothing'}, the page says {shown}: run `make figures`"
        unit = re.match(rf" ?({_UNIT})", plain[match.end() :].replace("**", "", 1))
        if unit and row.unit != unit[1]:
            yield f"{name} is in {row.unit or 'no unit'}, the page says {unit[1]}"


def unmarked(text: str) -> Iterator[str]:
    """Numbers with a unit (or below a heading with one) outside marks, facts and code."""
    plain = _MARK.sub("", _FACT.sub("", _CODE.sub("", text)))
    plain = re.sub(r"<!--.*?-->|\]\([^)]*\)", "", plain, flags=re.DOTALL)
    for match in _MEASURED.finditer(plain):
        yield f"{match[0]!r} in {plain[max(0, match.start() - 40) : match.end() + 20]!r}"
    for block in re.findall(r"(?:^\|.*\n)+", plain, re.MULTILINE):
        head, _, *rows = (
            [c.strip("* ") for c in line.strip("|\n ").split("|")] for line in block.splitlines()
        )
        columns = [i for i, title in enumerate(head) if _IN_HEADER.search(title)]
        for row in rows:
            for i in columns:
                if i < len(row) and re.search(r"\d", row[i]):
                    yield f"{row[i]!r} below {head[i]!r} in the row of {row[0]!r}"


def main(words: list[str]) -> int:
    """Refresh the pages, or print what is wrong."""
    figures = read_figures()
    problems = []
    shown: set[str] = set()
    for path in pages():
        text = path.read_text(encoding="utf-8")
        if "--check" not in words and (new := refreshed(text, figures)) != text:
            path.write_text(new, encoding="utf-8")
            print(f"refreshed {path.relative_to(ROOT)}")
            text = new
        problems += [f"{path.relative_to(ROOT)}: {p}" for p in wrong_marks(text, figures)]
        shown |= used(text)
    problems += [f"no page shows {name}: delete its row" for name in sorted(set(figures) - shown)]
    print("\n".join(problems) or f"{len(figures)} figures, each shown as measured")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
