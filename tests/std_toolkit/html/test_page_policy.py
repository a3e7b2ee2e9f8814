"""The content security policy of pages: their own scripts run, others do not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from std_toolkit.html.page import Page, Paragraph, Plot, Section

if TYPE_CHECKING:
    from playwright.sync_api import Page as BrowserPage

pytestmark = pytest.mark.slow

CURVE = {"data": [{"type": "scatter", "x": [0, 1], "y": [1, 2]}], "layout": {}}
CLOUD = {
    "data": [
        {"type": "scatter3d", "x": [0, 1], "y": [0, 1], "z": [0, 1], "mode": "markers"},
        {"type": "mesh3d", "x": [0, 1, 0], "y": [0, 0, 1], "z": [0, 0, 0], "i": [0], "j": [1],
         "k": [2]},
    ],
    "layout": {},
}  # fmt: skip


def written(folder: Path, figures: dict[str, dict[str, object]]) -> Path:
    plots = [Plot(name, json.dumps(figure)) for name, figure in figures.items()]
    page = Page(kind="k", title="t", footer="", sections=[Section("s", "S", plots)])
    path = folder / "page.html"
    path.write_text(page.html())
    return path


@pytest.mark.parametrize(
    ("figures", "selector"),
    [({"curve": CURVE}, ".plot .main-svg"), ({"cloud": CLOUD}, ".plot canvas")],
    ids=["curve", "3d"],
)
def test_figures_are_drawn(
    figures: dict[str, dict[str, object]], selector: str, tmp_path: Path, page: BrowserPage
) -> None:
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    page.goto(written(tmp_path, figures).as_uri())
    page.wait_for_selector(selector)
    assert [e for e in errors if "WebGL" not in e] == []


@pytest.mark.parametrize("figures", [{}, {"curve": CURVE}], ids=["plain", "plot"])
def test_a_script_that_got_into_the_page_does_not_run(
    figures: dict[str, dict[str, object]], tmp_path: Path, page: BrowserPage
) -> None:
    path = written(tmp_path, figures) if figures else tmp_path / "page.html"
    if not figures:
        section = Section("s", "S", [Paragraph("text")])
        path.write_text(Page(kind="k", title="t", footer="", sections=[section]).html())
    attack = (
        "<script>document.title = 'taken'</script><img src=x onerror=\"document.title='taken'\">"
    )
    path.write_text(path.read_text().replace("<main>", f"<main>{attack}"))
    page.goto(path.as_uri())
    page.wait_for_timeout(300)
    assert page.title() == "t"
