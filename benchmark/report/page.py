"""The page: one HTML file that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from benchmark.report.part import PageSection, ReportPart
from std_toolkit import __version__
from std_toolkit.checks.markup import section, words
from std_toolkit.checks.style import CSS, PLOTS_SCRIPT

_STYLE = """
td small, th small { display:block; color:var(--faint); font-weight:400; font-size:11.5px; }
tr.published td { background:#f4f1ea; font-style:italic; color:var(--soft); }
tr.published small { font-style:normal; }
th:first-child, td:first-child { min-width:130px; overflow-wrap:anywhere; }
nav .inner { height:auto; min-height:44px; flex-wrap:wrap; gap:2px 20px; }
table.sortable th { cursor:pointer; user-select:none; }
table.sortable th[aria-sort="ascending"]::after { content:" \\25B2"; font-size:9px; }
table.sortable th[aria-sort="descending"]::after { content:" \\25BC"; font-size:9px; }
abbr { text-decoration:none; color:var(--faint); cursor:help; }
.pair { display:grid; grid-template-columns:repeat(auto-fit,minmax(420px,1fr)); gap:16px; }
.strip { margin:0 0 10px; }
.strip img { width:100%; display:block; border-radius:3px; }
.panels { display:grid; font-size:12px; color:var(--faint);
  margin:2px 0; }
details { margin:8px 0; }
summary { cursor:pointer; color:var(--link); font-size:15px; }
b.over { color:var(--bad); }
tr.bound td { color:var(--faint); }
h4 { font-size:13.5px; font-weight:600; margin:16px 0 4px; color:var(--soft); }
ul.findings { padding-left:20px; max-width:92ch; }
ul.findings li { margin:6px 0; }
b.good { color:var(--good); }
img.boxes { width:100%; display:block; border-radius:3px; }
.sidebyside { display:grid; grid-template-columns:repeat(var(--n),minmax(0,1fr)); gap:10px;
  max-width:calc(var(--n) * 400px); }
@media (max-width:700px) { .sidebyside { grid-template-columns:1fr; } }
.verdict + .verdict { margin-top:8px; }
"""
_SCRIPT = """
(function () {
  'use strict';
  function value(row, column, numeric) {
    var cell = row.cells[column];
    if (!numeric) { return cell.textContent.toLowerCase(); }
    return cell.dataset.v === '' ? NaN : Number(cell.dataset.v);
  }
  document.querySelectorAll('table.sortable').forEach(function (table) {
    table.querySelectorAll('th').forEach(function (head, column) {
      head.tabIndex = 0;
      function sort() {
        var numeric = head.classList.contains('n');
        var now = head.getAttribute('aria-sort');
        var first = numeric && head.dataset.less === '0' ? 'descending' : 'ascending';
        var other = first === 'ascending' ? 'descending' : 'ascending';
        var way = now === first ? other : first;
        table.querySelectorAll('th').forEach(function (h) { h.removeAttribute('aria-sort'); });
        head.setAttribute('aria-sort', way);
        var sign = way === 'ascending' ? 1 : -1;
        var rows = Array.from(table.tBodies[0].rows);
        rows.sort(function (a, b) {
          var x = value(a, column, numeric), y = value(b, column, numeric);
          if (numeric && (isNaN(x) || isNaN(y))) { return isNaN(x) - isNaN(y); }
          return sign * (x < y ? -1 : x > y ? 1 : 0);
        });
        rows.forEach(function (row) { table.tBodies[0].appendChild(row); });
      }
      head.addEventListener('click', sort);
      head.addEventListener('keydown', function (e) { if (e.key === 'Enter') { sort(); } });
    });
  });
})();
"""


def render_page(parts: Sequence[ReportPart]) -> str:
    """The parts as HTML; the same results give the same bytes."""
    from plotly.offline import get_plotlyjs

    shown = [s for s in (_answers(parts), *(s for p in parts for s in p.sections)) if s.html]
    links = "".join(f'<a href="#{s.anchor}">{escape(s.title)}</a>' for s in shown)
    titles = [part.title for part in parts]
    title = ", ".join([titles[0], *(t[:1].lower() + t[1:] for t in titles[1:])])
    lines = "".join(f'<div class="verdict"><span>{part.summary}</span></div>' for part in parts)
    files = words(", ".join(f"`{name}`" for part in parts for name in part.files))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<title>Benchmark: {escape(title)}</title><link rel="icon" href="data:,">'
        f"<style>{CSS}{_STYLE}</style></head><body>"
        '<header><div class="inner"><div class="kind">Benchmark</div>'
        f"<h1>{escape(title)}</h1>{lines}</div></header>"
        f'<nav><div class="inner">{links}</div></nav>'
        f"<main>{''.join(section(s.anchor, s.title, s.html) for s in shown)}"
        f"<footer>std-toolkit {__version__}, std-report. The same figures: {files}."
        f"</footer></main><script>{get_plotlyjs()}</script><script>{PLOTS_SCRIPT}{_SCRIPT}</script>"
        "</body></html>\n"
    )


def _answers(parts: Sequence[ReportPart]) -> PageSection:
    """What every task says to the question that the page is for."""
    html = "".join(f"<h3>{escape(p.title)}</h3>{p.answer}" for p in parts if p.answer)
    return PageSection("does-it-help", "Does restoring depth help, and how sure is that?", html)
