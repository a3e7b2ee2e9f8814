"""Theme, text size and list of commands of the page, and what a screen reader is told there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pages import dismiss_notices, escape_dialog, opened, position, wait_until_at
from serving import Served

from annotator.app.palette import DARK, LIGHT

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

# Roles of what can be pressed, typed into or chosen from.
CONTROLS = (
    "button", "textbox", "searchbox", "combobox", "slider", "spinbutton", "checkbox", "switch",
    "listbox", "option", "menuitem", "dialog",
)  # fmt: skip


def rgb(color: str) -> str:
    return "rgb({}, {}, {})".format(*bytes.fromhex(color[1:]))


def surface(page: Page, where: str) -> str:
    return str(page.eval_on_selector(where, "e => getComputedStyle(e).backgroundColor"))


def ask(page: Page, typed: str) -> None:
    """Open the list of commands by its keys and type."""
    page.keyboard.press("Control+Shift+P")
    page.wait_for_selector("#commands input:focus")
    page.wait_for_selector("#found li")
    page.keyboard.type(typed)


def nameless(page: Page) -> list[str]:
    """Controls without a name in the tree that the browser gives to screen readers."""
    session = page.context.new_cdp_session(page)
    nodes: list[dict[str, Any]] = session.send("Accessibility.getFullAXTree")["nodes"]
    controls = [n for n in nodes if n.get("role", {}).get("value") in CONTROLS]
    assert len(controls) > 10
    return [
        str(n["role"]["value"])
        for n in controls
        if not n.get("ignored") and not str(n.get("name", {}).get("value", "")).strip()
    ]


def test_the_light_theme_is_chosen_and_remembered_by_this_browser(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    assert surface(page, ".v-navigation-drawer") == rgb(DARK.window)
    page.locator("[data-menu='View']").click()
    page.locator("[data-action='light_theme']").click()
    page.wait_for_selector(":root[data-theme='light']")
    for where in (".v-navigation-drawer", ".v-app-bar", ".v-footer"):
        assert surface(page, where) == rgb(LIGHT.window)
    assert surface(page, ".main .view") == rgb(LIGHT.stage)
    opened(page, served.url)
    page.wait_for_selector(":root[data-theme='light']")
    page.locator("[data-menu='View']").click()
    page.wait_for_selector("[data-action='light_theme'] use.on")
    # Another person at the same server has a theme of their own.
    context = page.context.browser.new_context()  # type: ignore[union-attr]
    other = opened(context.new_page(), served.url)
    assert surface(other, ".v-app-bar") == rgb(DARK.window)
    context.close()


def test_larger_text_fits_into_1366_by_768(served: Served, page: Page) -> None:
    page.set_viewport_size({"width": 1366, "height": 768})
    opened(page, served.url)
    height = "e => parseFloat(getComputedStyle(e).fontSize)"
    before = page.eval_on_selector("#verdict", height)
    width = page.locator(".v-navigation-drawer").bounding_box()["width"]  # type: ignore[index]
    for percent in (110, 120, 130):
        ask(page, "larger")
        page.wait_for_selector("#found li:first-child[data-found='larger_text']")
        page.keyboard.press("Enter")
        page.wait_for_function(
            "share => document.documentElement.style.getPropertyValue('--text-share') == share",
            arg=percent / 100,
        )
        page.wait_for_selector("#commands", state="detached")
    assert page.eval_on_selector("#verdict", height) == pytest.approx(1.3 * before, rel=0.02)
    box = page.locator(".v-navigation-drawer").bounding_box()
    assert box is not None
    assert box["width"] == pytest.approx(1.3 * width, abs=2)
    assert page.evaluate("document.documentElement.scrollWidth") <= 1366
    # Nothing of the panels sticks out at the side, and all tools and menus are there.
    wide = """(all) => all.filter(e => e.offsetParent && e.getBoundingClientRect().right > 1367)
        .map(e => e.outerHTML.slice(0, 80))"""
    assert page.eval_on_selector_all(".panels *, .v-app-bar .menu, .tools .tool", wide) == []
    main = page.locator("[data-view='0']").bounding_box()
    assert main is not None
    assert main["width"] > 0.4 * 1366


def test_a_command_is_found_and_run_by_keys(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    ask(page, "move left")
    page.wait_for_selector("#found li:first-child[data-found='left'][aria-selected='true']")
    page.keyboard.press("Enter")
    wait_until_at(page, before + np.array([-1, 0, 0]))
    page.keyboard.press("Control+z")
    wait_until_at(page, before)
    ask(page, "frame")
    page.wait_for_selector("[data-found='2']")
    marked = page.locator("#found [aria-selected='true']")
    for _ in range(10):
        if marked.get_attribute("data-found") == "2":
            break
        page.keyboard.press("ArrowDown")
    field = page.locator("#commands input")
    assert field.get_attribute("aria-activedescendant") == marked.get_attribute("id")
    page.keyboard.press("Enter")
    page.wait_for_selector("#frame:has-text('frame 2')")


def test_what_cannot_be_run_says_why(served: Served, page: Page) -> None:
    opened(page, served.url)
    ask(page, "take the turn")
    page.wait_for_selector("#found li:first-child[data-found='take_turn'][aria-disabled='true']")
    page.wait_for_selector("#commands [role='status']:has-text('Not now: no turn is known')")
    page.keyboard.press("Enter")
    assert page.locator("#commands").count() == 1
    page.keyboard.press("Escape")
    page.wait_for_selector("#commands", state="detached")


def test_every_control_of_the_page_has_a_name(served: Served, page: Page) -> None:
    opened(page, served.url)
    assert nameless(page) == []
    page.eval_on_selector("[data-tool='save']", "e => e.removeAttribute('aria-label')")
    assert nameless(page) == ["button"]
    page.eval_on_selector("[data-tool='save']", "e => e.setAttribute('aria-label', 'Save')")
    ask(page, "")
    assert nameless(page) == []
    page.keyboard.press("Escape")
    page.wait_for_selector("#commands", state="detached")
    for key in ("F1", "F2", "F3", "F4", "c"):
        page.keyboard.press(key)
        page.wait_for_selector("#points" if key == "c" else "#dialog")
        assert nameless(page) == [], key
        escape_dialog(page)
    page.keyboard.press("c")
    dismiss_notices(page)


def test_the_verdict_is_told_in_a_live_region_that_stays(served: Served, page: Page) -> None:
    opened(page, served.url)
    said = page.locator("#said[role='status']")
    page.wait_for_function("document.querySelector('#said').textContent.includes('box_1')")
    word = page.locator("#card .word").inner_text()
    assert f"Verdict on box_1: {word}. " in (said.text_content() or "")
    page.eval_on_selector("#said", "e => { e.dataset.old = 'yes' }")
    page.keyboard.press("c")  # the card goes while points are clicked
    page.wait_for_selector("#card", state="detached")
    assert said.get_attribute("data-old") == "yes"
    page.keyboard.press("c")
    page.wait_for_selector("#card")
