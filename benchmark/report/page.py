"""The report: a part for each task, on one self-contained HTML page.

The page: one HTML file that needs nothing but itself.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from benchmark.evaluation.manifest import BOP_FILE, GRASP_MANIFEST, MANIFEST, POSE_MANIFEST
from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.html.markup import CSS, PLOTS_SCRIPT, section, words

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


@dataclass(frozen=True)
class PageSection:
    """A section of the page.

    Attributes:
        anchor: unique on the page.
        title: of its heading and its link.
        html: what it holds; a section without anything is left out.
    """

    anchor: str
    title: str
    html: str


@dataclass(frozen=True, kw_only=True)
class ReportPart:
    """All that one task adds.

    Attributes:
        title: what was measured, such as "Depth restoration".
        summary: HTML, a sentence for the head of the page.
        sections: of the page, in their order.
        answer: HTML, what the task says to whether restoring depth helps, and how sure that is;
            empty if it has nothing to say.
        terminal: tables as text.
        files: further files by name, written beside the page.
    """

    title: str
    summary: str
    sections: Sequence[PageSection]
    answer: str = ""
    terminal: str = ""
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ReportTask:
    """A task that reports know.

    Attributes:
        manifest: name of a file that the folder of every run of this task holds, and no other.
        make: `module:function` that makes the part of some folders of results. It is called with
            those that hold such a file, and with `published`: whether figures of papers stand
            beside the measured ones.
    """

    manifest: str
    make: str

    def part(self, folders: Sequence[Path], *, published: bool) -> ReportPart:
        """The part of these folders of results.

        Raises:
            ToolkitError: results that are damaged, or hold nothing.
        """
        module, _, name = self.make.partition(":")
        make: Callable[..., ReportPart] = getattr(importlib.import_module(module), name)
        return make(folders, published=published)


TASKS = (
    ReportTask(MANIFEST, "benchmark.report.parts.depth:depth_part"),
    ReportTask(POSE_MANIFEST, "benchmark.report.parts.pose:pose_part"),
    ReportTask(BOP_FILE, "benchmark.report.parts.pose:bop_part"),
    ReportTask(GRASP_MANIFEST, "benchmark.report.parts.grasp:grasp_part"),
)


def make_parts(folders: Sequence[Path], *, published: bool = True) -> list[ReportPart]:
    """The parts of all tasks that have results in these folders.

    Raises:
        ToolkitError: a folder has none, or what it has cannot be used.
    """
    holds = {
        task: [folder for folder in folders if next(folder.rglob(task.manifest), None) is not None]
        for task in TASKS
    }
    for folder in folders:
        if not any(folder in found for found in holds.values()):
            raise ToolkitError("no results of std-bench here", path=folder)
    return [task.part(found, published=published) for task, found in holds.items() if found]


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
