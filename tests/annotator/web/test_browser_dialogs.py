"""Library and dialogs in a real browser: what is asked, dropped and told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from pages import (
    MAIN,
    escape_dialog,
    notice,
    opened,
    position,
    scale,
    wait_for_move,
    wait_until_at,
)
from scene_on_disk import CAMERA, write_scene
from serving import Served

from std_toolkit.scene import Scene

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = pytest.mark.slow

Serve = Callable[..., Served]


def answer(page: Page, button: str) -> None:
    page.locator(f"[data-answer='{button}']").click()


def test_a_mesh_dragged_from_the_library_lands_under_the_pointer(
    served: Served, page: Page
) -> None:
    opened(page, served.url)
    page.wait_for_selector("#library img")  # its thumbnail
    box = page.locator(MAIN).bounding_box()
    assert box is not None
    count = page.locator("#objects [data-object]").count()
    spot = (box["width"] * 0.4, box["height"] * 0.45)
    page.drag_and_drop(
        "#library [data-name='box']", MAIN, target_position={"x": spot[0], "y": spot[1]}
    )
    page.wait_for_function(
        "(count) => document.querySelectorAll('#objects [data-object]').length === count",
        arg=count + 1,
    )
    page.wait_for_selector("#objects .v-list-item--active:has-text('box')")
    page.wait_for_selector("#pose")
    per_pixel = scale(page)
    u = (spot[0] - box["width"] / 2) / per_pixel + (CAMERA.width - 1) / 2
    v = (spot[1] - box["height"] / 2) / per_pixel + (CAMERA.height - 1) / 2
    at = position(page)
    # Its centre, or where it stands, is there: no farther than half its diagonal.
    off = np.linalg.norm(CAMERA.project(at / 1000) - [u, v])
    assert off < CAMERA.fx * 62 / at[2]
    page.keyboard.press("Control+z")
    page.wait_for_function(
        "(count) => document.querySelectorAll('#objects [data-object]').length === count",
        arg=count,
    )


def test_a_mesh_in_millimetres_is_asked_about_and_a_missing_one_is_told(
    served: Served, page: Page, tmp_path: Path
) -> None:
    trimesh.creation.cylinder(20, 90).export(tmp_path / "can.stl")
    opened(page, served.url, measured=False)
    page.keyboard.press("Control+m")
    page.locator("[data-field='path'] input").fill(str(tmp_path / "nothing.stl"))
    answer(page, "add")
    notice(page, "nothing.stl")
    page.keyboard.press("Control+m")
    page.locator("[data-field='path'] input").fill(str(tmp_path / "can.stl"))
    page.keyboard.press("Enter")
    page.wait_for_selector("#dialog:has-text('40 × 40 × 90 mm')")
    answer(page, "mm")
    page.wait_for_selector("#library [data-name='can']:has-text('40 × 40 × 90 mm')")
    notice(page, "Added")
    # The news did not push the error away.
    assert page.locator(".notice.error:has-text('nothing.stl')").count() == 1
    page.locator(".notice.error button").click()
    page.wait_for_selector(".notice.error", state="detached")


def test_meshes_of_a_folder_are_listed_and_copied_when_placed(
    serve: Serve, page: Page, tmp_path: Path
) -> None:
    for name in ("006_mustard_bottle", "003_cracker_box"):
        (tmp_path / "meshes" / name).mkdir(parents=True)
        trimesh.creation.box((0.06, 0.04, 0.1)).export(tmp_path / "meshes" / name / "textured.obj")
    served = serve(None, "--meshes", str(tmp_path / "meshes"))
    opened(page, served.url, measured=False)
    row = "#library [data-name='006_mustard_bottle']"
    page.wait_for_selector(f"{row}:has-text('not in the scene yet')")
    page.wait_for_selector(f"{row} img")  # its thumbnail
    assert not (served.scene / "models" / "006_mustard_bottle").exists()
    page.locator("[data-add='006_mustard_bottle']").click()
    page.wait_for_selector("#objects .v-list-item--active:has-text('006_mustard_bottle')")
    page.wait_for_selector(f"{row}:has-text('60 × 40 × 100 mm')")
    assert (served.scene / "models" / "006_mustard_bottle" / "textured.obj").is_file()
    # The name of a folder in the dialog replaces it.
    (tmp_path / "others").mkdir()
    trimesh.creation.box((0.06, 0.04, 0.1)).export(tmp_path / "others" / "brick.ply")
    page.keyboard.press("Control+m")
    page.locator("[data-field='path'] input").fill(str(tmp_path / "others"))
    answer(page, "add")
    page.wait_for_selector("#library [data-name='brick']")
    assert page.locator("#library [data-name='003_cracker_box']").count() == 0


def test_name_note_and_symmetry_are_asked_for(served: Served, page: Page) -> None:
    opened(page, served.url, measured=False)
    page.locator("#objects [data-object]").first.click()
    page.keyboard.press("F2")
    page.locator("[data-field='name'] input").fill("carton")
    answer(page, "rename")
    page.wait_for_selector("#objects [data-object='carton']")
    page.keyboard.press("F3")
    page.locator("[data-field='note'] textarea").first.fill("left edge")
    answer(page, "keep")
    page.wait_for_selector("#dialog", state="detached")
    page.keyboard.press("F4")
    page.locator("[data-field='symmetry']").select_option(label="Equal turns about z")
    page.locator("[data-field='count'] input").fill("4")
    answer(page, "set")
    page.wait_for_selector("#dialog", state="detached")
    page.keyboard.press("F4")
    page.wait_for_selector("#dialog:has-text('As it is: 3 turns')")
    escape_dialog(page)


def test_others_changes_are_asked_about_and_labels_are_carried_to_all_frames(
    serve: Serve, page: Page
) -> None:
    served = serve()
    opened(page, served.url)
    before = position(page)
    page.keyboard.press("ArrowRight")
    mine = wait_for_move(page, before)
    scene = Scene.open(served.scene)
    labels = scene.labels
    for label in labels.labels:
        label.T_cam_obj[3] += 0.02
        if label.T_world_obj is not None:
            label.T_world_obj[3] += 0.02
    scene.save_labels(labels)
    page.keyboard.press("Control+p")
    answer(page, "go")
    page.wait_for_selector("#dialog:has-text('Others changed')")
    answer(page, "mine")
    notice(page, "aved")
    wait_until_at(page, mine)
    page.keyboard.press("Control+p")
    answer(page, "go")
    notice(page, "Carried to 3 frames")


def test_a_scene_for_looking_only(serve: Serve, page: Page, tmp_path: Path) -> None:
    write_scene(tmp_path / "scene")
    (tmp_path / "scene/color/000001.png").unlink()
    served = serve(tmp_path / "scene", "--read-only")
    opened(page, served.url, measured=False)  # the notice goes away
    notice(page, "read-only")
    before = position(page)
    assert page.locator("[data-position='0'] input").is_disabled()
    assert page.locator("[data-tool='save']").is_disabled()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Control+ArrowRight")  # to the frame whose image is missing
    page.wait_for_selector("#frame:has-text('2 of 3')")
    page.keyboard.press("Control+ArrowLeft")
    page.wait_for_selector("#frame:has-text('1 of 3')")
    wait_until_at(page, before)


def test_a_scene_without_depth_and_camera_poses(serve: Serve, page: Page, tmp_path: Path) -> None:
    root = tmp_path / "scene"
    write_scene(root, labelled=False)
    for path in (root / "depth").iterdir():
        path.unlink()
    served = serve(root)
    opened(page, served.url, measured=False)
    page.locator("[data-add='box']").click()
    page.wait_for_selector("#pose")
    before = position(page)
    page.keyboard.press("ArrowRight")
    wait_for_move(page, before)
    page.locator("[data-menu='File']").click()
    page.wait_for_selector("[data-action='propagate'].v-list-item--disabled")
    page.keyboard.press("Escape")
