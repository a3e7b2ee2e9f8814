"""The session in a real browser: what a person does with mouse and keys reaches the labels."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from pages import (
    MAIN,
    SIDE,
    centre,
    dismiss_notices,
    escape_dialog,
    looks,
    notice,
    on_screen,
    opened,
    picture_number,
    position,
    scale,
    wait_for_look,
    wait_for_move,
    wait_for_picture,
    wait_until_at,
)
from scene_on_disk import CAMERA
from serving import Served

from annotator.app.action_table import ACTIONS
from std_toolkit.geometry import SE3
from std_toolkit.scene import Scene

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

Serve = Callable[..., Served]


def test_a_drag_moves_the_object_as_far_as_the_mouse_and_undo_takes_it_back(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    before = position(page)
    x, y = centre(page)
    page.mouse.move(x, y)  # on the middle of the handles: the plane through the object's centre
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(x + 5 * step, y + 2 * step)
    page.mouse.up()
    page.wait_for_selector("[data-tool='undo']:not([disabled])")
    pixels_per_mm = CAMERA.fx * scale(page) / before[2]
    moved = np.array([40, 16, 0]) / pixels_per_mm
    wait_until_at(page, before + moved, tolerance=1.2 / pixels_per_mm)  # whole pixels are counted
    after = position(page)
    page.keyboard.press("Control+z")
    np.testing.assert_allclose(wait_for_move(page, after), before, atol=0.005)


def test_the_numbers_follow_the_hand_and_escape_puts_the_object_back(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    before = position(page)
    x, y = centre(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y)
    wait_for_move(page, before)  # the button is still held
    page.wait_for_selector("#hint:has-text('release')")
    page.keyboard.press("Escape")
    wait_until_at(page, before)
    page.mouse.move(x + 60, y)
    page.mouse.up()
    page.wait_for_selector("#hint:not(:has-text('release'))")
    wait_until_at(page, before)


def test_a_drag_goes_on_beyond_the_edge_of_its_view(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    x, y = centre(page)
    box = page.locator(MAIN).bounding_box()
    assert box is not None
    over = box["x"] + box["width"] + 40
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move((x + over) / 2, y)
    page.mouse.move(over, y)
    pixels_per_mm = CAMERA.fx * scale(page) / before[2]
    expected = before + np.array([(over - x) / pixels_per_mm, 0, 0])
    wait_until_at(page, expected, tolerance=1.2 / pixels_per_mm)  # whole pixels are counted
    page.keyboard.press("Escape")
    page.mouse.up()
    wait_until_at(page, before)


def test_keys_move_by_steps(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    page.keyboard.press("8")
    page.keyboard.press("ArrowRight")
    wait_until_at(page, before + np.array([1, 0, 0]))
    page.keyboard.press("9")  # fine steps
    page.keyboard.press("PageUp")
    wait_until_at(page, before + np.array([1, 0, 0.1]))
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    wait_until_at(page, before)
    page.keyboard.press("8")
    page.wait_for_selector("#pose:has-text('move by 1 mm')")


def test_a_key_held_down_repeats_a_step_but_not_a_switch(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    for _ in range(4):
        page.keyboard.down("ArrowLeft")  # again without a release: as a held key repeats
    page.keyboard.up("ArrowLeft")
    wait_until_at(page, before - [4, 0, 0])
    for _ in range(4):
        page.keyboard.down("h")
    page.keyboard.up("h")
    page.locator("[data-menu='View']").click()
    page.wait_for_selector("[data-action='hide'] .on")
    page.locator("[data-action='hide']").click()
    page.wait_for_selector("[data-menu='View'][aria-expanded='false']")
    for _ in range(4):
        page.keyboard.press("Control+z")
    wait_until_at(page, before)


def test_the_mouse_wheel_with_ctrl_moves_along_the_viewing_ray(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    page.mouse.move(*centre(page))
    page.keyboard.down("Control")
    page.mouse.wheel(0, -100)
    page.keyboard.up("Control")
    wait_for_move(page, before)
    sight = before / np.linalg.norm(before)
    wait_until_at(page, before + sight, tolerance=0.02)
    # Further notches would have belonged to the same edit.
    page.wait_for_selector("#hint:not(:has-text('release'))")
    page.keyboard.press("Control+z")
    wait_until_at(page, before)


def test_pinching_a_touch_pad_zooms_instead_of_moving_the_object(
    served: Served, page: Page
) -> None:
    """It comes as a wheel with Ctrl, in small turns, while nobody holds the key."""
    opened(page, served.url)
    before, number = position(page), picture_number(page)
    x, y = centre(page)
    for _ in range(12):
        page.dispatch_event(
            MAIN, "wheel", {"deltaY": -10, "ctrlKey": True, "clientX": x, "clientY": y}
        )
    wait_for_picture(page, number)
    page.keyboard.press("Home")
    np.testing.assert_allclose(position(page), before)


def test_typed_numbers_set_the_pose_and_nonsense_is_told(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    field = page.locator("[data-position='2'] input")
    field.fill("700,5")
    field.press("Enter")
    wait_until_at(page, np.array([*before[:2], 700.5]))
    for nonsense in ("far", "nan", ""):
        field.fill(nonsense)
        field.press("Tab")
        notice(page, "not a number")
        wait_until_at(page, np.array([*before[:2], 700.5]))
    dismiss_notices(page)
    page.keyboard.press("Control+z")
    wait_until_at(page, before)


def test_tab_switches_to_the_cloud_and_back(served: Served, page: Page) -> None:
    opened(page, served.url)
    image = looks(page)
    page.keyboard.press("Tab")
    wait_for_look(page, image)
    cloud = looks(page)
    page.keyboard.press("Tab")
    wait_for_look(page, cloud)


def test_side_views_follow_edits_and_a_double_click_takes_their_frame(
    serve: Serve, page: Page
) -> None:
    opened(page, serve().url)  # the active view, whose camera the numbers refer to, changes
    before, side = position(page), picture_number(page, SIDE)
    page.keyboard.press("ArrowRight")
    wait_for_picture(page, side, SIDE)
    page.keyboard.press("Control+z")
    wait_until_at(page, before)
    frame = page.locator("#frame").inner_text()
    page.locator(SIDE).dblclick(position={"x": 4, "y": 4})
    page.wait_for_function("(old) => document.querySelector('#frame').innerText !== old", arg=frame)
    page.keyboard.press("Control+1")
    page.wait_for_function("(old) => document.querySelector('#frame').innerText === old", arg=frame)


def test_the_frame_slider_shows_frames_while_it_is_dragged(served: Served, page: Page) -> None:
    opened(page, served.url)
    page.wait_for_selector("#frame:has-text('1 of 3')")
    thumb = page.locator(".bottom .v-slider-thumb").bounding_box()
    track = page.locator(".bottom .v-slider-track").bounding_box()
    assert thumb is not None and track is not None
    y = thumb["y"] + thumb["height"] / 2
    page.mouse.move(thumb["x"] + thumb["width"] / 2, y)
    page.mouse.down()
    page.mouse.move(track["x"] + track["width"] / 2, y, steps=4)
    page.wait_for_selector("#frame:has-text('2 of 3')")
    page.mouse.move(track["x"] + track["width"], y, steps=4)
    page.wait_for_selector("#frame:has-text('3 of 3')")
    page.mouse.up()
    page.keyboard.press("Control+Home")
    page.wait_for_selector("#frame:has-text('1 of 3')")


def test_points_are_clicked_on_the_mesh_and_in_the_image(served: Served, page: Page) -> None:
    opened(page, served.url)
    page.keyboard.press("c")
    page.wait_for_selector("[data-view='3'] annotator-view[data-shown]")
    page.wait_for_selector("#hint:has-text('click a point on the mesh')")
    looked = looks(page, "[data-view='3'] annotator-view")
    assert looked.std() > 20  # the mesh before its background
    page.locator("[data-view='3'] annotator-view").click()  # its middle shows the box
    page.wait_for_selector("#hint:has-text('Now click the same point')")
    page.mouse.click(*on_screen(page, position(page)))
    page.wait_for_selector("#points td:has-text('px')")
    page.locator("#points button[title='Remove this point']").click()
    page.wait_for_selector("#points td", state="detached")
    page.keyboard.press("c")
    page.wait_for_selector("#points", state="detached")


def test_every_key_stands_on_the_sheet_and_every_action_in_a_menu(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    page.keyboard.press("F1")
    text = page.locator("#dialog .sheet").inner_text()
    missing = {a.title for a in ACTIONS if a.keys and a.title not in text}
    assert missing == {"Open scene...", "Close"}  # a page is one scene, and has no end
    escape_dialog(page)
    page.locator("[data-menu='Align']").click()
    shown = page.locator(".v-menu")
    for action in ACTIONS:
        if action.menu == "Align":  # the menu opens after the click has returned
            shown.get_by_text(action.title, exact=True).first.wait_for()


def test_saving_writes_the_labels_and_ctrl_c_ends_the_server(serve: Serve, page: Page) -> None:
    served = serve()
    opened(page, served.url)
    before = position(page)
    page.keyboard.press("ArrowRight")
    after = wait_for_move(page, before)
    page.keyboard.press("Control+s")
    notice(page, "aved")
    label = Scene.open(served.scene).labels.of(1)
    assert label is not None
    np.testing.assert_allclose(1000 * SE3.from_matrix(label.T_cam_obj).t, after, atol=0.006)
    assert served.stop() == 130


def test_edits_survive_a_killed_server_and_are_offered_again(serve: Serve, page: Page) -> None:
    served = serve()
    opened(page, served.url)
    before = position(page)
    page.keyboard.press("ArrowLeft")
    after = wait_for_move(page, before)
    served.stop(signal.SIGKILL)
    page.wait_for_selector("#lost:has-text('No edit is lost')")
    # The page comes back by itself once the server does.
    serve(served.scene, "--web", str(served.port))
    page.wait_for_selector("#dialog:has-text('not saved')")
    np.testing.assert_allclose(position(page), before, atol=0.005)
    page.keyboard.press("Escape")  # this one must be decided
    page.locator("[data-answer='recover']").click()
    np.testing.assert_allclose(wait_for_move(page, before), after, atol=0.005)
