"""What the tests of the browser do and read in a page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
from scene_on_disk import CAMERA

if TYPE_CHECKING:
    from playwright.sync_api import Page

MAIN = "[data-view='0'] annotator-view"
SIDE = "[data-view='1'] annotator-view"
PATIENCE_MS = 60_000
_SHARP = """(view) => {
    const shown = document.querySelector(view), canvas = shown?.querySelector('canvas');
    return shown?.dataset.shown && canvas.width > 100
        && Math.abs(canvas.width - shown.clientWidth * devicePixelRatio) < 2
        && Math.abs(canvas.height - shown.clientHeight * devicePixelRatio) < 2;
}"""


def opened(page: Page, url: str, *, measured: bool = True) -> Page:
    """The page at the first frame, its pictures shown and, if it has residuals, its object in them.

    Tests share a session, and the one before may have left it at another frame.
    """
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url)
    page.wait_for_selector("#frame")
    if not page.locator("#frame:has-text('1 of ')").count():
        page.keyboard.press("Control+Home")
        page.wait_for_selector("#frame:has-text('1 of ')")
    # Measured after the mesh is read; before, a press would take the image by its background.
    if measured:
        page.wait_for_selector("#residuals tbody tr")
    return sharp(page)


def sharp(page: Page, view: str = MAIN) -> Page:
    """Wait until a view shows a picture of as many pixels as the screen has there."""
    page.wait_for_function(_SHARP, arg=view)
    page.wait_for_selector("[data-position='2'] input, #objects")
    return page


def position(page: Page) -> np.ndarray:
    """(3,) position of the selected object as the page shows it, mm."""
    values = page.eval_on_selector_all("[data-position] input", "all => all.map(i => +i.value)")
    return np.array(values)


def wait_for_move(page: Page, before: np.ndarray) -> np.ndarray:
    page.wait_for_function(
        "(old) => [0, 1, 2].some(i => Math.abs("
        "document.querySelector(`[data-position='${i}'] input`).value - old[i]) > 0.004)",
        arg=before.tolist(),
    )
    return position(page)


def wait_until_at(page: Page, place: np.ndarray, tolerance: float = 0.011) -> None:
    page.wait_for_function(
        "([place, near]) => [0, 1, 2].every(i => Math.abs("
        "document.querySelector(`[data-position='${i}'] input`).value - place[i]) < near)",
        arg=[place.tolist(), tolerance],
    )


def scale(page: Page, view: str = MAIN) -> float:
    """Pixels of the screen (CSS) for one of the image: it fills the view in one direction."""
    box = page.locator(view).bounding_box()
    assert box is not None
    return min(box["width"] / CAMERA.width, box["height"] / CAMERA.height)


def on_screen(page: Page, point_mm: np.ndarray, view: str = MAIN) -> tuple[float, float]:
    """Where the main view shows a point of its camera's coordinates."""
    box = page.locator(view).bounding_box()
    assert box is not None
    u, v = CAMERA.project(point_mm / 1000)
    return (
        box["x"] + box["width"] / 2 + scale(page, view) * (u - (CAMERA.width - 1) / 2),
        box["y"] + box["height"] / 2 + scale(page, view) * (v - (CAMERA.height - 1) / 2),
    )


def centre(page: Page) -> tuple[float, float]:
    """Where the main view shows the object's centre."""
    return on_screen(page, position(page))


def picture_number(page: Page, view: str = MAIN) -> int:
    return int(page.locator(view).get_attribute("data-shown") or 0)


def wait_for_picture(page: Page, after: int, view: str = MAIN) -> None:
    """Wait for a newer picture of a view."""
    page.wait_for_function(
        "([view, old]) => +document.querySelector(view).dataset.shown > old", arg=[view, after]
    )


def looks(page: Page, view: str = MAIN) -> np.ndarray:
    """(H, W, 3) of the picture that a view shows, int."""
    png = page.locator(view).screenshot()
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)


def wait_for_look(page: Page, old: np.ndarray, view: str = MAIN, difference: float = 10) -> None:
    """Wait until a view looks different, by so many grey levels in the mean."""
    number = picture_number(page, view)
    while np.abs(looks(page, view) - old).mean() <= difference:
        # Newer ones come by themselves as long as it settles.
        wait_for_picture(page, number, view)
        number = picture_number(page, view)


def notice(page: Page, text: str) -> None:
    """Wait for a message."""
    page.wait_for_selector(f".notice:has-text('{text}')")


def dismiss_notices(page: Page) -> None:
    """Close all messages; one may go by itself while it is reached for."""
    page.wait_for_function(
        """() => {
            document.querySelectorAll('.notice button').forEach((button) => button.click());
            return !document.querySelector('.notice');
        }"""
    )


def escape_dialog(page: Page) -> None:
    """Close a dialog by its key, which it hears only once it has come to the front."""
    while page.locator("#dialog").count():
        page.keyboard.press("Escape")
        page.wait_for_timeout(200)
