"""Tables for the terminal, Markdown, LaTeX and HTML: columns, rows, and notes under the heading.

The four formats have the same cells. Features of one format (colours, shades, sorting) supplement
the text of a cell and never replace it.
"""

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

MINUS = "\u2212"
NONE = "\u2013"
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "δ": r"$\delta$", "°": r"$^\circ$", "≈": r"$\approx$", "±": r"$\pm$", "≤": r"$\leq$",
    "≥": r"$\geq$", MINUS: "$-$", NONE: "--", "\u00a0": "~", "<": r"\textless{}",
    ">": r"\textgreater{}",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell.

    Attributes:
        text: text in every format.
        note: a smaller addition, such as an interval in brackets.
        value: sort key in an HTML table; NaN for none.
        mark: "best" is bold, "bad" is over a limit, "none" is faint.
        tag: the text is a coloured word of this kind (HTML).
        color: CSS colour of a sample before the text (HTML).
        shade: CSS colour of the background (HTML).
        href: page that the text leads to, relative to this one (HTML).
    """

    text: str
    note: str = ""
    value: float = math.nan
    mark: Literal["", "best", "bad", "none"] = ""
    tag: str = ""
    color: str = ""
    shade: str = ""
    href: str = ""

    @property
    def plain(self) -> str:
        """Text and note on one line."""
        return f"{self.text} {self.note}".strip()


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column.

    Attributes:
        heading, unit: as printed.
        name: name of the figure in a table of results; empty if the cells are made separately.
        numeric: whether numbers are right-aligned and sorted by value.
        factor: from the stored to the printed unit.
        digits: decimal places.
        published_digits: decimal places of figures from a paper; None for `digits`.
        signed: whether a plus is printed.
        lower_is_better: None if neither direction is better.
    """

    heading: str
    unit: str = ""
    name: str = ""
    numeric: bool = True
    factor: float = 1.0
    digits: int = 1
    published_digits: int | None = None
    signed: bool = False
    lower_is_better: bool | None = None

    @property
    def title(self) -> str:
        """Heading and unit.

        >>> Column(heading="RMSE", unit="mm").title
        'RMSE [mm]'
        """
        return f"{self.heading} [{self.unit}]" if self.unit else self.heading

    def text(self, value: float | None, *, published: bool = False) -> str:
        """A figure as text; empty if it is missing."""
        if value is None or math.isnan(value):
            return ""
        printed = published and self.published_digits is not None
        digits = self.published_digits if printed else self.digits
        return number(value * self.factor, digits or 0, signed=self.signed)

    def cell(
        self,
        value: float | None,
        *,
        interval: tuple[float, float] = (math.nan, math.nan),
        published: bool = False,
        mark: Literal["", "best", "bad", "none"] = "",
        missing: str = "",
    ) -> Cell:
        """A figure with its interval in brackets; `missing` if there is none."""
        low, high = interval
        known = not (math.isnan(low) or math.isnan(high))
        return Cell(
            text=self.text(value, published=published) or missing,
            note=f"[{self.text(low)}, {self.text(high)}]" if known else "",
            value=math.nan if value is None else float(value),
            mark=mark,
        )


