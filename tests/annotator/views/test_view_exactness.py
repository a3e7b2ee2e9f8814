"""What is drawn lies where the camera sees it, to a twentieth of a pixel."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from views_desk import CAMERA, LENS, Desk, meshes

from annotator.app.view_options import Gizmo, Mode, Style
from annotator.session import ClearPose
from annotator.views.projection import ImageWindow
from std_toolkit.rendering.mesh import prepare_mesh
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.rendering.renderer import Window

TOLERANCE_PX = 0.05


def only(desk: Desk, name: str) -> None:
    """Draw nothing but one object, opaque, without name and handles."""
    for thing in desk.session.state.objects:
        if thing.name != name:
            desk.session.apply(ClearPose(object=thing.name, frame=0))
    desk.controller.select(None)
    desk.controller.set_options(opacity=1.0)
    desk.settle()


def silhouette(desk: Desk, name: str, scale: float, x: float, y: float) -> NDArray[np.bool_]:
    """Pixels of the drawing area whose centre the object covers, by rays (std_toolkit)."""
    width, height = desk.main.size
    camera = CAMERA.resized(round(CAMERA.width * scale), round(CAMERA.height * scale))
    assert camera.fx / CAMERA.fx == pytest.approx(scale)
    # The screen position x of the image's corner is where the column -x of the large image is.
    window = Window(round(-x), round(-y), width, height)
    mesh = prepare_mesh(meshes()[desk.session.object(name).model])
    raster = RaycastRenderer().draw(camera, mesh, desk.pose(name), window=window)
    return raster.depth > 0


def drawn(desk: Desk) -> NDArray[np.bool_]:
    """Pixels that an object has coloured; what is grey is the image."""
    picture = desk.main.screenshot().astype(int)
    colored: NDArray[np.bool_] = np.ptp(picture, axis=2) > 12
    return colored


def farthest_disagreement(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Largest distance of a pixel in which two masks differ from the edge of the second, pixels."""
    inside, outside = distance_transform_edt(b), distance_transform_edt(~b)
    differ = a != b
    return float((inside + outside)[differ].max(initial=0.0))


@pytest.mark.parametrize("name", ["ring_1", "box_1"])
def test_a_solid_covers_the_pixels_that_rays_hit(open_desk: Callable[..., Desk], name: str) -> None:
    desk = open_desk(sizes=((CAMERA.width, CAMERA.height),))
    only(desk, name)
    seen = drawn(desk)
    expected = silhouette(desk, name, 1.0, 0, 0)
    seen[:40] = expected[:40]  # where the captions are
    assert expected.sum() > 400
    # At one pixel per pixel, only centres that the edge runs through may go either way.
    assert (seen != expected).sum() <= 4
    assert farthest_disagreement(seen, expected) <= 1.0


@pytest.mark.parametrize("name", ["ring_1", "box_1"])
def test_edges_are_exact_when_zoomed(open_desk: Callable[..., Desk], name: str) -> None:
    desk = open_desk(sizes=((500, 400),))
    only(desk, name)
    scale = 40.0
    # A part of the object's edge: right of its middle.
    pose, shape = desk.pose(name), meshes()[desk.session.object(name).model]
    seen = CAMERA.project(pose @ np.asarray(shape.vertices))
    u, v = seen[np.argmax(seen[:, 0])]
    x, y = round(250 - scale * (u + 0.5)), round(200 - scale * (v + 0.5))
    desk.main.eye.window = ImageWindow(scale, float(x), float(y))
    picture = drawn(desk)
    expected = silhouette(desk, name, scale, x, y)
    picture[:45] = expected[:45]
    assert 0.05 < expected.mean() < 0.95
    assert farthest_disagreement(picture, expected) <= max(1.0, TOLERANCE_PX * scale)


def test_the_image_lies_under_its_own_pixels(open_desk: Callable[..., Desk]) -> None:
    desk = open_desk({"objects": False}, sizes=((400, 300),))
    path = desk.session.scene.color_path(desk.session.scene.frame(0))
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    cv2.imwrite(str(path), image[..., ::-1])
    desk.controller.images.clear()
    scale = 20.0
    desk.main.eye.window = ImageWindow(scale, -scale * 150, -scale * 100)
    picture = desk.main.screenshot()
    # The middle of each square, and both sides of its borders: pixels are squares, not blurred.
    for row in range(2, 8):  # above the hint
        for column in range(2, 18):
            square = picture[row * 20 + 1 : row * 20 + 19, column * 20 + 1 : column * 20 + 19]
            assert (square == image[100 + row, 150 + column]).all()


