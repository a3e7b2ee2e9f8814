"""Pages of a site: the list of boards, a page for each board and each method."""

import math
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmark.evaluation.depth_panels import PANELS
from benchmark.evaluation.results import FAILED
from benchmark.evaluation.tasks import depth_pictures, pose_pictures
from benchmark.evaluation.tasks.depth_speed import NOT_STATED, Speed
from benchmark.evaluation.verification import GRADES
from benchmark.published.citations import KEYS, entries
from benchmark.report.leaderboard import COSTS
from benchmark.report.parts.depth_tables import OBJECTS
from benchmark.report.parts.published import beside_board, published_sections
from benchmark.report.site.entries import NOTHING, BoardKey, Entry
from std_toolkit import __version__
from std_toolkit.html.page import (
    Block,
    Bullets,
    Figure,
    Gallery,
    Heading,
    Links,
    Page,
    Paragraph,
    Picture,
    Section,
    Terms,
)
from std_toolkit.html.table import NONE, Cell, Column, Row, Table
from std_toolkit.io.documents import read_document

INDEX, PUBLISHED, BOARDS, METHODS = "index.html", "published.html", "boards", "methods"
_CLASSES = {
    "cpu": "At most 1 s of 2 cores for a frame of 640x480.",
    "gpu": "On a GPU, or slower than 1 s on 2 cores.",
    NOT_STATED: "The speed is not known.",
}
GRADE_TERMS = {
    "reported": "by whoever sent the results",
    "recomputed": "the figures follow from the predictions, with the data (`std-bench verify`)",
    "rerun": "somebody else ran the method again, with its weights",
}
_PICTURES = 3


def file_of(folder: str, name: str) -> str:
    """Return the address of a page: equal on systems that know no capitals, whatever the name.

    >>> file_of("methods", "A/B <x>")
    'methods/a-b-x-001d40e6.html'
    """
    safe = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60]
    return f"{folder}/{safe}-{zlib.crc32(name.encode()):08x}.html"


def board_file(key: BoardKey) -> str:
    """Return the address of the page of a board."""
    parts = (key.task, key.data, key.protocol, key.frames, key.selection, key.version)
    return file_of(BOARDS, " ".join(parts))


def method_file(entry: Entry) -> str:
    """Return the address of the page of a method."""
    return file_of(METHODS, entry.method)


def ranked(board: Sequence[Entry]) -> list[Entry]:
    """Return the runs of one class, best first, then those that do not compete."""
    less = next(c.lower_is_better for e in board for c in e.columns if c.name == e.ranked_by)
    sign = 1 if less else -1

    def order(entry: Entry) -> tuple[bool, float, str]:
        score = math.inf if math.isnan(entry.score) else sign * entry.score
        return not entry.is_ranked, score, entry.method

    return sorted(board, key=order)


