"""Tools and panels in a real browser: what they show, and what a person enters there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from pages import looks, opened, picture_number, wait_for_picture
from serving import Served

from annotator.app.action_table import TOOLS
from annotator.app.icons import STROKES

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow


def test_the_tool_bar_has_the_tools_of_the_window_with_the_same_icons(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    tools = page.eval_on_selector_all(".tools [data-tool]", "all => all.map(t => t.dataset.tool)")
    assert tools == [id for group in TOOLS for id in group if id != "open"]
    save = page.locator("[data-tool='save']")
    drawn = page.locator(save.locator("use").get_attribute("href") or "")
    assert drawn.locator("path").get_attribute("d") == STROKES["save"]
    # Every icon of the page is in the set.
    names = page.eval_on_selector_all("use", "all => all.map(u => u.getAttribute('href'))")
    assert all(page.locator(name).count() == 1 for name in set(names))


def test_opacity_is_set_by_its_slider_and_follows_the_keys(served: Served, page: Page) -> None:
    opened(page, served.url)
    page.wait_for_selector("[data-tool='opacity'] .v-slider-thumb[aria-valuenow='55']")
    before, number = looks(page), picture_number(page)
    thumb = page.locator("[data-tool='opacity'] .v-slider-thumb").bounding_box()
    track = page.locator("[data-tool='opacity'] .v-slider-track").bounding_box()
    assert thumb is not None and track is not None
    y = thumb["y"] + thumb["height"] / 2
    page.mouse.move(thumb["x"] + thumb["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(track["x"] + track["width"] + 5, y, steps=4)
    page.mouse.up()
    page.wait_for_selector("[data-tool='opacity'] .v-slider-thumb[aria-valuenow='100']")
    wait_for_picture(page, number)
    assert (np.abs(looks(page) - before).max(axis=2) > 40).mean() > 0.005  # where the box is
    page.keyboard.press("[")
    page.wait_for_selector("[data-tool='opacity'] .v-slider-thumb[aria-valuenow='90']")
