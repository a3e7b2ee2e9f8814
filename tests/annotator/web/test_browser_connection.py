"""Several pages of one session, pages that go away, and screens of any size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from pages import (
    MAIN,
    PATIENCE_MS,
    SIDE,
    centre,
    opened,
    picture_number,
    position,
    sharp,
    wait_for_move,
    wait_for_picture,
    wait_until_at,
)
from serving import Served

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.slow


def grab(page: Page) -> None:
    """Press on the object and move it, without letting go."""
    x, y = centre(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y)


def test_a_second_page_follows_the_first_and_the_first_the_second(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    other = page.context.new_page()
    other.set_viewport_size({"width": 900, "height": 700})
    opened(other, served.url)
    before, number = position(page), picture_number(page)
    other.keyboard.press("ArrowRight")
    after = wait_for_move(page, before)
    wait_for_picture(page, number)
    number = picture_number(other)
    page.keyboard.press("Control+z")
    wait_until_at(other, before)
    wait_for_picture(other, number)
    np.testing.assert_allclose(after - before, [1, 0, 0], atol=0.011)
    sharp(page)  # it has the picture in its own size, now that it was used last


def test_a_page_closed_in_the_middle_of_a_drag_lets_go(served: Served, page: Page) -> None:
    opened(page, served.url)
    other = page.context.new_page()
    opened(other, served.url)
    before = position(page)
    grab(other)
    wait_for_move(page, before)
    other.close()
    wait_until_at(page, before)
    grab(page)
    after = wait_for_move(page, before)
    assert after[0] > before[0]
    page.keyboard.press("Escape")
    page.mouse.up()
    wait_until_at(page, before)


def test_a_drag_that_the_browser_takes_away_is_given_up(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    grab(page)
    wait_for_move(page, before)
    page.eval_on_selector(MAIN, "view => view.cancelled({ pointerId: view.held.pointer })")
    wait_until_at(page, before)
    page.mouse.up()


def test_on_a_line_that_answers_nothing_moves_do_not_pile_up(served: Served, page: Page) -> None:
    sent: list[str] = []

    def slow(line: object) -> None:
        server = line.connect_to_server()  # type: ignore[attr-defined]

        def out(message: str | bytes) -> None:
            if '"kind":"move"' in str(message):
                sent.append(str(message))
            server.send(message)

        line.on_message(out)  # type: ignore[attr-defined]
        server.on_message(
            lambda message: None if "moved" in str(message)[:20] else line.send(message)  # type: ignore[attr-defined]
        )

    page.route_web_socket("**/views", slow)
    opened(page, served.url)
    box = page.locator(MAIN).bounding_box()
    assert box is not None
    sent.clear()
    for i in range(40):
        page.mouse.move(box["x"] + 5 + 3 * i, box["y"] + 5)
    number = picture_number(page)
    page.keyboard.press("Home")  # comes after all moves that were sent
    wait_for_picture(page, number)
    # Two may be on their way; the last one goes before the key.
    assert 1 <= len(sent) <= 3


def test_pictures_follow_the_size_of_the_window(served: Served, page: Page) -> None:
    opened(page, served.url)
    for width, height in ((1500, 900), (820, 560)):
        page.set_viewport_size({"width": width, "height": height})
        sharp(page)
        sharp(page, SIDE)


def test_pictures_are_sharp_where_a_pixel_is_several_of_the_screen(
    served: Served, browser: Browser
) -> None:
    context = browser.new_context(viewport={"width": 1000, "height": 640}, device_scale_factor=2)
    try:
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        opened(page, served.url)
        width = page.eval_on_selector(MAIN + " canvas", "canvas => canvas.width")
        assert width == pytest.approx(2 * page.eval_on_selector(MAIN, "v => v.clientWidth"), abs=2)
        before = position(page)
        grab(page)
        moved = wait_for_move(page, before) - before
        assert moved[0] > 5  # what is under the pointer stays under it
        page.keyboard.press("Escape")
        page.mouse.up()
        wait_until_at(page, before)
    finally:
        context.close()


def test_the_page_asks_nobody_but_its_server_and_has_nothing_to_complain_about(
    served: Served, page: Page
) -> None:
    asked: list[str] = []
    complaints: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("websocket", lambda line: asked.append(line.url))
    page.on("console", lambda m: m.type in ("error", "warning") and complaints.append(m.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    # A link could name another web socket, which then would command the page.
    opened(page, served.url + "/?sessionURL=ws://elsewhere.example/ws&ui=other")
    page.wait_for_selector("#library img")
    own = (served.url, served.url.replace("http", "ws"), "data:", "blob:")
    assert len(asked) > 8 and all(url.startswith(own) for url in asked), asked
    assert sum(url.endswith(("/ws", "/views")) for url in asked) == 2
    assert complaints == []
    assert "secret" not in page.url and "elsewhere" not in page.url
