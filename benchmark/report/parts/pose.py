"""Report parts of category-level and instance-level poses, with the effect of restored depth.

Instance-level poses (BOP) stand beside published figures.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.evaluation import depth_choice
from benchmark.evaluation.tasks import bop_results, pose_results
from benchmark.evaluation.tasks.bop_results import BopFigures, BopObject
from benchmark.metrics.significance import holm
from benchmark.published.load import published_bop
from benchmark.report.leaderboard import SIGNIFICANT
from benchmark.report.page import Layout, ReportPart, table_files, terminal_text
from benchmark.report.parts import depth_tables, pose_board, pose_sections
from benchmark.report.parts.published import TASKS, address_note, other_protocols
from std_toolkit.html.page import Block, Bullets, Paragraph, Section
from std_toolkit.html.table import NONE, Cell, Column, Row, Table, number

# Columns of the table of differences.
SHOWN = ("iou50", "iou75", "5deg2cm", "5deg5cm", "10deg5cm")

CSV, MARKDOWN, LATEX = "poses.csv", "poses.md", "poses.tex"


@dataclass(frozen=True)
class Finding:
    """Result of the comparison of one restored depth with raw depth.

    Attributes:
        split, subset, method, depth, fit: key of the comparison.
        after: percentage of correct poses on the restored depth.
        gain, low, high: gain over raw depth in percentage points, with the 95 % interval over
            scenes.
        p: p of the swap test, corrected for all restored depths and methods of the split.
        scenes: number of scenes compared.
    """

    split: str
    subset: str
    method: str
    depth: str
    fit: str
    after: float
    gain: float
    low: float
    high: float
    p: float
    scenes: int

    @property
    def verdict(self) -> str:
        """`helps`, `hurts` or `not significant`."""
        if math.isnan(self.p) or self.p >= SIGNIFICANT:
            return "not significant"
        return "helps" if self.gain > 0 else "hurts"


def findings(board: pose_board.PoseBoard, subset: str) -> list[Finding]:
    """Return the findings on every restored depth, by split."""
    found = []
    for split in board.splits:
        restored = [c for c in board.compared.get((split, subset), ()) if not _is_true(c)]
        made = [c for c in restored if c.difference is not None]
        values = [c.difference.of(pose_board.MAIN) for c in made if c.difference is not None]
        p_values = holm([p for *_, p in values])
        for compared, (gain, low, high, _), p in zip(made, values, p_values, strict=True):
            method, depth, fit = compared.scored.result.name
            after = 100 * compared.scored.scores.mean[pose_board.MAIN]
            points = after, 100 * gain, 100 * low, 100 * high
            scenes = compared.scored.scene_count
            found.append(Finding(split, subset, method, depth, fit, *points, float(p), scenes))
    return found


def answer(board: pose_board.PoseBoard) -> list[Block]:
    """Return a sentence for each restored depth, and the tables of all differences."""
    sentences = [
        _sentence(f)
        for subset in (pose_results.HARD, pose_results.ALL)
        for f in findings(board, subset)
    ]
    tables = [
        _difference_table(
            compared,
            f"{pose_sections.pose_title(board, split, pose_board.PROTOCOLS[0])}, "
            f"{depth_tables.OBJECTS[subset]}",
        )
        for subset in (pose_results.HARD, pose_results.ALL)
        for split in board.splits
        if (compared := board.compared.get((split, subset)))
    ]
    if not tables:
        return [
            Paragraph("Only raw depth was measured: `--depth raw swindrnet gt` compares depths.")
        ]
    about = Paragraph(
        "The same method, fitted to another depth, against raw depth: difference in percentage "
        "points, protocol strict, mean over classes. In brackets: the 95 % interval over scenes. "
        "The p-value is the probability of a difference at least as large if in each scene the two "
        "were swapped at random; in the sentences, which are about "
        f"{pose_results.heading(pose_board.MAIN)}, it is corrected for all restored depths and "
        "methods of a split (Holm). With five scenes or fewer no difference is significant."
    )
    return [Bullets(sentences), about, *tables]


def _sentence(finding: Finding) -> Paragraph:
    about = f"{finding.method}, fit {finding.fit}, {finding.split}"
    interval = ""
    if not math.isnan(finding.low):
        low, high = (number(x, signed=True) for x in (finding.low, finding.high))
        interval = f"; 95 % interval of the change {low} to {high}"
    p = f", {_p(finding.p)}" if not math.isnan(finding.p) else ""
    scenes = f"{finding.scenes} scene{'' if finding.scenes == 1 else 's'}"
    lead, tone = {
        "helps": ("It helps.", "good"),
        "hurts": ("It hurts.", "bad"),
        "not significant": (f"Not significant over {scenes}.", ""),
    }[finding.verdict]
    before = finding.after - finding.gain
    text = (
        f"Of {depth_tables.OBJECTS[finding.subset]}, {number(before)} % of the poses are within "
        f"{pose_results.heading(pose_board.MAIN)} on raw depth and {number(finding.after)} % on "
        f"depth restored by `{finding.depth}` ({about}{interval}{p})."
    )
    return Paragraph(text, lead, tone)


def _difference_table(compared: Sequence[pose_board.Compared], title: str) -> Table:
    rows = []
    for each in compared:
        method, depth, fit = each.scored.result.name
        bound = "upper bound" if _is_true(each) else ""
        cells = [Cell(text=method), Cell(text=depth, note=bound), Cell(text=fit)]
        if each.difference is None:
            cells += [Cell(text=each.why_not, mark="none"), *[Cell(text="")] * (len(SHOWN) - 1)]
        else:
            cells += [_difference(*each.difference.of(column)) for column in SHOWN]
        rows.append(Row(cells))
    columns = [Column(heading=h, numeric=False) for h in ("method", "depth", "fit")]
    columns += [Column(heading=pose_results.heading(c), unit="points") for c in SHOWN]
    return Table(columns=columns, rows=rows, title=title)


def _difference(gain: float, low: float, high: float, p: float) -> Cell:
    if math.isnan(gain):
        return Cell(text=NONE)
    known = [] if math.isnan(low) else [f"[{', '.join(_points(x) for x in (low, high))}]"]
    known += [] if math.isnan(p) else [_p(p)]
    sure = not math.isnan(p) and p < SIGNIFICANT
    return Cell(text=_points(gain), note=" ".join(known), mark="best" if sure else "", value=gain)


def _points(share: float) -> str:
    return number(100 * share, signed=True)


def _p(p: float) -> str:
    return "p\u00a0<\u00a00.001" if p < 0.001 else f"p\u00a0=\u00a0{p:.3f}"


def _is_true(compared: pose_board.Compared) -> bool:
    return compared.scored.result.manifest.setup.depth == depth_choice.TRUE


def pose_part(
    folders: Sequence[Path], *, published: bool = True, layout: Layout | None = None
) -> ReportPart:
    """Category-level poses; see `ReportTask`. Its pairs are always compared over scenes.

    Raises:
        ToolkitError: a run is damaged, or no frame has a true object.
    """
    board = pose_board.make_pose_board(pose_results.read_pose_results(folders), published=published)
    places = [(split, protocol) for split in board.splits for protocol in pose_board.PROTOCOLS]
    tables = [table for place in places for table in pose_sections.pose_tables(board, *place)]
    tables += pose_sections.seed_tables(board)
    wanted = (layout or Layout()).gallery
    return ReportPart(
        title="Category-level pose",
        summary=_summary(board),
        sections=[*_sections(board, wanted), *(_published(board) if published else ())],
        answer=answer(board),
        terminal=terminal_text(tables),
        files=table_files((CSV, MARKDOWN, LATEX), tables, board.rows),
        latex=LATEX,
        tables=tables,
    )


def bop_part(folders: Sequence[Path], *, published: bool = True) -> ReportPart:
    """Instance-level poses; see `ReportTask`.

    Raises:
        ToolkitError: a file is damaged.
    """
    results = bop_results.read_bop_figures(folders)
    return ReportPart(
        title="Pose of known objects",
        summary=summary(results),
        sections=sections(results, published=published),
        terminal=bop_results.bop_table(results),
    )


def _published(board: pose_board.PoseBoard) -> list[Section]:
    splits = {r.manifest.setup.split for r in board.results if r.data.is_published}
    blocks = [
        table
        for split in sorted(splits)
        for table in other_protocols(TASKS["pose"], split, pose_board.PROTOCOLS)
    ]
    title = "Poses published by other protocols, not comparable with the rows above"
    return [Section("pose-published", title, blocks)]


def _sections(board: pose_board.PoseBoard, wanted: Sequence[str] = ()) -> list[Section]:
    found = []
    for i, split in enumerate(board.splits):
        for protocol in pose_board.PROTOCOLS:
            blocks = [
                *pose_sections.pose_tables(board, split, protocol),
                *pose_sections.bar_blocks(board, split, protocol),
            ]
            title = f"Poses: {pose_sections.pose_title(board, split, protocol)}"
            found.append(Section(f"pose-{i}-{protocol}", title, blocks))
    for i, split in enumerate(board.splits):
        title = (
            f"Poses in detail: {pose_sections.pose_title(board, split, pose_board.PROTOCOLS[0])}"
        )
        details = [
            *pose_sections.pair_tables(board, split),
            *pose_sections.breakdown_tables(board, split),
        ]
        found.append(Section(f"pose-detail-{i}", title, details))
    return [
        *found,
        Section("pose-seeds", "Poses over training seeds", pose_sections.seed_tables(board)),
        Section("pose-gallery", "Boxes", pose_sections.pose_gallery(board, wanted)),
        Section("pose-runs", "What ran: poses", [pose_sections.run_table(board.results)]),
    ]


def _summary(board: pose_board.PoseBoard) -> str:
    """One sentence on the best method and depth, without true depth and what is given the truth."""
    found = []
    for split in board.splits:
        rows = board.part(split, pose_board.PROTOCOLS[0], pose_results.ALL)
        rows = rows[board.contests(rows)].dropna(subset=[pose_board.MAIN])
        if not rows.empty:
            best = rows.loc[rows[pose_board.MAIN].idxmax()]
            found.append(
                f"{best['method']} with {best['depth']} depth on "
                f"{pose_sections.pose_title(board, split, pose_board.PROTOCOLS[0])} "
                f"({100 * best[pose_board.MAIN]:.1f} % within "
                f"{pose_results.heading(pose_board.MAIN)})"
            )
    if not found:
        return (
            "All poses were fitted to true depth, or by methods that receive ground truth, or lack "
            "frames."
        )
    return "Most poses right: " + "; ".join(found) + "."


def summary(results: Sequence[BopFigures]) -> str:
    """One sentence on the best file of each data set."""
    for figure, title in (("ar", "AR"), ("ap", "mAP"), ("ar_mssd", "AR of MSSD")):
        found = []
        for place in dict.fromkeys(r.place for r in results):
            known = [r for r in results if r.place == place and getattr(r, figure) is not None]
            if known:
                best = max(known, key=lambda r: getattr(r, figure))
                found.append(f"{best.results}, {100 * getattr(best, figure):.1f} % on {place}")
        if found:
            return f"Highest {title}: {'; '.join(found)}."
    return f"{len(results)} result files."


def sections(results: Sequence[BopFigures], *, published: bool) -> list[Section]:
    """The table of the files, and the tables of their objects."""
    places = dict.fromkeys(r.place for r in results)
    tables = [_table([r for r in results if r.place == p], published=published) for p in places]
    found = [Section("bop", "Poses of known objects (BOP)", tables)]
    objects = [_object_table(r.objects, f"{r.results} on {r.place}") for r in results if r.objects]
    if objects:
        found.append(Section("bop-objects", "Poses of known objects, by object", objects))
    return found


def _percent_columns() -> list[Column]:
    return [
        Column(heading=h, unit="%", factor=100, lower_is_better=False)
        for h in bop_results.SHOWN.values()
    ]


def _table(results: Sequence[BopFigures], *, published: bool) -> Table:
    columns = [
        Column(heading="results", numeric=False),
        Column(heading="data", numeric=False),
        Column(heading="targets", digits=0),
        Column(heading="estimates", digits=0),
        *_percent_columns(),
        Column(heading="time", unit="s/image", digits=2, lower_is_better=True),
    ]
    names = ("targets", "estimates", *bop_results.SHOWN, "seconds_per_image")
    rows = []
    for r in sorted(results, key=lambda r: -(r.ar or r.ap or 0)):
        cells = [
            c.cell(getattr(r, n), interval=r.intervals.get(n, (math.nan, math.nan)), missing=NONE)
            for c, n in zip(columns[2:], names, strict=True)
        ]
        rows.append(Row([Cell(text=r.results), Cell(text=r.place), *cells]))
    notes = [
        "AR is the mean of the average recalls of VSD, MSSD and MSPD (BOP Challenge 2019 to 2023); "
        "mAP that of the average precisions of MSSD and MSPD in detection (2024); the challenge of "
        "2025 ranks by AP MSSD, or by that within 2 to 20 mm."
    ]
    drawn = sorted({r.intervals_over for r in results if r.intervals_over})
    notes += [f"Brackets: 95 % intervals over {' or '.join(drawn)}."] if drawn else []
    if published:
        data = {Path(r.data).resolve().name for r in results if _is_test(r.split)}
        printed = published_bop()
        for row in printed[printed["dataset"].isin(data)].itertuples():
            values = (None, None, *(getattr(row, n, None) for n in names[2:]))
            cells = [c.cell(v, missing=NONE) for c, v in zip(columns[2:], values, strict=True)]
            name = Cell(text=row.method, note="published")
            rows.append(Row([name, Cell(text=f"{row.dataset}, test"), *cells], "published"))
        sources = printed.loc[printed["dataset"].isin(data), "source"]
        if len(sources):
            notes.append(
                f"{address_note(sources)} Over the whole data set, mAP on the targets of 2019. "
                "Whether the images here are all of them is not checked."
            )
    return Table(columns=columns, rows=rows, notes=notes, sortable=True)


def _is_test(split: str) -> bool:
    """Whether published figures are of these images; those are of single views."""
    return split.startswith("test") and not split.endswith("-multiview")


def _object_table(objects: Sequence[BopObject], title: str) -> Table:
    columns = [
        Column(heading="object", numeric=False),
        Column(heading="targets", digits=0),
        Column(heading="instances", digits=0),
        *_percent_columns(),
    ]
    rows = [
        Row(
            [
                Cell(text=str(o.obj_id)),
                *(
                    c.cell(getattr(o, n), missing=NONE)
                    for c, n in zip(
                        columns[1:], ("targets", "instances", *bop_results.SHOWN), strict=True
                    )
                ),
            ]
        )
        for o in objects
    ]
    return Table(columns=columns, rows=rows, title=title, sortable=True)