def test_a_whole_image_is_shown_without_a_shift(open_desk: Callable[..., Desk]) -> None:
    desk = open_desk({"objects": False}, sizes=((CAMERA.width, CAMERA.height),))
    image = desk.controller.images.image(0).rgb
    picture = desk.main.screenshot()
    assert (picture[200:, :] == image[200:, :]).all()


@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["pinhole", "lens"])
def test_screen_and_recorded_pixel_are_inverse(
    open_desk: Callable[..., Desk], camera: object
) -> None:
    desk = open_desk({"camera": camera})
    desk.main.eye.zoom(7.3, (200.0, 100.0), desk.main.camera, desk.main.size)
    rng = np.random.default_rng(0)
    for uv in rng.uniform([20, 20], [300, 220], (20, 2)):
        at = desk.main.screen_of_recorded(uv[None])[0]
        assert desk.main.recorded_pixel(at) == pytest.approx(tuple(uv), abs=1e-6)


def test_with_a_lens_meshes_are_drawn_where_the_straightened_image_shows_them(
    open_desk: Callable[..., Desk],
) -> None:
    desk = open_desk({"camera": LENS})
    point = desk.pose("ring_1") @ np.array([0.06, 0.0, 0.0])
    recorded = LENS.project(point)
    at = desk.main.screen.project(point)
    assert desk.main.recorded_pixel(at) == pytest.approx(tuple(recorded), abs=1e-6)


def test_image_and_cloud_show_an_object_in_the_same_place(desk: Desk) -> None:
    desk.main.eye.zoom(2.5, (300.0, 200.0), desk.main.camera, desk.main.size)
    pose = desk.main.T_eye_obj("ring_1")
    assert pose is not None
    before = desk.main.screen.project(pose.t)
    desk.controller.set_mode(Mode.CLOUD)
    pose = desk.main.T_eye_obj("ring_1")
    assert pose is not None
    assert desk.main.screen.project(pose.t) == pytest.approx(before, abs=1e-9)


class TestContour:
    """The outer silhouette, and nothing else."""

    @pytest.fixture
    def lines(self, open_desk: Callable[..., Desk]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Pixels of the contour of the ring at 4 pixels per pixel, and the ring's own pixels."""
        desk = open_desk(sizes=((800, 600),))
        desk.controller.set_tool(gizmo=Gizmo.OFF)
        u, v = CAMERA.project(desk.pose("ring_1").t)
        x, y = round(400 - 4 * (u + 0.5)), round(300 - 4 * (v + 0.5))
        desk.main.eye.window = ImageWindow(4.0, float(x), float(y))
        mask = silhouette(desk, "ring_1", 4.0, x, y)
        desk.controller.select("ring_1")
        desk.controller.set_options(style=Style.CONTOUR, only_selected=True)
        picture = desk.main.screenshot().astype(int)
        # Its own line is white; the image is grey and darker.
        lines = picture.min(axis=2) > 150
        lines[:45] = False
        ys, xs = np.nonzero(mask)
        outside = np.ones_like(lines)
        outside[ys.min() - 12 : ys.max() + 12, xs.min() - 12 : xs.max() + 12] = False
        lines[outside] = False
        return lines, mask

    def test_it_runs_around_the_outside_and_around_the_hole(
        self, lines: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    ) -> None:
        drawn, mask = lines
        holes, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        assert len(holes) == 2  # the ring's hole is seen
        distance = distance_transform_edt(~drawn)
        for loop in holes:
            at = loop.reshape(-1, 2)
            assert distance[at[:, 1], at[:, 0]].max() <= 2.5

    def test_no_line_runs_within_the_silhouette(
        self, lines: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    ) -> None:
        drawn, mask = lines
        assert drawn.sum() > 500
        # A line stays on the outer side of the edge, and close to it.
        assert distance_transform_edt(mask)[drawn].max() <= 1.5
        assert distance_transform_edt(~mask)[drawn].max() <= 4.5