@dataclass(frozen=True)
class Row:
    """A row.

    Attributes:
        cells: one for each column.
        kind: "published" rows are below the measured ones and in italics; "bound" rows do not
            compete, such as results on true depth, and are faint.
    """

    cells: Sequence[Cell]
    kind: Literal["", "published", "bound"] = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table.

    Attributes:
        columns, rows: its content; measured rows always precede published ones.
        title: its heading.
        notes: sentences under the heading.
        sortable: whether a click on a heading sorts the HTML table, measured and published rows
            separately.
        filters: titles of the columns by whose texts rows of the HTML table can be chosen, beside a
            field that finds any text; None for neither.

    Raises:
        ValueError: a row does not have one cell for each column.
    """

    columns: Sequence[Column]
    rows: Sequence[Row]
    title: str = ""
    notes: Sequence[str] = ()
    sortable: bool = False
    filters: Sequence[str] | None = None
    kind: ClassVar[str] = "table"

    def __post_init__(self) -> None:
        if any(len(row.cells) != len(self.columns) for row in self.rows):
            raise ValueError("every row needs one cell for each column")

    @property
    def empty(self) -> bool:
        return not self.rows

    @property
    def groups(self) -> list[list[Row]]:
        """The measured rows, then the published ones; empty groups are omitted."""
        published = [row for row in self.rows if row.kind == "published"]
        measured = [row for row in self.rows if row.kind != "published"]
        return [group for group in (measured, published) if group]

    def without(self, heading: str) -> "Table":
        """The table without the column of this heading, if it has one."""
        kept = [i for i, column in enumerate(self.columns) if column.heading != heading]
        return self._part(self.rows, kept)

    @property
    def figure_names(self) -> list[str]:
        """Names by which `chosen` knows the columns of figures: their names, else headings."""
        return [c.name or c.heading for c in self.columns if c.numeric]

    @property
    def row_names(self) -> list[str]:
        """Texts by which `chosen` knows rows: those of cells that are no figures."""
        texts = [i for i, column in enumerate(self.columns) if not column.numeric]
        return [row.cells[i].text for row in self.rows for i in texts]

    def chosen(self, rows: Sequence[str], columns: Sequence[str]) -> "Table | None":
        """The table of some rows and columns; None if nothing of it is left.

        Args:
            rows: see `row_names`; empty for all.
            columns: see `figure_names`; empty for all. Columns of text stay.
        """
        texts = [i for i, column in enumerate(self.columns) if not column.numeric]
        found = [
            row for row in self.rows if not rows or {row.cells[i].text for i in texts} & {*rows}
        ]
        by_name = {c.name or c.heading: i for i, c in enumerate(self.columns) if c.numeric}
        wanted = [by_name[name] for name in columns if name in by_name]
        if not found or (columns and not wanted):
            return None
        kept = wanted or list(by_name.values())
        first = [i for i in texts if i < min(kept, default=0)] or texts[:1]
        last = [i for i in texts if i not in first]
        return self._part(found, [*first, *kept, *last])

    def _part(self, rows: Sequence[Row], columns: Sequence[int]) -> "Table":
        made = [replace(row, cells=[row.cells[i] for i in columns]) for row in rows]
        return replace(self, columns=[self.columns[i] for i in columns], rows=made)

    def terminal(self, *, notes: bool = True) -> str:
        """Aligned text, with or without the notes of cells; published rows start with a star."""
        lines = [[column.title for column in self.columns]]
        for row in self._ordered():
            cells = [cell.plain if notes else cell.text for cell in row.cells]
            cells[0] = ("* " if row.kind == "published" else "") + cells[0]
            lines.append(cells)
        head = [self.title] if self.title else []
        numeric = [column.numeric for column in self.columns]
        return "\n".join([*head, *self.notes, _aligned(lines, numeric)])

    def markdown(self) -> str:
        """GitHub's Markdown; published rows in italics, best figures bold."""
        lines = [f"### {self.title}", ""] if self.title else []
        lines += [*self.notes, ""] if self.notes else []
        lines.append(_bar(_pipes(column.title) for column in self.columns))
        lines.append("|" + "|".join("---:" if c.numeric else "---" for c in self.columns) + "|")
        for row in self._ordered():
            lines.append(_bar(_framed(_pipes, c, row, "**{}**", "*{}*") for c in row.cells))
        return "\n".join(lines)

    def latex(self) -> str:
        """LaTeX with booktabs; published rows in italics, best figures bold."""
        title = ". ".join([self.title, *(note.rstrip(".") for note in self.notes)])
        lines = [r"\begin{table}[t]", r"\centering", rf"\caption{{{escape_latex(title)}}}"]
        lines.append(
            rf"\begin{{tabular}}{{{''.join('r' if c.numeric else 'l' for c in self.columns)}}}"
        )
        heads = " & ".join(escape_latex(column.title) for column in self.columns)
        lines += [r"\toprule", rf"{heads} \\"]
        for group in self.groups:
            lines.append(r"\midrule")
            for row in group:
                cells = [
                    _framed(escape_latex, c, row, r"\textbf{{{}}}", r"\textit{{{}}}")
                    for c in row.cells
                ]
                lines.append(" & ".join(cells) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"])

    def html(self) -> str:
        """The table as an element, all texts escaped."""
        from std_toolkit.html.templates import environment

        return str(environment().get_template("blocks.html").module.block(self))  # type: ignore[attr-defined]

    def _ordered(self) -> list[Row]:
        return [row for group in self.groups for row in group]


def text_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    texts: int | Collection[str] = 2,
    title: str = "",
) -> Table:
    """A table of cells given as text.

    Args:
        headings: headings of the columns.
        rows: one cell per column.
        texts: number of leading text columns, or headings of text columns; the others are numeric.
        title: title of the table.

    >>> print(text_table(["name", "n"], [["a", "10"]], texts=1).terminal())
    name   n
    a     10
    """
    left = range(texts) if isinstance(texts, int) else [list(headings).index(h) for h in texts]
    columns = [Column(heading=h, numeric=i not in left) for i, h in enumerate(headings)]
    made = [Row([Cell(text=text) for text in row]) for row in rows]
    return Table(columns=columns, rows=made, title=title)


def number(value: float | None, digits: int = 1, *, signed: bool = False) -> str:
    """A number with fixed digits and a true minus; a dash for a missing one.

    >>> number(-0.04), number(2.5, signed=True), number(None)
    ('0.0', '+2.5', '–')
    """
    if value is None or math.isnan(value):
        return NONE
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    if float(text) == 0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def escape_latex(text: str) -> str:
    r"""Text with the special characters of LaTeX escaped.

    >>> escape_latex("5 % of a_b")
    '5 \\% of a\\_b'
    """
    return "".join(_LATEX.get(c, c) for c in text)


def _framed(escape: Callable[[str], str], cell: Cell, row: Row, best: str, published: str) -> str:
    """A cell's text, bold or italic, and its note behind it."""
    text = escape(cell.text)
    if text and row.kind == "published":
        text = published.format(text)
    elif text and cell.mark == "best":
        text = best.format(text)
    return f"{text} {escape(cell.note)}".strip()


def _aligned(lines: Sequence[Sequence[str]], numeric: Sequence[bool]) -> str:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if flush else cell.ljust(width)
            for cell, width, flush in zip(line, widths, numeric, strict=True)
        ).rstrip()
        for line in lines
    )


def _pipes(text: str) -> str:
    return text.replace("|", r"\|").replace("<", "&lt;").replace("\n", " ")


def _bar(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"
