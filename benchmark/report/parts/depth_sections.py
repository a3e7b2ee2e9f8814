"""The sections of the page: tables, breakdowns, pictures, what ran."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import numpy as np
import pandas as pd

from benchmark.evaluation.depth_panels import PANELS, TRUST_PANEL
from benchmark.evaluation.tasks.depth_pictures import FOLDER, INDEX_FILE, Gallery
from benchmark.evaluation.tasks.depth_results import RunResult
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.report.leaderboard import (
    BOARD,
    COSTS,
    MEASURED,
    METRICS,
    PAPERS_PROTOCOL,
    PUBLISHED,
    SIGNIFICANT,
    Board,
    Column,
    one_of_each,
)
from benchmark.report.leaderboard_text import MAIN_SUBSETS, best_figures, not_worse, printed_where
from benchmark.report.parts.depth_plots import (
    DEPTH_PREFIX,
    bars,
    depth_curves,
    radar,
    speed_against_error,
)
from std_toolkit.html.markup import Cell, paragraph, plot, table, words
from std_toolkit.io.documents import read_document

RMSE = METRICS[0]
FEW_SCENES = 10
_RANKS = {
    "best": "where it does best",
    "median": "as usual",
    "worst": "where it does worst",
}


def leaderboard(board: Board, split: str, protocol: str, colors: dict[str, str]) -> str:
    """Tables, bars and radar of one split by one protocol."""
    grid, first = get_protocol(protocol).main
    parts = []
    for subset in dict.fromkeys((first, *MAIN_SUBSETS)):
        rows = board.part(split, protocol, grid, subset)
        if (rows["kind"] == MEASURED).sum() == 0:
            continue
        frames = int(rows.loc[rows["kind"] == MEASURED, "frames"].max())
        scenes = int(rows.loc[rows["kind"] == MEASURED, "scenes"].max())
        parts.append(f"<h3>{escape(_objects(subset))}</h3>")
        parts.append(
            paragraph(
                f"{_counted(frames, 'frame')} of {_counted(scenes, 'scene')} with such pixels. "
                f"Bold: best measured. {_certainty(scenes, (rows['kind'] == MEASURED).sum())}"
            )
        )
        if protocol != PAPERS_PROTOCOL and (rows["kind"] == PUBLISHED).any():
            parts.append(
                paragraph(
                    "Published rows were made by the paper's own evaluation, `--protocol paper`, "
                    "in which a hole costs less: here they tell the order of magnitude."
                )
            )
        parts.append(_table(rows, BOARD))
    rows = board.part(split, protocol, grid, first)
    name = _anchor(split, protocol)
    parts.append('<div class="pair">')
    parts.append(plot(f"bars-{name}", bars(rows, colors)))
    parts.append(plot(f"radar-{name}", radar(rows, colors)))
    parts.append("</div>")
    return "".join(parts)


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def can_differ(scenes: int, methods: int) -> bool:
    """Whether the test of differences could tell two of the methods apart at all: over n scenes it
    gives no p below 2 / 2**n, and all pairs are corrected for."""
    pairs = methods * (methods - 1) / 2
    return bool(pairs * 2.0 ** (1 - scenes) < SIGNIFICANT)


def _certainty(scenes: int, methods: int) -> str:
    if scenes < 2:
        return "With one scene there are no intervals, and no test of differences."
    few = ", too narrow with so few of them" if scenes < FEW_SCENES else ""
    intervals = f"Small: 95 % intervals over scenes{few}."
    if methods < 2:
        return intervals
    if not can_differ(scenes, methods):
        return (
            f"{intervals} With {_counted(scenes, 'scene')} and {methods} methods no difference "
            "can be significant."
        )
    return (
        f"{intervals} ≈: not significantly worse than the best in RMSE (sign-flip test over "
        "scenes, corrected for all pairs)."
    )


def breakdown(board: Board, split: str, protocol: str, colors: dict[str, str]) -> str:
    """RMSE by material, at edges, at native size, by scene and by depth."""
    grid, first = get_protocol(protocol).main
    rows = board.rows[(board.rows["split"] == split) & (board.rows["protocol"] == protocol)]
    rows = rows[rows["kind"] == MEASURED]
    fixed = rows[~rows["subset"].str.startswith(DEPTH_PREFIX)]
    order = board.part(split, protocol, grid, first)
    methods = order.loc[order["kind"] == MEASURED, "method"].tolist()
    parts = []
    for name, block in fixed.groupby("grid", sort=False):
        wide = block.pivot(index="method", columns="subset", values=RMSE.name)
        wide = wide.reindex(index=methods, columns=list(dict.fromkeys(block["subset"])))
        parts.append(f"<h3>{RMSE.title} by pixels, {escape(str(name))}</h3>{_matrix(wide)}")
    frames = board.tables
    chosen = (frames["split"] == split) & (frames["protocol"] == protocol)
    chosen &= (frames["grid"] == grid) & (frames["subset"] == first) & (frames["n_pixels"] > 0)
    scenes = frames[chosen].pivot_table(
        index="scene", columns="method", values=RMSE.name, aggfunc="mean"
    )
    scenes = scenes.reindex(columns=[m for m in methods if m in scenes])
    if len(scenes) > 1:
        parts.append(f"<h3>{RMSE.title} by scene</h3>{_matrix(scenes, by_row=True)}")
    curve = depth_curves(rows, colors)
    if curve is not None:
        parts.append("<h3>Error against depth</h3>")
        parts.append(plot(f"depth-{_anchor(split, protocol)}", curve))
    return "".join(parts)


def speed(board: Board, colors: dict[str, str]) -> str:
    """Cost of each method, and accuracy against speed on the first board."""
    split, protocol = board.boards[0]
    rows = board.main_rows(split, protocol)
    known = one_of_each(rows.dropna(subset=["frames_per_s"]))
    if known.empty:
        return ""
    figure = speed_against_error(known, colors)
    return (
        paragraph(f"On {split}, protocol {protocol}. Reading and scoring are not in it.")
        + _table(known, (RMSE, *COSTS), hardware=True)
        + plot("speed", figure)
    )


def gallery(results: Sequence[RunResult]) -> str:
    """The frames that all methods show, method by method; then each method's own extremes."""
    parts = []
    found = [(r, _gallery_of(r)) for r in results]
    common: dict[tuple[str, str, str, str], list[tuple[RunResult, str, float]]] = {}
    for result, pictures in found:
        setup = result.manifest.setup
        for p in pictures.pictures if pictures else ():
            if p.rank == "common":
                key = (setup.split, setup.protocol, p.scene, p.frame)
                common.setdefault(key, []).append((result, p.picture, p.rmse))
    for (split, protocol, scene, frame), shown in common.items():
        parts.append(f"<h3>{escape(f'{split} {scene}/{frame}, {protocol}')}</h3>")
        parts.append(_panel_titles(PANELS))
        for result, picture, rmse in sorted(shown, key=lambda s: s[2]):
            parts.append(_strip(result, picture, f"{result.manifest.label}: {rmse * 1e3:.1f} mm"))
    for result, pictures in found:
        own = [p for p in pictures.pictures if p.rank in _RANKS] if pictures else []
        if not own:
            continue
        setup = result.manifest.setup
        title = f"{result.manifest.label} on {setup.split}, {setup.protocol}"
        panels = (*PANELS, TRUST_PANEL) if all(p.trust for p in own) else PANELS
        strips = "".join(
            _strip(
                result,
                p.picture,
                f"{_RANKS[p.rank]}: {p.scene}/{p.frame}, {p.rmse * 1e3:.1f} mm",
            )
            for p in own
        )
        parts.append(
            f"<details><summary>{escape(title)}</summary>{_panel_titles(panels)}{strips}</details>"
        )
    if not parts:
        return ""
    return _legend() + "".join(parts)


