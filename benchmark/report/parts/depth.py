"""Report part of depth restoration: leaderboards, breakdowns, speed, pictures, runs."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from benchmark.evaluation.depth_panels import PANELS, TRUST_PANEL
from benchmark.evaluation.results import counted
from benchmark.evaluation.tasks.depth_pictures import FOLDER, INDEX_FILE, Gallery
from benchmark.evaluation.tasks.depth_results import RunResult, read_results
from benchmark.report import leaderboard
from benchmark.report.page import (
    MOST_PICTURED,
    Layout,
    ReportPart,
    left_out,
    table_files,
    terminal_text,
)
from benchmark.report.parts import comparisons, depth_comparisons, depth_plots, depth_tables
from benchmark.report.parts.published import TASKS, other_protocols
from std_toolkit.errors import ToolkitError
from std_toolkit.html import page
from std_toolkit.html.page import Gallery as Pictures
from std_toolkit.io.documents import read_document

CSV, MARKDOWN, LATEX = "leaderboard.csv", "leaderboard.md", "leaderboard.tex"
SEEDS = "leaderboard_seeds.csv"
_RANKS = {"best": "best frame", "median": "median frame", "worst": "worst frame"}


def depth_part(
    folders: Sequence[Path], *, published: bool = True, layout: Layout | None = None
) -> ReportPart:
    """See `ReportTask`.

    Raises:
        ToolkitError: a run is damaged, no frame could be scored, or no run has a picture of a
            frame of the layout.
    """
    layout = layout or Layout()
    board = leaderboard.make_board(read_results(folders), published=published)
    paper = depth_comparisons.paper_tables(board) if layout.paper else []
    boards = [
        table
        for where in board.boards
        for make in (depth_tables.board_tables, depth_tables.seen_tables)
        for table in make(board, *where)
    ]
    seeds = depth_comparisons.over_seeds(board)
    tables = [
        *(paper or boards),
        *(
            t
            for rows, columns, title in seeds
            for t in comparisons.seed_table(rows, columns, title)
        ),
    ]
    files = table_files((CSV, MARKDOWN, LATEX), tables, board.rows)
    if seeds:
        told = pd.concat([rows.assign(of=title) for rows, _, title in seeds], ignore_index=True)
        files[SEEDS] = told.to_csv(index=False, lineterminator="\n")
    first = [page.Section("paper", "As papers print it", paper)] if paper else []
    return ReportPart(
        title="Depth restoration",
        summary=_summary(board),
        sections=[
            *first,
            *board_sections(board, layout),
            *(_published(board) if published else ()),
        ],
        terminal=terminal_text(tables),
        files=files,
        latex=LATEX,
        tables=tables,
    )


def board_sections(board: leaderboard.Board, layout: Layout | None = None) -> list[page.Section]:
    """Return the sections of a leaderboard.

    Raises:
        ToolkitError: no run has a picture of a frame of the layout.
    """
    layout = layout or Layout()
    seeds = {title: (rows, columns) for rows, columns, title in depth_comparisons.over_seeds(board)}
    colors = depth_plots.method_colors(board)
    found = []
    for i, (split, protocol) in enumerate(board.boards):
        title = depth_tables.board_title(board, split, protocol)
        found.append(
            page.Section(f"board-{i}", title, _leaderboard(board, split, protocol, colors))
        )
    for i, (split, protocol) in enumerate(board.boards):
        title = f"In detail: {depth_tables.board_title(board, split, protocol)}"
        blocks = [
            *depth_comparisons.pair_tables(board, split, protocol, layout.paired),
            *_breakdown(board, split, protocol, colors),
        ]
        found.append(page.Section(f"detail-{i}", title, blocks))
    over = [t for title, of in seeds.items() for t in comparisons.seed_table(*of, title)]
    return [
        *found,
        page.Section("seeds", "Over training seeds", over),
        page.Section("speed", "Speed", _speed(board, colors)),
        page.Section("gallery", "Gallery", gallery(_best_first(board), layout.gallery)),
        page.Section("runs", "What ran", [depth_tables.run_table(board.results)]),
    ]


def _published(board: leaderboard.Board) -> list[page.Section]:
    """What papers print of the measured data sets by protocols that were not run."""
    blocks: list[page.Block] = []
    for place in dict.fromkeys(r.place for r in board.results if r.data.is_published):
        split = board.runs(place)[0].manifest.setup.split
        shown = [protocol for name, protocol in board.boards if name == place]
        blocks += other_protocols(TASKS["depth"], split, shown)
    title = "Published by other protocols, not comparable with the rows above"
    return [page.Section("published", title, blocks)]


def _leaderboard(
    board: leaderboard.Board, split: str, protocol: str, colors: dict[str, str]
) -> list[page.Block]:
    rows = board.main_rows(split, protocol)
    figures = page.Columns(
        [
            page.Plot(f"bars-{split}-{protocol}", depth_plots.bars(rows, colors)),
            page.Plot(f"radar-{split}-{protocol}", depth_plots.radar(rows, colors)),
        ]
    )
    return [
        *depth_tables.board_tables(board, split, protocol, all_published=True),
        *depth_tables.seen_tables(board, split, protocol),
        figures,
    ]


def _breakdown(
    board: leaderboard.Board, split: str, protocol: str, colors: dict[str, str]
) -> list[page.Block]:
    blocks: list[page.Block] = [*depth_tables.breakdown_tables(board, split, protocol)]
    rows = board.rows[(board.rows["split"] == split) & (board.rows["protocol"] == protocol)]
    curve = depth_plots.depth_curves(rows, colors)
    if curve is not None:
        of = board.counted(split)
        blocks += [
            page.Heading(f"Error against depth: {of}"),
            page.Plot(f"depth-{split}-{protocol}", curve),
        ]
    return blocks


def _speed(board: leaderboard.Board, colors: dict[str, str]) -> list[page.Block]:
    """Cost of each method, and accuracy against speed on the first board."""
    split, protocol = board.boards[0]
    rows = board.main_rows(split, protocol)
    known = leaderboard.one_of_each(rows.dropna(subset=["frames_per_s"]))
    if not (known["kind"] == leaderboard.MEASURED).any():
        return []
    drawn = known
    if " of " in board.counted(split):  # a part of the published frames
        drawn = known[known["kind"] != leaderboard.PUBLISHED]
    figure = depth_plots.speed_against_error(drawn, colors)
    return [depth_tables.cost_table(board, known, split, protocol), page.Plot("speed", figure)]


def _best_first(board: leaderboard.Board) -> list[RunResult]:
    """The runs if they are few; else the best of each board, then the second ones, and so on."""
    if len(board.results) <= MOST_PICTURED:
        return list(board.results)
    place: dict[tuple[str, str, str], int] = {}
    for split, protocol in board.boards:
        rows = board.main_rows(split, protocol)
        measured = rows.loc[rows["kind"] == leaderboard.MEASURED, "method"]
        place |= {(split, protocol, method): i for i, method in enumerate(measured)}
    last = len(board.results)

    def place_of(result: RunResult) -> int:
        setup = result.manifest.setup
        return place.get((result.place, setup.protocol, result.manifest.label), last)

    return sorted(board.results, key=place_of)


def gallery(results: Sequence[RunResult], wanted: Sequence[str] = ()) -> list[page.Block]:
    """Pictures of the common frames for each method, then the best and worst frames of each.

    Args:
        results: runs; only the first `MOST_PICTURED` with pictures are shown.
        wanted: SCENE/FRAME of the common frames to show, in this order; empty for all.

    Raises:
        ToolkitError: no run has a common picture of such a frame.
    """
    blocks: list[page.Block] = []
    every = [(r, pictures) for r in results if (pictures := _gallery_of(r))]
    found = every[:MOST_PICTURED]
    common: dict[tuple[str, str, str, str], list[tuple[RunResult, str, float]]] = {}
    for result, pictures in found:
        setup = result.manifest.setup
        for p in pictures.pictures:
            if p.rank == "common":
                key = (result.place, setup.protocol, p.scene, p.frame)
                common.setdefault(key, []).append((result, p.picture, p.rmse))
    if wanted:
        known = list(dict.fromkeys(f"{scene}/{frame}" for *_, scene, frame in common))
        for name in wanted:
            if name not in known:
                raise ToolkitError(
                    "no run has a picture of this frame for all methods",
                    field="--gallery",
                    value=name,
                    hint=f"known: {', '.join(known) or 'none'}; `std-bench --gallery-frames` makes "
                    "pictures of others",
                )
        at = {
            key: wanted.index(f"{key[2]}/{key[3]}") for key in common if "/".join(key[2:]) in wanted
        }
        common = {key: common[key] for key in sorted(at, key=lambda k: at[k])}
    for (split, protocol, scene, frame), shown in common.items():
        strips = [
            _strip(result, picture, f"{result.manifest.label}: {rmse * 1e3:.1f} mm")
            for result, picture, rmse in sorted(shown, key=lambda s: s[2])
        ]
        blocks.append(page.Heading(f"{split} {scene}/{frame}, {protocol}"))
        blocks.append(Pictures(strips, heads=PANELS))
    for result, pictures in found:
        own = [p for p in pictures.pictures if p.rank in _RANKS]
        if not own:
            continue
        setup = result.manifest.setup
        of = counted([result], setup.frames)
        title = f"{result.manifest.label} on {result.place}, {setup.protocol}: {of}"
        panels = (*PANELS, TRUST_PANEL) if all(p.trust for p in own) else PANELS
        strips = [
            _strip(
                result,
                p.picture,
                f"{_RANKS[p.rank]}: {p.scene}/{p.frame}, {p.rmse * 1e3:.1f} mm",
            )
            for p in own
        ]
        blocks.append(page.Details(title, [Pictures(strips, heads=panels)]))
    if not blocks:
        return []
    about = "The first frames are the same for all methods, the best method first."
    return [page.Paragraph(about), *left_out(len(every), FOLDER), _LEGEND, *blocks]


_LEGEND = page.Legend(
    [
        page.LegendEntry(
            "linear-gradient(90deg,#fde725,#21918c,#440154)",
            "depth, near to far, over the range of the ground truth of the frame",
            180,
        ),
        page.LegendEntry(
            "linear-gradient(90deg,#000004,#bc3754,#fcffa4)", "error, 0 to 50 mm", 180
        ),
        page.LegendEntry("#963cc8", "no answer"),
        page.LegendEntry("#1c1c20", "no ground truth, or no depth"),
        page.LegendEntry(
            "linear-gradient(90deg,#000,#54546f,#a9c5c5,#fff)", "trust in the sensor, 0 to 1", 180
        ),
    ]
)


def _gallery_of(result: RunResult) -> Gallery | None:
    path = result.folder / FOLDER / INDEX_FILE
    return read_document(path, Gallery) if path.exists() else None


def _strip(result: RunResult, picture: str, caption: str) -> page.Figure:
    return page.Figure(page.Picture.read(result.folder / FOLDER, picture), caption)


def _summary(board: leaderboard.Board) -> str:
    """One sentence on the best methods."""
    found = []
    for split, protocol in board.boards:
        rows = board.main_rows(split, protocol)
        ranked = rows[leaderboard.is_ranked(rows)]
        of = board.counted(split)
        if ranked.empty:
            found.append(f"none on {split} ({protocol}, {of}): no method answered every frame")
            continue
        first = ranked.drop_duplicates("speed_class")
        for best in first.to_dict("records"):
            rmse = depth_tables.RMSE.text(best["rmse"])
            of_class = f", class {best['speed_class']}" if len(first) > 1 else ""
            found.append(f"{best['method']} on {split} ({rmse} mm, {protocol}, {of}{of_class})")
    return "Lowest RMSE: " + "; ".join(found) + "."
