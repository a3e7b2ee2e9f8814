"""`std-report site`: write the pages and tables of a leaderboard that needs no server."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import pandas as pd

from benchmark.evaluation.verification import read_grades
from benchmark.published.citations import write_citations
from benchmark.report.parts.published import TASKS, published_records
from benchmark.report.site import pages
from benchmark.report.site.entries import CITATION, BoardKey, Entry
from benchmark.report.site.readers import collect
from std_toolkit.io.atomic import write_bytes_atomic

CSV, PARQUET, PRINTED = "results.csv", "results.parquet", "published.csv"


@dataclass(frozen=True)
class Site:
    """What was written.

    Attributes:
        index: the first page.
        boards, methods, runs: their numbers.
    """

    index: Path
    boards: int
    methods: int
    runs: int


def build_site(
    results: Sequence[Path],
    out: Path,
    *,
    verified: Sequence[Path] = (),
    title: str = "Benchmark",
    pictures: bool = True,
    published: bool = True,
) -> Site:
    """Write a site; pages of an earlier one that no longer exist are removed.

    Args:
        results: folders that std-bench wrote, of one or several people.
        out: folder of the site.
        verified: records of `std-bench verify` that are trusted.
        title: heading of the first page.
        pictures: show pictures of the runs.
        published: show the figures that papers print.

    Raises:
        ToolkitError: results or records that cannot be read, or a file that cannot be written.
    """
    entries = collect(results, read_grades(verified))
    boards: dict[BoardKey, list[Entry]] = {}
    for entry in sorted(entries, key=_whole_sets_first):
        boards.setdefault(entry.board, []).append(entry)
    methods: dict[str, list[Entry]] = {}
    for entry in sorted(entries, key=lambda e: e.method):
        methods.setdefault(entry.method, []).append(entry)
    texts = {pages.INDEX: pages.index_page(title, boards, published=published).html()}
    for key, board in boards.items():
        page = pages.board_page(key, board, published=published)
        texts[pages.board_file(key)] = page.html()
    for name, mine in methods.items():
        page = pages.method_page(name, mine, pictures=pictures)
        texts[pages.method_file(mine[0])] = page.html()
    if published:
        texts[pages.PUBLISHED] = pages.published_page().html()
        printed = pd.DataFrame(published_records(sum(TASKS.values(), ())))
        texts[PRINTED] = printed.to_csv(index=False, lineterminator="\n")
    for name in {pages.PUBLISHED, PRINTED} - set(texts):
        (out / name).unlink(missing_ok=True)
    for name, text in texts.items():
        write_bytes_atomic(out / name, text.encode())
    for folder in (pages.BOARDS, pages.METHODS):
        for path in (out / folder).glob("*.html"):
            if f"{folder}/{path.name}" not in texts:
                path.unlink()
    table = results_table(boards)
    write_bytes_atomic(out / CSV, table.to_csv(index=False, lineterminator="\n").encode())
    buffer = BytesIO()
    table.to_parquet(buffer, index=False)
    write_bytes_atomic(out / PARQUET, buffer.getvalue())
    names = sorted({name for entry in entries for name in entry.uses})
    said = (entry.facts.get(CITATION, "") for entry in entries)
    write_citations(out, names, list(dict.fromkeys(filter(None, said))))
    return Site(out / pages.INDEX, len(boards), len(methods), len(entries))


def _whole_sets_first(entry: Entry) -> tuple[str, str, str, int, BoardKey]:
    key = entry.board
    return key.task, key.data, key.protocol, -entry.frames, key


def results_table(boards: Mapping[BoardKey, Sequence[Entry]]) -> pd.DataFrame:
    """Return all figures: a row for each run and subset, in SI units and fractions.

    `rank` is that of the class by the first subset; empty for runs that are not ranked.
    """
    rows = []
    for key, board in boards.items():
        for speed, mine in pages.classes_of(board).items():
            place = 0
            for entry in mine:
                place += entry.is_ranked
                about = {
                    "task": key.task,
                    "data": key.data,
                    "protocol": key.protocol,
                    "scored": key.frames,
                    "selection": key.selection,
                    "series": key.version,
                    "class": speed,
                    "rank": place if entry.is_ranked else None,
                    "method": entry.method,
                    "grade": entry.grade,
                    "provenance": entry.provenance,
                    "frames": entry.frames,
                    "unanswered": entry.unanswered,
                    "scenes": entry.scenes,
                    "frames_per_s": None if entry.speed is None else entry.speed.frames_per_s,
                    "timed_on": "" if entry.speed is None else entry.speed.hardware,
                    "run": entry.digest,
                }
                for subset, figures in entry.figures.items():
                    row = about | {"subset": subset}
                    for name, (value, low, high) in figures.items():
                        row |= {name: value, f"{name}_low": low, f"{name}_high": high}
                    rows.append(row)
    return pd.DataFrame(rows).astype({"rank": "Int64"})
