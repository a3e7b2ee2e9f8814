"""The lock of an object in a real browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from pages import notice, opened, position, wait_for_move
from serving import Served

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow


def test_a_page_locks_shows_it_and_refuses_a_step(serve: Callable[..., Served], page: Page) -> None:
    opened(page, serve().url)
    padlock = page.locator("#objects [aria-label='locked']")
    assert padlock.count() == 0
    before = position(page)
    page.keyboard.press("l")
    padlock.wait_for()
    page.keyboard.press("ArrowRight")
    notice(page, "box_1 is locked")
    assert np.array_equal(position(page), before)
    page.keyboard.press("l")
    padlock.wait_for(state="detached")
    page.keyboard.press("ArrowRight")
    wait_for_move(page, before)