def classes_of(board: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Return the runs of a board by class, each ranked."""
    found = {c: [e for e in board if e.speed_class == c] for c in _CLASSES}
    return {c: ranked(mine) for c, mine in found.items() if mine}


def index_page(title: str, boards: Mapping[BoardKey, Sequence[Entry]], *, published: bool) -> Page:
    """Return the list of all boards; `published`: with a link to the published figures."""
    rows = []
    for key, board in boards.items():
        for speed, mine in classes_of(board).items():
            best = mine[0]
            column = next(c for c in best.columns if c.name == best.ranked_by)
            competing = sum(e.is_ranked for e in mine)
            leads = best.is_ranked
            figure = f"{column.heading} {column.text(best.score)} {column.unit}".strip()
            rows.append(
                Row(
                    [
                        Cell(text=key.data, href=f"{board_file(key)}#s-{_anchor(speed)}"),
                        Cell(text=key.task),
                        Cell(text=key.protocol),
                        Cell(text=key.frames),
                        Cell(text=speed),
                        _count(competing),
                        Cell(text=best.method, href=method_file(best)) if leads
                        else Cell(text=NONE),
                        Cell(text=figure if leads else ""),
                        Cell(text=best.grade if leads else ""),
                        Cell(text=key.version),
                    ]
                )
            )  # fmt: skip
    heads = ("data set", "task", "protocol", "frames", "class", "ranked", "best", "its figure",
             "grade", "std-toolkit")  # fmt: skip
    columns = [Column(heading=h, numeric=h == "ranked", digits=0) for h in heads]
    table = Table(
        columns=columns, rows=rows, sortable=True,
        filters=("task", "data set", "protocol", "class", "grade"),
    )  # fmt: skip
    methods = sorted({(e.method, method_file(e)) for board in boards.values() for e in board})
    runs = sum(map(len, boards.values()))
    intro: list[Block] = [
        Paragraph(
            f"{runs} results of {len(methods)} methods on {len(boards)} boards. Results are ranked "
            "together only if task, content of the data, scored frames, protocol, class and series "
            "of the toolkit are the same."
        ),
        Links([*([("Published figures", PUBLISHED)] if published else []),
               ("results.csv", "results.csv"), ("results.parquet", "results.parquet"),
               ("citations.bib", "citations.bib")]),
    ]  # fmt: skip
    listed = Table(
        columns=[Column(heading="method", numeric=False), Column(heading="boards", digits=0)],
        rows=[
            Row([Cell(text=name, href=href), _count(sum(
                e.method == name for board in boards.values() for e in board
            ))])
            for name, href in methods
        ],
        sortable=True, filters=(),
    )  # fmt: skip
    sections = [
        Section("boards", "Boards", [table]),
        Section("methods", "Methods", [listed]),
        Section("grades", "Grades", [Terms(GRADE_TERMS)]),
    ]
    return _page("Leaderboard", title, sections, intro)


def published_page() -> Page:
    """Return all published figures whose source a reader can open."""
    intro = [Links([("All boards", INDEX)])]
    return _page("Leaderboard", "Published figures", published_sections(), intro)


def board_page(key: BoardKey, board: Sequence[Entry], *, published: bool) -> Page:
    """Return the page of one board: a table for each class and subset; `published`: then what
    papers print of the same frames."""
    sections = []
    for speed, mine in classes_of(board).items():
        subsets = dict.fromkeys(s for e in mine for s in e.figures)
        tables = [_table(mine, subset, is_main=i == 0) for i, subset in enumerate(subsets)]
        column = next(c for c in mine[0].columns if c.name == mine[0].ranked_by)
        ranks = f"{column.heading} of {OBJECTS.get(mine[0].main, mine[0].main)}"
        about = Paragraph(f"{_CLASSES[speed]} Bold: the best that is ranked, by {ranks}.")
        sections.append(Section(_anchor(speed), f"Class {speed}", [about, *tables]))
    facts = {
        "task": key.task,
        "data": f"{key.data}; {board[0].provenance or 'provenance unknown'}",
        "protocol": key.protocol,
        "frames": f"{key.frames}; digest of their names {key.selection[:16]}",
        "std-toolkit": f"{key.version}: other series are other boards",
    }
    notes = [Paragraph("In brackets: 95 % intervals over scenes; none with one scene.")]
    if not all(e.is_ranked for e in board):
        notes.append(Paragraph(
            "Rows without a rank lack an answer to a frame, or got ground truth."
        ))  # fmt: skip
    intro: list[Block] = [Links([("All boards", f"../{INDEX}")]), Terms(facts), *notes]
    sections.append(Section("grades", "Grades", [Terms(GRADE_TERMS)]))
    split = board[0].published_split
    if published and split:
        sections += beside_board(board[0].published_tasks, split, key.protocol)
    return _page(key.task.capitalize(), key.title, sections, intro)


def _table(board: Sequence[Entry], subset: str, *, is_main: bool) -> Table:
    columns = board[0].columns
    there = [e for e in board if subset in e.figures]
    lacking = any(e.unanswered for e in there)
    best = {}
    for c in columns:
        values = [v for e in there if e.is_ranked and not math.isnan(v := _value(e, subset, c))]
        if values:
            best[c.name] = min(values) if c.lower_is_better else max(values)
    rows = []
    place = 0
    for entry in there:
        place += entry.is_ranked
        rank = Cell(text=NONE, value=math.inf, mark="none")
        cells = [
            _count(place) if entry.is_ranked else rank,
            Cell(text=entry.method, href=f"../{method_file(entry)}"),
        ]
        for column in columns:
            value, low, high = entry.figures[subset].get(column.name, NOTHING)
            leads = entry.is_ranked and value == best.get(column.name)
            nowhere = column is columns[0] and entry.unanswered >= entry.frames > 0
            cells.append(
                column.cell(
                    value, interval=(low, high), mark="best" if leads else "",
                    missing=FAILED if nowhere else "",
                )
            )  # fmt: skip
        speed = None if entry.speed is None else entry.speed.frames_per_s
        cells += [Cell(text=entry.grade), Cell(text=_preset(entry)), COSTS[0].cell(speed)]
        cells += [_frames(entry)] if lacking else []
        rows.append(Row(cells, "" if entry.is_ranked else "bound"))
    heads = [
        Column(heading="rank", digits=0), _text("method"), *columns, _text("grade"),
        _text("preset"), COSTS[0], *([Column(heading="frames", digits=0)] if lacking else []),
    ]  # fmt: skip
    return Table(
        columns=heads, rows=rows, title=OBJECTS.get(subset, subset), sortable=True,
        filters=("grade", "preset") if is_main else None,
    )  # fmt: skip


def _preset(entry: Entry) -> str:
    """The preset of a network; other methods have none."""
    has_weights = entry.facts.get("weights (BLAKE2b-128)", "-") != "-"
    return entry.facts.get("preset", "") if has_weights else NONE


def method_page(method: str, mine: Sequence[Entry], *, pictures: bool) -> Page:
    """Return the page of a method: figures on every board, settings, speed, what to cite."""
    sections = []
    for entry in mine:
        key = entry.board
        blocks: list[Block] = [
            Links([("Board", f"../{board_file(key)}#s-{_anchor(entry.speed_class)}")]),
            _own_figures(entry),
            Terms({**entry.facts, "run (BLAKE2b-128)": entry.digest}),
            *_checked(entry),
            *_speed(entry.speed),
            *(_pictures(entry) if pictures else ()),
        ]
        title = f"{key.task.capitalize()}: {key.title}"
        sections.append(Section(file_of("b", title)[2:-5], title, blocks))
    names = list(dict.fromkeys(name for e in mine for name in e.uses))
    bib = [f"{name}: {key}" for name in names for key in KEYS.get(name, ())]
    if bib:
        cited = [Paragraph(_title(line.rpartition(": ")[2]), line) for line in bib]
        sections.append(Section("cite", "What to cite", [Bullets(cited)]))
    intro = [Links([("All boards", f"../{INDEX}"), ("citations.bib", "../citations.bib")])]
    return _page("Method", method, sections, intro)


def _title(key: str) -> str:
    """Title of an entry of the bibliography."""
    found = re.search(r"^\s*title\s*=\s*\{(.*?)\},?$", entries()[key], re.M)
    return found[1].replace("{", "").replace("}", "") if found else ""


def _own_figures(entry: Entry) -> Table:
    rows = [
        Row([Cell(text=OBJECTS.get(subset, subset)), *(
            c.cell(v[0], interval=(v[1], v[2]))
            for c in entry.columns
            for v in [figures.get(c.name, NOTHING)]
        )])
        for subset, figures in entry.figures.items()
    ]  # fmt: skip
    place = "ranked" if entry.is_ranked else "not ranked"
    answered = f"{entry.frames - entry.unanswered:,} of {entry.frames:,} frames answered"
    return Table(
        columns=[_text("pixels or objects"), *entry.columns], rows=rows,
        notes=[f"Class {entry.speed_class}, {place}; {answered}; {entry.scenes} scenes."],
    )  # fmt: skip


def _checked(entry: Entry) -> list[Block]:
    """What was checked of a run."""
    done = entry.verified
    if done is None:
        return [Paragraph(GRADE_TERMS[GRADES[0]], "Reported", "")]
    checks = [Paragraph(c.about, f"{c.name}: {c.state}.") for c in done.checks]
    return [
        Paragraph(GRADE_TERMS[done.grade], done.graded.capitalize(), "good"),
        Bullets(checks),
    ]


def _speed(speed: Speed | None) -> list[Block]:
    if speed is None:
        return []
    cells = [c.cell(getattr(speed, c.name)) for c in COSTS]
    cells += [Cell(text=f"{speed.width}x{speed.height}"), Cell(text=speed.hardware)]
    heads = [*COSTS, _text("view"), _text("hardware")]
    return [Heading("Speed"), Table(columns=heads, rows=[Row(cells)])]


def _pictures(entry: Entry) -> list[Block]:
    """A few pictures of a run; a file that is no picture is an error."""
    depth = entry.folder / depth_pictures.FOLDER / depth_pictures.INDEX_FILE
    poses = entry.folder / pose_pictures.POSE_GALLERY / pose_pictures.PICTURES_FILE
    found: list[tuple[Path, str, str]] = []
    heads: Sequence[str] = ()
    if depth.exists():
        shown = read_document(depth, depth_pictures.Gallery).pictures
        chosen = [p for p in shown if p.rank == "common"][:_PICTURES]
        found = [
            (depth.parent, p.picture, f"{p.scene}/{p.frame}: RMSE {1e3 * p.rmse:.1f} mm")
            for p in chosen
        ]
        heads = PANELS
    elif poses.exists():
        chosen_poses = read_document(poses, pose_pictures.PosePictures).pictures[:_PICTURES]
        found = [(poses.parent, p.picture, f"{p.scene}/{p.frame}") for p in chosen_poses]
    figures = [
        Figure(Picture.read(folder, name, width=900), caption) for folder, name, caption in found
    ]
    return [Gallery(figures, heads=heads)] if figures else []


def _page(kind: str, title: str, sections: Sequence[Section], intro: Sequence[Block]) -> Page:
    footer = f"std-toolkit {__version__}, `std-report site`."
    return Page(kind=kind, title=title, sections=sections, footer=footer, intro=intro)


def _value(entry: Entry, subset: str, column: Column) -> float:
    return entry.figures[subset].get(column.name, NOTHING)[0]


def _frames(entry: Entry) -> Cell:
    if not entry.unanswered:
        return _count(entry.frames)
    text = f"{entry.frames:,} ({entry.unanswered:,} unanswered)"
    return Cell(text=text, value=entry.frames, mark="bad")


def _count(number: int) -> Cell:
    return Cell(text=f"{number:,}", value=number)


def _text(heading: str) -> Column:
    return Column(heading=heading, numeric=False)


def _anchor(speed: str) -> str:
    return speed.replace(" ", "-")
