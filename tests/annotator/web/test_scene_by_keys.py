"""A scene labelled in the browser without a mouse, from the board and back to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from board_lab import make_lab
from pages import PATIENCE_MS, opened, position, sharp, wait_for_move, wait_until_at
from serving import Served

from std_toolkit.scene import Scene
from tests.std_toolkit.project.lab import template

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

# What has the focus, and whether that can be seen.
_FOCUS = """() => {
    const e = document.activeElement, style = getComputedStyle(e);
    const ring = style.outlineStyle !== "none" || e.matches("input, .v-slider-thumb");
    const parts = [".panels", ".bottom", ".v-app-bar", ".views"];
    const number = e.closest("[data-position]")?.dataset.position;
    return {
        part: parts.find((part) => e.closest(part)) ?? e.tagName,
        name: e.dataset.tool || e.dataset.add || number || e.id,
        seen: e === document.body || ring && e.checkVisibility(),
    };
}"""


def focus(page: Page) -> tuple[str, str]:
    """Part of the page and name of what has the focus, which is to be seen."""
    found = page.evaluate(_FOCUS)
    assert found["seen"], found
    return found["part"], found["name"]


def tab_to(page: Page, name: str, key: str = "Tab") -> None:
    for _ in range(60):
        if focus(page)[1] == name:
            return
        page.keyboard.press(key)
    raise AssertionError(f"{name} is not reached")


def answer(page: Page, button: str) -> None:
    """Press a button of the dialog, which is in front by then."""
    page.wait_for_selector(f"#dialog [data-answer='{button}']")
    page.wait_for_function("!!document.activeElement.closest('.v-dialog')")
    seen = []
    while (now := page.evaluate("document.activeElement.dataset.answer ?? ''")) != button:
        page.keyboard.press("Tab")
        seen.append(now)
        assert len(seen) < 8, seen
    page.keyboard.press("Enter")


def command(page: Page, typed: str) -> None:
    page.keyboard.press("Control+k")
    page.wait_for_selector("#commands input:focus")
    page.keyboard.type(typed)
    page.wait_for_selector(f"#found li:first-child:has-text('{typed}')")
    page.keyboard.press("Enter")
    page.wait_for_selector("#commands", state="detached")


def test_one_scene_is_labelled_by_keys_alone(
    serve: Callable[..., Served], tmp_path: Path, page: Page
) -> None:
    source = template(tmp_path / "template")
    truth = Scene.open(source).T_cam_obj(0, 1)
    assert truth is not None
    project, tokens = make_lab(source, tmp_path, {"new": ("", None)})
    server = serve(project.root)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{server.url}/?token={tokens['Ben']}")
    while page.evaluate("document.activeElement.id") != "do-first":
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_url("**/at/edit/new/**")
    opened(page, page.url, measured=False)

    command(page, "Place box")
    page.wait_for_selector("#pose")
    sharp(page)
    # From the views to the panels; the number is typed, and Esc leads back.
    assert focus(page) == ("BODY", "")
    page.keyboard.press("F6")
    assert focus(page)[0] == ".panels"
    for axis, number in enumerate(1000 * truth.t + [2, -1, 3]):
        tab_to(page, str(axis))
        page.keyboard.press("Control+a")
        page.keyboard.type(f"{number:.2f}")
        page.keyboard.press("Tab")
        page.wait_for_function(
            "([axis, x]) => document.querySelector(`[data-position='${axis}'] input`).value == x",
            arg=[axis, f"{number:.2f}"],
        )
    place = focus(page)
    page.keyboard.press("Escape")
    assert focus(page) == ("BODY", "")
    before = position(page)
    page.keyboard.press("ArrowLeft")
    wait_until_at(page, before - [1, 0, 0])

    # A control that has the focus has the arrows: nothing moves.
    at = position(page)
    page.keyboard.press("F6")
    assert focus(page) == place
    tab_to(page, "box", "Shift+Tab")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Escape")
    # Gone through part by part, and never held fast.
    parts = []
    for _ in range(4):
        page.keyboard.press("F6")
        parts.append(focus(page)[0])
    assert parts == [".panels", ".bottom", ".v-app-bar", "BODY"]
    np.testing.assert_allclose(position(page), at)

    page.keyboard.press("r")
    page.wait_for_selector("#objects .state:has-text('refined')")
    wait_for_move(page, at)
    page.keyboard.press("F3")
    page.wait_for_selector("[data-field='note'] textarea:focus")
    page.keyboard.type("by keys")
    answer(page, "keep")
    page.wait_for_selector("#dialog", state="detached")
    page.keyboard.press("d")
    page.wait_for_selector("#objects .state:has-text('done'), #dialog")
    if page.locator("#dialog").count():  # it asks first where the pose is in doubt
        answer(page, "done")
    page.wait_for_selector("#objects .state:has-text('done')")

    shown = position(page)

    # Out by the button of the page: what is not saved is asked about.
    for _ in range(3):
        page.keyboard.press("F6")
    tab_to(page, "close")
    page.keyboard.press("Enter")
    answer(page, "save")
    page.wait_for_url(server.url.rstrip("/") + "/")
    scene = Scene.open(tmp_path / "new")
    (label,) = scene.labels.labels
    assert label.annotator == "Ben"
    (item,) = scene.objects.objects
    assert scene.annotation.of(item.id).note == "by keys"
    np.testing.assert_allclose(1000 * np.reshape(label.T_cam_obj, (4, 4))[:3, 3], shown, atol=0.006)
