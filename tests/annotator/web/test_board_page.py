"""The board of a project in a real browser: by mouse, by keys, and while others work."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from board_lab import make_lab, sessions_of
from pages import PATIENCE_MS, opened, position, wait_for_move
from serving import Served

from annotator.session import Session
from std_toolkit.project.queue import comment_scene
from std_toolkit.scene.review import read_reviews
from tests.std_toolkit.project.lab import template

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

# Contrast of every text on its background, by the formula of WCAG 2.
_CONTRAST = """() => {
    const canvas = document.createElement("canvas").getContext("2d");
    const rgb = (color) => {
        canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
        return [...canvas.getImageData(0, 0, 1, 1).data];
    };
    const light = ([r, g, b]) => [r, g, b].map((x) => x / 255)
        .map((x) => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
        .reduce((sum, x, i) => sum + x * [0.2126, 0.7152, 0.0722][i], 0);
    const behind = (element) => {
        for (let e = element; e; e = e.parentElement) {
            const color = getComputedStyle(e).backgroundColor;
            if (color !== "rgba(0, 0, 0, 0)") return color;
        }
        return "white";
    };
    const found = [];
    for (const e of document.querySelectorAll("body *")) {
        const text = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
        if (!text || !e.checkVisibility() || e.disabled) continue;
        const [a, b] = [getComputedStyle(e).color, behind(e)].map((c) => light(rgb(c))).sort();
        const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        if (ratio < 4.5) found.push(`${e.tagName} ${e.className} ${ratio.toFixed(2)}`);
    }
    return found;
}"""
# What a screen reader would not name: controls, pictures and tables without a text.
_NAMELESS = """() => [...document.querySelectorAll("a, button, input:not([type=hidden]), select,"
    + " textarea, img, main, h1")]
    .filter((e) => e.checkVisibility() && !(e.innerText || e.alt || e.ariaLabel || e.title
        || [...(e.labels ?? [])].some((label) => label.innerText)))
    .map((e) => e.outerHTML.slice(0, 80))"""


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return template(tmp_path_factory.mktemp("lab") / "template")


@pytest.fixture
def at_board(
    serve: Callable[..., Served], rendered: Path, tmp_path: Path, page: Page
) -> tuple[Served, Page]:
    """The board of "Ben" with a scene that fits, a doubtful one and one without a label."""
    scenes = {"fits": ("Ann", "fits"), "doubt": ("Ann", "doubtful"), "mine": ("Ben", "fits")}
    project, tokens = make_lab(rendered, tmp_path, scenes)  # type: ignore[arg-type]
    server = serve(project.root)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{server.url}/?token={tokens['Ben']}")
    return server, page


def test_a_scene_is_reviewed_by_keys_alone(at_board: tuple[Served, Page], tmp_path: Path) -> None:
    _, page = at_board
    seen = []
    while page.evaluate("document.activeElement.id") != "do-first":
        page.keyboard.press("Tab")
        seen.append(page.evaluate("document.activeElement.id"))
        assert len(seen) < 10
    page.keyboard.press("Enter")
    page.wait_for_url("**/scenes/doubt#review")
    while page.evaluate("document.activeElement.name") != "about: box_1":
        page.keyboard.press("Tab")
    assert "Why is it kept?" in page.evaluate("document.activeElement.labels[0].innerText")
    page.keyboard.type("the rim fits")
    while page.evaluate("document.activeElement.value") != "accept":
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_url("**/scenes/doubt")
    page.wait_for_selector(".stage:has-text('accepted')")
    (row,) = read_reviews(tmp_path / "doubt").reviews
    assert (row.by, row.verdict, row.reasons) == ("Ben", "accepted", {"box_1": "the rim fits"})


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_is_legible_and_every_control_has_a_name(
    at_board: tuple[Served, Page], scheme: str
) -> None:
    _, page = at_board
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    for path in ("/", "/scenes/doubt"):
        page.goto(re.sub(r"(?<=\d)/.*", path, page.url))
        page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
        assert page.evaluate(_CONTRAST) == []
        assert page.evaluate(_NAMELESS) == []
        # Nothing is wider than the page.
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_the_board_filters_and_shows_what_others_do(
    at_board: tuple[Served, Page], tmp_path: Path
) -> None:
    from std_toolkit.project.record import Project

    _, page = at_board
    page.fill("#sought", "ann doubt")
    assert page.locator(".card:visible h3").all_inner_texts() == ["doubt"]
    assert page.locator("#found").inner_text() == "1 of 3"
    lab = Project.open(tmp_path / "lab")
    comment_scene(lab, "doubt", by="Ann", text="look at <b>frame 1</b>")
    page.wait_for_selector(".card:has-text('1 comment')")
    # What was typed and the focus stay.
    assert page.input_value("#sought") == "ann doubt"
    assert page.locator(".card:visible").count() == 1
    assert page.evaluate("document.activeElement.id") == "sought"
    page.fill("#sought", "")
    page.select_option("#verdict", "fits")
    assert page.locator(".card:visible h3").all_inner_texts() == ["fits", "mine"]
    page.click("#history summary")
    assert "look at <b>frame 1</b>" in page.locator("#history").inner_text()


def test_a_killed_session_says_so_goes_on_and_leads_back(
    at_board: tuple[Served, Page], tmp_path: Path
) -> None:
    server, page = at_board
    page.click("#card-mine")
    page.click("form.opens button")
    page.wait_for_url("**/at/edit/mine/**")
    opened(page, page.url)
    before = position(page)
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector("[data-tool='undo']:not([disabled])")
    moved = wait_for_move(page, before)
    page.mouse.move(400, 300)
    page.mouse.down()
    page.mouse.move(430, 310)
    os.kill(sessions_of(server.process.pid)["mine"], signal.SIGKILL)
    page.wait_for_selector("#lost:has-text('No edit is lost')")
    page.mouse.up()
    page.click("#dialog button:has-text('Recover')")
    page.wait_for_selector("[data-tool='undo']:not([disabled])")
    assert abs(position(page) - moved).max() < 0.02
    # Back to the board, with the edit saved.
    page.click("[data-tool='close']")
    page.click("#dialog button:has-text('Save')")
    page.wait_for_url(server.url.rstrip("/") + "/")
    with Session.open(tmp_path / "mine", read_only=True) as session:
        assert session.state.objects
    page.wait_for_function("() => !document.querySelector('.open')", timeout=20_000)
