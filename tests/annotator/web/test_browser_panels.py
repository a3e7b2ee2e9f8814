"""Tools and panels in a real browser: what they show, and what a person enters there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from pages import (
    looks,
    notice,
    opened,
    picture_number,
    position,
    sharp,
    wait_for_move,
    wait_for_picture,
    wait_until_at,
)
from scene_on_disk import write_scene
from serving import Served

from annotator.app.action_table import TOOLS
from annotator.app.icons import STROKES
from annotator.app.pose_text import parse_matrix
from std_toolkit.geometry import SE3, so3_exp

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

QUARTER = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])


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


def rotation(page: Page, form: str) -> np.ndarray:
    """The numbers of the rotation in one of its forms."""
    labels = {"euler": "Euler", "vector": "rotation vector", "quaternion": "quaternion"}
    page.locator("[data-pick='form']").select_option(form)
    page.wait_for_selector(f"#pose[data-form='{form}']")
    assert labels[form] in page.locator(f"[data-pick='form'] [value='{form}']").inner_text()
    values = page.eval_on_selector_all("[data-rotation] input", "all => all.map(i => i.value)")
    return np.array(" ".join(values).split(), dtype=float)


def shown_pose(page: Page) -> SE3:
    """The pose as the page would copy it."""
    return parse_matrix(page.locator("[data-tool='copy']").get_attribute("data-copy") or "")


def test_the_rotation_is_shown_and_typed_as_angles_vector_and_quaternion(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    R = shown_pose(page).R
    x, y, z = np.radians(rotation(page, "euler"))
    euler = so3_exp([0, 0, z]) @ so3_exp([0, y, 0]) @ so3_exp([x, 0, 0])
    np.testing.assert_allclose(euler, R, atol=2e-5)
    vector = np.radians(rotation(page, "vector"))
    np.testing.assert_allclose(so3_exp(vector), R, atol=2e-5)
    quaternion = SE3.from_quat(rotation(page, "quaternion"), np.zeros(3))
    np.testing.assert_allclose(quaternion.R, R, atol=2e-5)
    field = page.locator("[data-rotation='quaternion'] input")
    field.fill("0.70711 0 0 0.70711")
    field.press("Enter")
    page.wait_for_selector("[data-tool='undo']:not([disabled])")
    np.testing.assert_allclose(shown_pose(page).R, QUARTER, atol=1e-9)
    field.fill("2 0 0 0")
    field.press("Enter")
    notice(page, "must have length 1")
    np.testing.assert_allclose(shown_pose(page).R, QUARTER, atol=1e-9)
    np.testing.assert_allclose(rotation(page, "euler"), [0, 0, 90], atol=0.001)
    page.keyboard.press("Control+z")


def test_a_pose_is_copied_and_pasted_as_a_matrix(served: Served, page: Page) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    opened(page, served.url)
    before = position(page)
    page.locator("[data-tool='copy']").click()
    notice(page, "Copied the 4x4 matrix, mesh to camera of frame 0")
    copied = page.evaluate("navigator.clipboard.readText()")
    np.testing.assert_allclose(1000 * parse_matrix(copied).t, before, atol=0.006)
    page.keyboard.press("ArrowRight")
    wait_for_move(page, before)
    page.locator("[data-tool='paste']").click()
    page.locator("[data-field='matrix'] textarea").first.fill(copied)
    page.locator("[data-answer='set']").click()
    wait_until_at(page, before)
    page.wait_for_selector("#provenance:has-text('pasted')")
    page.locator("[data-tool='paste']").click()
    page.locator("[data-field='matrix'] textarea").first.fill("1 2 3")
    page.locator("[data-answer='set']").click()
    notice(page, "needs 16 numbers")
    wait_until_at(page, before)


def test_numbers_can_be_those_of_the_world(served: Served, page: Page) -> None:
    opened(page, served.url)
    page.keyboard.press("Control+ArrowRight")
    page.wait_for_selector("#frame:has-text('2 of 3')")
    page.wait_for_selector("#pose option:has-text('camera of frame 1')", state="attached")
    in_camera = position(page)
    page.locator("[data-pick='frame']").select_option("world")
    in_world = wait_for_move(page, in_camera)
    field = page.locator("[data-position='2'] input")
    higher = in_world + np.array([0, 0, 10])
    field.fill(f"{higher[2]:.2f}")
    field.press("Enter")
    wait_until_at(page, higher, tolerance=0.02)
    page.locator("[data-pick='frame']").select_option("camera")
    moved = wait_for_move(page, higher)
    assert np.linalg.norm(moved - in_camera) == pytest.approx(10, abs=0.05)
    page.keyboard.press("Control+z")
    wait_until_at(page, in_camera)


def test_the_verdict_follows_the_measurement(served: Served, page: Page) -> None:
    opened(page, served.url)
    before = position(page)
    page.wait_for_selector("#verdict:has-text('too few frames')")
    assert page.locator("#card .word").inner_text() == "unknown"
    assert page.locator("[data-evidence='contour']").count() == 1
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("#verdict:has-text('Not judged yet')")
    page.wait_for_selector("#verdict:has-text('too few frames')")  # measured by itself
    page.keyboard.press("Control+z")
    wait_until_at(page, before)


def test_the_slider_marks_camera_poses_side_views_and_placed_objects(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    page.wait_for_selector("#frame:has-text('1 of 3')")
    left = "all => all.map(m => m.style.left)"
    assert page.eval_on_selector_all(".marks .side-mark", left) == ["50%", "100%"]
    assert "0%" in page.eval_on_selector_all(".marks .placed-mark", left)
    assert page.eval_on_selector_all(".marks .run", "all => all.map(m => m.style.right)") == ["0%"]
    # A mark is where the thumb is at that frame.
    page.keyboard.press("Control+ArrowRight")
    page.wait_for_selector("#frame:has-text('2 of 3')")
    page.wait_for_timeout(300)  # the thumb slides there
    mark = page.locator(".marks .side-mark").first.bounding_box()
    thumb = page.locator(".bottom .v-slider-thumb").bounding_box()
    assert mark is not None and thumb is not None
    middle = [box["x"] + box["width"] / 2 for box in (mark, thumb)]
    assert middle[0] == pytest.approx(middle[1], abs=1.5)
    page.keyboard.press("Control+Home")


def test_the_style_is_chosen_by_tool_and_key_and_the_picture_follows(
    serve: Callable[..., Served], page: Page, tmp_path: Path
) -> None:
    """A mesh with colours is drawn with them from the beginning."""
    write_scene(tmp_path / "scene")
    mesh = trimesh.creation.box((0.06, 0.04, 0.1)).subdivide().subdivide()
    upper = np.asarray(mesh.vertices)[:, 1] > 0
    mesh.visual.vertex_colors = np.where(upper[:, None], (220, 30, 30), (30, 190, 40))
    mesh.export(tmp_path / "scene/models/box/box.ply")

    opened(page, serve(tmp_path / "scene").url)
    page.wait_for_selector("[data-tool='style_textured'].on")

    def change() -> float:
        return float((np.abs(looks(page) - solid).max(axis=2) > 30).mean())

    number = picture_number(page)
    page.keyboard.press("1")
    page.wait_for_selector("[data-tool='style_solid'].on")
    wait_for_picture(page, number)
    solid, number = looks(page), picture_number(page)
    page.keyboard.press("4")
    page.wait_for_selector("[data-tool='style_textured'].on")
    while change() < 0.004:  # the colours may still be read
        wait_for_picture(page, number)
        number = picture_number(page)
    page.locator("[data-tool='style_solid']").click()
    page.wait_for_selector("[data-tool='style_solid'].on")


def test_one_key_shows_the_view_in_hand_alone(served: Served, page: Page) -> None:
    opened(page, served.url)
    small = page.locator("[data-view='0']").bounding_box()
    all_views = page.locator(".views").bounding_box()
    assert small is not None and all_views is not None
    page.keyboard.press("f")
    page.wait_for_selector(".views.maximised")
    sharp(page)
    large = page.locator("[data-view='0']").bounding_box()
    assert large is not None and large["width"] > all_views["width"] - 10 > small["width"]
    page.keyboard.press("f")
    page.wait_for_selector(".views:not(.maximised)")
    sharp(page)
    assert page.locator("[data-view='0']").bounding_box() == small