def _panel_titles(titles: Sequence[str]) -> str:
    spans = "".join(f"<span>{escape(t)}</span>" for t in titles)
    columns = f"grid-template-columns:repeat({len(titles)},1fr)"
    return f'<div class="panels" style="{columns}">{spans}</div>'


def runs(results: Sequence[RunResult]) -> str:
    """What ran, with what, on what; and what failed."""
    rows = []
    for result in results:
        m, s = result.manifest, result.manifest.setup
        settings = ", ".join(f"{k}={v}" for k, v in sorted(s.settings.items()))
        how = [s.preset, s.precision, *(["compiled"] if s.compile else []), settings]
        network = result.speed is not None and result.speed.parameters is not None
        failed = result.table.loc[result.table["error"] != "", "index"].nunique()
        rows.append(
            [
                escape(m.label),
                escape(f"{s.split}, {s.protocol}"),
                str(s.frames)
                if not result.missing
                else f'<b class="over">{s.frames - result.missing} of {s.frames}</b>',
                f'<b class="over">{failed}</b>' if failed else "0",
                escape(", ".join(h for h in how if h) if network or settings else settings),
                f"<code>{escape(s.weights_sha256[:12])}</code>" if s.weights_sha256 else "",
                escape(m.hardware.get("gpus") or m.hardware.get("processor", "")),
                escape(m.version_of_tool),
            ]
        )
    heads = ("method", "split, protocol", "frames", "failed", "how", "weights", "ran on", "tool")
    numeric = (heads.index("frames"), heads.index("failed"))
    cells = [[Cell(html, numeric=i in numeric) for i, html in enumerate(row)] for row in rows]
    return table([(head, "") for head in heads], cells)


