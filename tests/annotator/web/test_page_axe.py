"""The pages as axe-core judges them, which knows what assistive technology needs."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from board_lab import make_lab
from pages import PATIENCE_MS, dismiss_notices, escape_dialog, opened
from serving import Served

from tests.std_toolkit.project.lab import template

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

# Colours are read when they have come to rest.
_AT_REST = """() => Promise.allSettled(document.getAnimations()
    .filter((a) => Number.isFinite(a.effect.getComputedTiming().endTime)).map((a) => a.finished))"""


def findings(page: Page) -> list[str]:
    """What axe-core finds, with the rule and where, whatever its weight."""
    from axe_playwright_python.sync_playwright import Axe

    page.evaluate(_AT_REST)
    found = Axe().run(page).response["violations"]
    return [
        f"{rule['impact']} {rule['id']}: {node['html'][:160]}: {node.get('failureSummary')}"
        for rule in found
        for node in rule["nodes"]
    ]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_board_and_the_page_of_a_scene(
    serve: Callable[..., Served], tmp_path: Path, page: Page, scheme: str
) -> None:
    scenes = {"fits": ("Ann", "fits"), "doubt": ("Ann", "doubtful"), "new": ("", None)}
    project, tokens = make_lab(template(tmp_path / "template"), tmp_path, scenes)  # type: ignore[arg-type]
    server = serve(project.root)
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{server.url}/?token={tokens['Ben']}")
    page.click("#history summary")
    page.wait_for_selector("#history li")
    assert findings(page) == []
    for name in scenes:
        page.goto(re.sub(r"(?<=\d)/.*", f"/scenes/{name}", page.url))
        assert findings(page) == []
    # axe sees what is wrong with a page.
    page.evaluate("document.querySelector('textarea').id = 'nothing'")
    assert any("critical label" in found for found in findings(page))


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_scene_and_each_dialog(served: Served, page: Page, theme: str) -> None:
    opened(page, served.url)
    if theme == "light":
        page.locator("[data-menu='View']").click()
        page.locator("[data-action='light_theme']").click()
        page.wait_for_selector(":root[data-theme='light']")
        page.wait_for_selector(".v-menu.v-overlay--active", state="detached")
    page.wait_for_selector("#card .word")
    page.wait_for_selector("#library img")
    found = {"scene": findings(page)}
    page.keyboard.press("F6")
    page.wait_for_selector("#objects .v-list-item:focus")
    found["list"] = findings(page)
    page.keyboard.press("Escape")
    page.locator("[data-menu='View']").click()
    page.wait_for_selector("[data-action='light_theme']")
    found["menu"] = findings(page)
    page.keyboard.press("Escape")
    page.wait_for_selector(".v-menu.v-overlay--active", state="detached")
    for key in ("F1", "F2", "F3", "F4", "Control+m"):
        page.keyboard.press(key)
        page.wait_for_selector("#dialog")
        found[key] = findings(page)
        escape_dialog(page)
    page.keyboard.press("c")
    page.wait_for_selector("#points")
    found["points"] = findings(page)
    page.keyboard.press("c")
    page.keyboard.press("Control+Shift+P")
    page.wait_for_selector("#found li")
    found["commands"] = findings(page)
    page.keyboard.press("Escape")
    page.wait_for_selector("#commands", state="detached")
    dismiss_notices(page)
    assert {where: flaws for where, flaws in found.items() if flaws} == {}
