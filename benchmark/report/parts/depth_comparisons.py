"""Depth restorers beside each other: the layout of papers, training seeds, p of all pairs."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import pandas as pd

from benchmark.evaluation.results import Result
from benchmark.metrics.depth.figures import shown_columns
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.significance import compare_methods
from benchmark.report import leaderboard
from benchmark.report.page import NOTES
from benchmark.report.parts import comparisons, depth_tables
from benchmark.report.parts.published import address_note
from std_toolkit.html.table import NONE, Cell, Column, Row, Table

# Data sets in the order in which papers print them.
PAPER_SETS = ("dreds-catknown-test", "dreds-catnovel", "std-catknown", "std-catnovel")


def paper_tables(board: leaderboard.Board) -> list[Table]:
    """Return a table for each protocol as papers print it: all data sets, each figure of all
    objects / of specular and transparent ones."""
    tables = []
    for protocol in dict.fromkeys(name for _, name in board.boards):
        grid, _ = get_protocol(protocol).main
        columns = shown_columns(aligned=bool(get_protocol(protocol).align))
        splits = [split for split, name in board.boards if name == protocol]
        splits.sort(key=lambda s: PAPER_SETS.index(s) if s in PAPER_SETS else len(PAPER_SETS))
        made, sources = [], []
        for split in splits:
            both = [
                leaderboard.one_of_each(board.part(split, protocol, grid, subset)).set_index(
                    "method"
                )
                for subset in depth_tables.MAIN_SUBSETS
            ]
            for method, row in both[0].iterrows():
                hard = both[1].loc[method] if method in both[1].index else None
                published = row["kind"] == leaderboard.PUBLISHED
                if published:
                    sources.append(row["source"])
                figures = []
                for column in columns:
                    pair = [row, *([] if hard is None else [hard])]
                    texts = [column.text(r[column.name], published=published) or NONE for r in pair]
                    figures.append(Cell(text=" / ".join(texts), value=row[column.name]))
                note = depth_tables.source_of(row.to_dict()) if published else ""
                cells = [Cell(text=split), Cell(text=str(method)), *figures, Cell(text=note)]
                made.append(Row(cells, "published" if published else ""))
        heads = [Column(heading=h, numeric=False) for h in ("data", "method")]
        table = Table(
            columns=[*heads, *columns, Column(heading=NOTES, numeric=False)],
            rows=made,
            title=f"Protocol {protocol}: all objects / specular and transparent ones",
            notes=[address_note(sources)] if sources else [],
        )
        tables.append(table if sources else table.without(NOTES))
    return tables


def over_seeds(board: leaderboard.Board) -> list[tuple[pd.DataFrame, Sequence[Column], str]]:
    """Return the rows over training seeds, columns and title of each table of the leaderboards."""
    found: list[tuple[pd.DataFrame, Sequence[Column], str]] = []
    for split, protocol in board.boards:
        groups = comparisons.seed_groups(
            [r for r in board.runs(split) if r.manifest.setup.protocol == protocol]
        )
        grid, first = get_protocol(protocol).main
        columns = shown_columns(aligned=bool(get_protocol(protocol).align))
        for subset in dict.fromkeys((first, *depth_tables.MAIN_SUBSETS)):
            part = board.part(split, protocol, grid, subset)
            of = part[leaderboard.is_ranked(part)].set_index("method").to_dict("index")
            named = partial(_figures, dict(of))
            rows = comparisons.seed_rows(groups, named, [c.name for c in columns])
            what = depth_tables.OBJECTS.get(subset, subset)
            title = (
                f"{depth_tables.board_title(board, split, protocol)}, {what}, over training seeds"
            )
            if len(rows):
                found.append((rows, columns, title))
    return found


def _figures(of: dict[Any, dict[Any, Any]], result: Result[Any]) -> dict[Any, Any] | None:
    return of.get(result.manifest.label)


def pair_tables(
    board: leaderboard.Board, split: str, protocol: str, paired: comparisons.Paired
) -> list[Table]:
    """Return the table of p of all pairs of ranked methods, by RMSE.

    Args:
        board: all rows.
        split, protocol: of the leaderboard.
        paired: over scenes, or over frames as if each were independent.
    """
    grid, subset = get_protocol(protocol).main
    part = board.part(split, protocol, grid, subset)
    names = part.loc[leaderboard.is_ranked(part), "method"].tolist()[: comparisons.MOST_COMPARED]
    frames = board.tables
    chosen = (frames["split"] == split) & (frames["protocol"] == protocol)
    chosen &= (frames["grid"] == grid) & (frames["subset"] == subset)
    frames = frames[chosen & frames["method"].isin(names) & (frames["n_pixels"] > 0)]
    test = "Wilcoxon's signed-rank test of the mean differences of scenes."
    if paired == "frames":
        frames = frames.assign(scene=frames["scene"] + "/" + frames["frame"])
        test = (
            "Wilcoxon's signed-rank test of the differences of frames, which in one scene are not "
            "independent: p is too small."
        )
    frames = frames.sort_values("method", key=lambda m: m.map(names.index), kind="stable")
    if len(names) < 2 or frames["scene"].nunique() < 2:
        return []
    pairs = compare_methods(frames, leaderboard.RANKED_BY, samples=1)
    return comparisons.pair_table(
        names,
        list(pairs[["difference", "p_wilcoxon"]].itertuples(index=False, name=None)),
        depth_tables.RMSE,
        title=f"All pairs, {depth_tables.board_title(board, split, protocol)}",
        test=test,
    )
