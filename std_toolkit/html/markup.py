"""HTML of reports: cells, tables, sections, style sheet and script. All text is escaped here.

Style sheet and script of the report. Nothing in them is loaded from anywhere.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

MINUS = "\u2212"

DASH = '<span class="none">–</span>'

CSS = """
:root { --ink:#1f2933; --soft:#52606d; --faint:#7b8794; --rule:#e4e7eb; --wash:#f7f8fa;
  --good:#2b7a4b; --mid:#b7791f; --bad:#b42318; --link:#0b4a7a; }
* { box-sizing:border-box; }
html { scroll-behavior:smooth; scroll-padding-top:3.2rem; }
body { margin:0; color:var(--ink); background:#fff; line-height:1.5; font-size:15px;
  font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif; }
main, header .inner, nav .inner { max-width:1200px; margin:0 auto; padding:0 24px; }
header { padding:28px 0 20px; }
header .kind { color:var(--faint); font-size:13px; letter-spacing:.02em; }
h1 { font-size:28px; line-height:1.2; margin:2px 0 16px; font-weight:650; }
h2 { font-size:20px; font-weight:650; margin:0 0 4px; }
h3 { font-size:15px; font-weight:650; margin:28px 0 6px; }
section { padding:36px 0 8px; border-top:1px solid var(--rule); margin-top:28px; }
main > section:first-child { border-top:0; margin-top:0; }
p { margin:6px 0 12px; max-width:92ch; color:var(--soft); }
a { color:var(--link); }
code { font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,monospace; font-size:.9em;
  background:var(--wash); padding:1px 4px; border-radius:3px; white-space:nowrap; }
.verdict { display:flex; align-items:baseline; gap:14px; padding:14px 18px; border-radius:8px;
  background:var(--wash); border-left:6px solid var(--faint); font-size:17px; }
.verdict b { font-size:19px; white-space:nowrap; }
.verdict.pass { border-color:var(--good); background:#f0f8f3; }
.verdict.pass b { color:var(--good); }
.verdict.fail { border-color:var(--bad); background:#fdf3f2; }
.verdict.fail b { color:var(--bad); }
.facts { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:18px 24px;
  margin:22px 0 6px; }
.facts div span { display:block; color:var(--faint); font-size:13px; }
.facts div b { font-size:21px; font-weight:600; font-variant-numeric:tabular-nums; }
.facts div i { font-style:normal; color:var(--soft); font-size:13px; display:block; }
nav { position:sticky; top:0; background:rgba(255,255,255,.96); z-index:5;
  border-bottom:1px solid var(--rule); font-size:14px; }
nav .inner { display:flex; gap:20px; align-items:center; overflow-x:auto; height:44px; }
nav a { color:var(--soft); text-decoration:none; white-space:nowrap; }
nav a:hover { color:var(--ink); }
nav label { margin-left:auto; white-space:nowrap; color:var(--soft); cursor:pointer; }
.scroll { overflow-x:auto; }
table { border-collapse:collapse; width:100%; font-size:14px; font-variant-numeric:tabular-nums; }
th { text-align:left; font-weight:600; color:var(--soft); font-size:13px; vertical-align:bottom;
  padding:6px 12px 6px 0; border-bottom:1px solid #cbd2d9; }
th small { display:block; font-weight:400; color:var(--faint); }
td { padding:7px 12px 7px 0; border-bottom:1px solid var(--rule); vertical-align:top; }
th.n, td.n { text-align:right; white-space:nowrap; }
td.over { color:var(--bad); font-weight:600; }
td small { color:var(--faint); display:block; }
.tag { display:inline-block; min-width:58px; text-align:center; font-size:12.5px; font-weight:600;
  border-radius:4px; padding:1px 8px; background:#eef0f3; color:var(--soft); }
.tag.pass, .tag.good { background:#e3f3ea; color:var(--good); }
.tag.fail, .tag.bad, .tag.high { background:#fde5e2; color:var(--bad); }
.tag.medium, .tag.doubtful { background:#fdf0d9; color:#8a5a10; }
.chip { display:inline-block; width:11px; height:11px; border-radius:3px; margin-right:7px;
  vertical-align:-1px; }
.plot { width:100%; margin:6px 0 4px; }
.gallery { display:grid; gap:16px; margin:12px 0; }
.gallery.wide { grid-template-columns:repeat(auto-fill,minmax(420px,1fr)); }
.gallery.small { grid-template-columns:repeat(auto-fill,minmax(205px,1fr)); }
.gallery.three { grid-template-columns:repeat(3,minmax(0,1fr)); gap:10px; }
dl.terms { display:grid; grid-template-columns:max-content 1fr; gap:2px 16px; font-size:13px;
  color:var(--soft); margin:12px 0 4px; }
dl.terms dt { font-weight:600; }
dl.terms dd { margin:0; max-width:100ch; }
figure { margin:0; }
figcaption { font-size:13px; color:var(--soft); margin-top:4px; font-variant-numeric:tabular-nums; }
.picture { position:relative; display:block; cursor:zoom-in; background:var(--wash);
  border-radius:4px; overflow:hidden; }
.picture img { display:block; width:100%; height:auto; }
.picture svg { position:absolute; inset:0; width:100%; height:100%; pointer-events:none; }
.picture path { fill:none; stroke-linejoin:round; vector-effect:non-scaling-stroke; }
.picture .halo { stroke:#fff; stroke-opacity:.6; stroke-width:3.2px; }
.picture .line { stroke-width:1.6px; }
body.plain .picture svg { display:none; }
.legend { display:flex; flex-wrap:wrap; gap:4px 18px; font-size:14px; color:var(--soft);
  margin:8px 0; }
.scalebar { display:flex; align-items:center; gap:10px; font-size:13px; color:var(--soft);
  flex-wrap:wrap; margin:8px 0; }
.scalebar i { display:inline-block; width:180px; height:12px; border-radius:2px; }
dialog { border:0; padding:0; width:96vw; height:94vh; max-width:none; max-height:none;
  background:#111; border-radius:6px; overflow:hidden; }
dialog::backdrop { background:rgba(15,20,25,.75); }
dialog .picture { width:100%; height:100%; cursor:zoom-out; background:#111; display:flex;
  align-items:center; justify-content:center; }
dialog .frame { position:relative; }
dialog .frame img { width:100%; height:100%; }
.none { color:var(--faint); }
ul.missing { margin:6px 0 12px; padding-left:20px; color:var(--soft); }
footer { color:var(--faint); font-size:13px; padding:28px 0 40px; }
@media (max-width:700px) { main, header .inner, nav .inner { padding:0 14px; }
  .gallery.wide { grid-template-columns:1fr; } .gallery.three { grid-template-columns:1fr; } }
@media print { nav { display:none; } section { break-inside:avoid; } }
"""

# Draws the figures that `markup.plot` leaves room for.
PLOTS_SCRIPT = """
(function () {
  'use strict';
  var settings = {responsive: true, displaylogo: false, displayModeBar: false};
  document.querySelectorAll('script[type="application/json"][data-plot]').forEach(function (s) {
    var figure = JSON.parse(s.textContent);
    Plotly.newPlot(s.dataset.plot, figure.data, figure.layout, settings);
  });
})();
"""

SCRIPT = (
    PLOTS_SCRIPT
    + """
(function () {
  'use strict';
  var box = document.getElementById('outlines');
  function apply() { document.body.classList.toggle('plain', !box.checked); }
  box.addEventListener('change', apply);
  document.addEventListener('keydown', function (e) {
    if (e.key !== 'o' || e.ctrlKey || e.metaKey || e.altKey) { return; }
    box.checked = !box.checked; apply();
  });
  var dialog = document.getElementById('large');
  function fit(frame, w, h) {
    var k = Math.min(dialog.clientWidth / w, dialog.clientHeight / h);
    frame.style.width = w * k + 'px'; frame.style.height = h * k + 'px';
  }
  document.querySelectorAll('main .picture').forEach(function (p) {
    p.addEventListener('click', function () {
      var holder = document.createElement('div'), frame = document.createElement('div');
      holder.className = 'picture'; frame.className = 'frame';
      frame.innerHTML = p.innerHTML; holder.appendChild(frame);
      dialog.replaceChildren(holder); dialog.showModal();
      fit(frame, +p.dataset.w, +p.dataset.h);
    });
  });
  dialog.addEventListener('click', function () { dialog.close(); });
})();
"""
)


@dataclass(frozen=True)
class Picture:
    """An image and outlines above it.

    Attributes:
        data: JPEG or PNG file.
        mime: "image/jpeg" or "image/png".
        width, height: size of the image in pixels, the unit of the outlines.
        outlines: (object id, SVG path data).
    """

    data: bytes
    mime: str
    width: int
    height: int
    outlines: list[tuple[int, str]] = field(default_factory=list)


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
