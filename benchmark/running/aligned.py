"""Tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def aligned(lines: Sequence[Sequence[str]], texts: int = 2) -> str:
    """Lines of cells in columns, the headings first.

    Args:
        lines: as many cells each.
        texts: the first so many columns begin at their left; the others, numbers, end at their
            right.

    >>> print(aligned([["name", "n"], ["a", "10"]], texts=1))
    name   n
    a     10
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if place < texts else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