def _table(rows: pd.DataFrame, columns: Sequence[Column], *, hardware: bool = False) -> str:
    best = best_figures(rows, columns)
    methods = int((rows["kind"] == MEASURED).sum())
    heads = "".join(
        f'<th class="n" data-less="{int(c.less_is_better is not False)}">{escape(c.heading)}'
        f"<small>{escape(c.unit)}</small></th>"
        for c in columns
    )
    last = "<th>on</th>" if hardware else ""
    body = []
    for row in rows.itertuples():
        printed = row.kind == PUBLISHED
        note = f"<small>published; {escape(printed_where(row))}</small>" if printed else ""
        # Costs are not what the test is about.
        tested = not printed and not hardware and can_differ(row.scenes, methods)
        mark = "" if not tested or not not_worse(row) else ' <abbr title="not worse">≈</abbr>'
        cells = [f"<td>{escape(row.method)}{mark}{note}</td>"]
        for column in columns:
            value = getattr(row, column.name)
            text = column.text(value, printed=printed)
            if (row.Index, column.name) in best and not printed:
                text = f"<b>{text}</b>"
            order = "" if pd.isna(value) else repr(float(value))
            cells.append(f'<td class="n" data-v="{order}">{text}{_interval(row, column)}</td>')
        if hardware:
            cells.append(f"<td>{escape(str(row.hardware))}</td>")
        body.append(f"<tr{' class=published' if printed else ''}>{''.join(cells)}</tr>")
    return (
        '<div class="scroll"><table class="sortable"><thead><tr><th>method</th>'
        f"{heads}{last}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def _interval(row: object, column: Column) -> str:
    low = getattr(row, f"{column.name}_low", np.nan)
    high = getattr(row, f"{column.name}_high", np.nan)
    if pd.isna(low) or pd.isna(high):
        return ""
    return f"<small>{column.text(low)}–{column.text(high)}</small>"


def _matrix(wide: pd.DataFrame, *, by_row: bool = False) -> str:
    """A table of RMSE shaded from the best to the worst of each column, or of each row."""
    values = wide.to_numpy(float)
    axis = 1 if by_row else 0
    with np.errstate(all="ignore"):
        low = np.nanmin(values, axis=axis, keepdims=True)
        high = np.nanmax(values, axis=axis, keepdims=True)
        level = (np.log(values + 1e-4) - np.log(low + 1e-4)) / np.log((high + 1e-4) / (low + 1e-4))
    heads = ["method" if not by_row else "scene", *(str(c) for c in wide.columns)]
    body = []
    for name, line, shades in zip(wide.index, values, level, strict=True):
        cells = [f"<td>{escape(str(name))}</td>"]
        for value, shade in zip(line, shades, strict=True):
            tint = (
                "" if not np.isfinite(shade) else f"background:rgba(180,35,24,{0.28 * shade:.2f})"
            )
            cells.append(f'<td class="n" style="{tint}">{RMSE.text(value) or "–"}</td>')
        body.append(f"<tr>{''.join(cells)}</tr>")
    head = "".join(
        f"<th{' class=n' if i else ''}>{escape(text)}</th>" for i, text in enumerate(heads)
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def _gallery_of(result: RunResult) -> Gallery | None:
    path = result.folder / FOLDER / INDEX_FILE
    return read_document(path, Gallery) if path.exists() else None


def _strip(result: RunResult, picture: str, caption: str) -> str:
    data = base64.b64encode((result.folder / FOLDER / picture).read_bytes()).decode("ascii")
    return (
        f'<figure class="strip"><img alt="{escape(caption)}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _legend() -> str:
    return (
        paragraph("The first frames are the same for every method, best method on top.")
        + '<div class="scalebar"><i style="background:linear-gradient(90deg,#fde725,#21918c,'
        '#440154)"></i>depth, near to far: what the ground truth of the frame spans'
        '<i style="background:linear-gradient(90deg,#000004,#bc3754,#fcffa4)"></i>'
        "error, 0 to 50 mm"
        '<i style="width:14px;background:#963cc8"></i>no answer'
        '<i style="width:14px;background:#1c1c20"></i>no ground truth, or no depth'
        '<i style="background:linear-gradient(90deg,#000,#54546f,#a9c5c5,#fff)"></i>'
        "trust in the sensor, 0 to 1</div>"
    )


def _objects(subset: str) -> str:
    return {"all": "All objects", "specular+transparent": "Specular and transparent"}.get(
        subset, subset
    )


def _anchor(split: str, protocol: str) -> str:
    return f"{split}-{protocol}".replace(":", "-").replace(".", "-")


def summary_line(board: Board) -> str:
    """One sentence on who is best where."""
    said = []
    for split, protocol in board.boards:
        rows = board.main_rows(split, protocol)
        best = rows[rows["kind"] == MEASURED].iloc[0]
        said.append(f"{best['method']} on {split} ({RMSE.text(best['rmse'])} mm, {protocol})")
    return words("Lowest RMSE: " + "; ".join(said) + ".")
