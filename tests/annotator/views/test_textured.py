"""Style textured: the texture of a mesh at the right places in every view."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import pyvista
import trimesh
from numpy.typing import NDArray
from textured_box import (
    BLUE,
    FRONT,
    GREEN,
    GREY,
    HALF_TURN,
    RED,
    SIZE,
    color_at,
    desk_with_box,
    hue_is,
    painted,
    texture,
    write_obj,
)
from views_desk import Desk

from annotator.app.placing import front_rotation
from annotator.app.view_options import Gizmo, Mode, Style, ViewOptions
from annotator.views import mesh_colors, meshes
from annotator.views.model_view import ModelView
from annotator.views.projection import ScreenCamera
from annotator.views.thumbnails import cached_thumbnail, thumbnail
from std_toolkit.geometry import SE3
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.geometry.obj_texture import CORNER_UV

# Places on the front, and on the back.
UPPER, LOWER = np.array([0.01, 0.05, SIZE[2] / 2]), np.array([-0.02, -0.04, SIZE[2] / 2])
BEHIND = np.array([0.015, -0.03, -SIZE[2] / 2])


@pytest.fixture
def box_desk(tmp_path: Path) -> Iterator[Callable[..., Desk]]:
    desks = []

    def start(**options: object) -> Desk:
        desks.append(desk_with_box(tmp_path / f"scene{len(desks)}", **options))  # type: ignore[arg-type]
        desks[-1].controller.set_tool(gizmo=Gizmo.OFF)
        desks[-1].controller.select(None)
        desks[-1].settle()
        return desks[-1]

    yield start
    for desk in desks:
        desk.close()


def pixel(
    picture: NDArray[np.uint8], screen: ScreenCamera, T_eye_obj: SE3, point: NDArray[np.float64]
) -> NDArray[np.uint8]:
    x, y = np.floor(screen.project(T_eye_obj @ point)).astype(int)
    color: NDArray[np.uint8] = picture[y, x]
    return color


def assert_texture(desk: Desk, places: dict[tuple[int, int, int], NDArray[np.float64]]) -> None:
    """Check the colours at points of the box in the main view and in the side view."""
    for view in desk.views.views:
        picture, pose = view.screenshot(), view.T_eye_obj("box_1")
        assert pose is not None
        for color, point in places.items():
            found = pixel(picture, view.screen, pose, point)
            assert hue_is(found, color), (view.slot, view.mode, color, found)


def test_it_is_the_default() -> None:
    assert ViewOptions().style is Style.TEXTURED


def test_the_texture_is_where_the_mesh_has_it(box_desk: Callable[..., Desk]) -> None:
    assert_texture(box_desk(), {RED: UPPER, GREEN: LOWER})


def test_a_half_turn_shows_the_other_side(box_desk: Callable[..., Desk]) -> None:
    assert_texture(box_desk(pose=FRONT @ HALF_TURN), {BLUE: BEHIND})


def test_every_pixel_has_the_colour_of_its_point(box_desk: Callable[..., Desk]) -> None:
    """Against the position on the box of the ray through each pixel, in a skew pose."""
    desk = box_desk(pose=SE3(SE3.exp([0, 0, 0, 0.3, 0.5, 0.2]).R @ FRONT.R, FRONT.t))
    view = desk.main
    picture, pose, solid = view.screenshot(), view.T_eye_obj("box_1"), view.solid("box_1")
    assert pose is not None and solid is not None
    back = pose.inverse()
    right = checked = 0
    for y in range(4, view.size[1], 9):
        for x in range(4, view.size[0], 9):
            hit = solid.shape.hit(back.t, back.R @ view.screen.ray((x + 0.5, y + 0.5)))
            # Beside edges and the line between red and green a pixel holds two colours.
            if (
                hit is None
                or np.abs(np.abs(hit[1]) - SIZE / 2).min(initial=1, where=[1, 1, 0]) < 0.004
            ):
                continue
            if abs(hit[1][1]) < 0.004 or SIZE[2] / 2 - 0.004 < abs(hit[1][2]) < SIZE[2] / 2 - 1e-6:
                continue
            checked += 1
            right += hue_is(picture[y, x], color_at(hit[1]))
    assert checked > 150
    assert right >= 0.99 * checked


def test_the_cloud_has_it_at_every_opacity(box_desk: Callable[..., Desk]) -> None:
    desk = box_desk()
    desk.controller.set_mode(Mode.CLOUD)
    desk.settle()
    assert_texture(desk, {RED: UPPER, GREEN: LOWER})
    opaque = desk.main.screenshot().astype(float)
    desk.controller.set_options(opacity=0.4)
    faint = desk.main.screenshot().astype(float)
    pose = desk.main.T_eye_obj("box_1")
    assert pose is not None
    p = pixel(faint, desk.main.screen, pose, UPPER)
    assert p[0] > p[1] + 30 and p[0] > p[2] + 30  # still red
    assert (faint != opaque).any()


def test_the_image_shines_through_by_the_opacity(box_desk: Callable[..., Desk]) -> None:
    desk = box_desk()
    pictures = {}
    for opacity in (1.0, 0.5):
        desk.controller.set_options(opacity=opacity)
        pictures[opacity] = desk.main.screenshot().astype(float)
    pose = desk.main.T_eye_obj("box_1")
    assert pose is not None
    for point in (UPPER, LOWER):
        opaque = pixel(pictures[1.0], desk.main.screen, pose, point)
        assert pixel(pictures[0.5], desk.main.screen, pose, point) == pytest.approx(
            0.5 * opaque + 45, abs=2
        )


def test_blinking_hides_it(box_desk: Callable[..., Desk]) -> None:
    desk = box_desk()
    shown = desk.main.screenshot()
    desk.main.blinked_off = True
    hidden = desk.main.screenshot()
    pose = desk.main.T_eye_obj("box_1")
    assert pose is not None
    assert hue_is(pixel(shown, desk.main.screen, pose, UPPER), RED)
    assert not hue_is(pixel(hidden, desk.main.screen, pose, UPPER), RED)


def test_other_styles_do_not_show_it(box_desk: Callable[..., Desk]) -> None:
    desk = box_desk()
    pose = desk.main.T_eye_obj("box_1")
    assert pose is not None
    for style in (Style.SOLID, Style.WIREFRAME, Style.CONTOUR):
        desk.controller.set_options(style=style)
        picture = desk.main.screenshot()
        assert not hue_is(pixel(picture, desk.main.screen, pose, LOWER), GREEN)
    desk.controller.set_options(style=Style.TEXTURED)
    assert_texture(desk, {RED: UPPER, GREEN: LOWER})


def test_a_mesh_without_colours_looks_as_in_solid(desk: Desk) -> None:
    textured = desk.main.screenshot()
    desk.controller.set_options(style=Style.SOLID)
    assert (desk.main.screenshot() == textured).all()


@pytest.mark.slow
def test_the_texture_stays_during_motion(box_desk: Callable[..., Desk]) -> None:
    """A decimated mesh has the colours of the full one."""
    desk = box_desk(pose=SE3(SE3.exp([0, 0, 0, 0.2, 0.4, 0]).R @ FRONT.R, FRONT.t), divisions=5)
    solid = desk.main.solid("box_1")
    assert solid is not None and solid.shape.light.faces < solid.shape.full.faces
    full = desk.main.screenshot().astype(int)
    desk.main.moving = True
    light = desk.main.screenshot().astype(int)
    pose = desk.main.T_eye_obj("box_1")
    assert pose is not None
    assert hue_is(pixel(light.astype(np.uint8), desk.main.screen, pose, UPPER), RED)
    assert (np.abs(full - light).max(axis=2) > 40).mean() < 0.004


@pytest.mark.parametrize("turned", [False, True])
def test_the_model_view_shows_it(tmp_path: Path, turned: bool) -> None:
    shape = complete(load_mesh(write_obj(tmp_path / "box.obj")))
    plotter = pyvista.Plotter(off_screen=True, window_size=(200, 200))
    view = ModelView(plotter)
    try:
        view.show(shape)
        view.R_eye_obj = (FRONT @ HALF_TURN).R if turned else FRONT.R
        picture = view.screenshot()
        places = {BLUE: BEHIND} if turned else {RED: UPPER, GREEN: LOWER}
        for color, point in places.items():
            assert hue_is(pixel(picture, view.screen, view.T_eye_obj, point), color)
        view.show(shape, "#ffffff", style=Style.SOLID)
        assert not hue_is(pixel(view.screenshot(), view.screen, view.T_eye_obj, LOWER), GREEN)
    finally:
        view.close()
        plotter.close()


def test_the_thumbnail_shows_it(tmp_path: Path) -> None:
    mesh = load_mesh(write_obj(tmp_path / "box.obj"))
    picture = thumbnail(mesh, 96, 1)
    R = front_rotation(1)
    radius = float(np.linalg.norm(SIZE)) / 2
    f = 10 * 0.96 * 96 / 2
    for point in (UPPER, LOWER, BEHIND, np.array([SIZE[0] / 2, 0.02, 0.0])):
        normal = np.sign(point) * (np.abs(np.abs(point) - SIZE / 2) < 1e-9)
        if (R @ normal)[2] > -0.2:
            continue  # seen from behind, or at a grazing angle
        x, y, z = R @ point + [0, 0, 10 * radius]
        found = picture[round(f * y / z + 47.5), round(f * x / z + 47.5)]
        assert hue_is(found, color_at(point)), (point, found)


def test_a_thumbnail_is_drawn_again_for_another_texture(tmp_path: Path) -> None:
    box, uv = trimesh.creation.box(SIZE), np.random.default_rng(0).random((8, 2))
    first = cached_thumbnail(tmp_path, painted(box.copy(), texture(), uv), 48)
    second = cached_thumbnail(tmp_path, painted(box.copy(), texture()[::-1].copy(), uv), 48)
    assert (first != second).any()
    assert (cached_thumbnail(tmp_path, painted(box.copy(), texture(), uv), 48) == first).all()


def complete(mesh: trimesh.Trimesh) -> meshes.Shape:
    shape = meshes.make_shape(mesh)
    shape.complete()
    return shape


class TestColours:
    def test_vertex_colours_are_drawn(self) -> None:
        mesh = trimesh.creation.box(SIZE).subdivide().subdivide()
        up = np.asarray(mesh.vertices)[:, 1] > 0
        mesh.visual.vertex_colors = np.where(up[:, None], RED, GREEN).astype(np.uint8)
        self.assert_two_colors(mesh)

    def test_face_colours_are_drawn(self) -> None:
        mesh = trimesh.creation.box(SIZE).subdivide().subdivide()
        up = np.asarray(mesh.triangles_center)[:, 1] > 0
        mesh.visual.face_colors = np.where(up[:, None], RED, GREEN).astype(np.uint8)
        self.assert_two_colors(mesh)

    def assert_two_colors(self, mesh: trimesh.Trimesh) -> None:
        plotter = pyvista.Plotter(off_screen=True, window_size=(200, 200))
        view = ModelView(plotter)
        try:
            view.show(complete(mesh))
            view.R_eye_obj = FRONT.R
            picture = view.screenshot()
            assert hue_is(pixel(picture, view.screen, view.T_eye_obj, UPPER), RED)
            assert hue_is(pixel(picture, view.screen, view.T_eye_obj, LOWER), GREEN)
        finally:
            view.close()
            plotter.close()

    @pytest.mark.parametrize("kind", ["material", "vertices", "faces", "texture"])
    def test_one_colour_is_no_texture(self, kind: str) -> None:
        box = trimesh.creation.box(SIZE)
        if kind == "material":
            material = trimesh.visual.material.SimpleMaterial(diffuse=[200, 10, 10, 255])
            box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
        elif kind == "vertices":
            box.visual.vertex_colors = np.tile([200, 10, 10, 255], (8, 1))
        elif kind == "faces":
            box.visual.face_colors = np.tile([200, 10, 10, 255], (12, 1))
        else:
            painted(
                box, np.full((16, 16, 3), 90, np.uint8), np.random.default_rng(0).random((8, 2))
            )
        assert complete(box).full.colored is None

    @pytest.mark.slow
    def test_a_large_texture_is_reduced_once(self) -> None:
        image = np.kron(texture(64), np.ones((128, 128, 1), np.uint8))
        assert image.shape[0] == 8192
        mesh = painted(trimesh.creation.box(SIZE), image, np.random.default_rng(0).random((8, 2)))
        colored = complete(mesh).full.colored
        assert colored is not None and colored.texture is not None
        assert max(colored.texture.image.shape) == mesh_colors.LARGEST_PX
        # A thumbnail of a side view takes far less than the main view.
        small = colored.texture.level(40, None)
        assert colored.texture.data(small).GetDimensions()[0] <= 256
        # Nothing is uploaded again for small changes of the size.
        assert colored.texture.level(45, small) == small
        assert colored.texture.data(small) is colored.texture.data(small)

    @pytest.mark.slow
    def test_a_decimated_mesh_has_the_colours_of_the_full_one(self, tmp_path: Path) -> None:
        mesh = load_mesh(write_obj(tmp_path / "box.obj", divisions=5))
        baked = complete(mesh).light.colored
        assert baked is not None and baked.texture is not None
        data = pyvista.wrap(baked.polydata)
        uv = np.asarray(baked.polydata.GetPointData().GetTCoords()).reshape(-1, 3, 2)
        corners = np.asarray(data.points).reshape(-1, 3, 3)
        rng = np.random.default_rng(1)
        face = rng.integers(0, len(corners), 4000)
        weights = rng.dirichlet((1, 1, 1), 4000)
        points = np.einsum("nk,nkd->nd", weights, corners[face])
        at = np.einsum("nk,nkd->nd", weights, uv[face])
        image = baked.texture.image
        rows = np.clip(((1 - at[:, 1]) * image.shape[0]).astype(int), 0, image.shape[0] - 1)
        columns = np.clip((at[:, 0] * image.shape[1]).astype(int), 0, image.shape[1] - 1)
        found = image[rows, columns]
        inner = (np.abs(np.abs(points) - SIZE / 2) < 0.003).sum(axis=1) == 1
        inner &= np.abs(points[:, 1]) > 0.003
        for p, color in zip(points[inner], found[inner], strict=True):
            near = np.where(np.abs(np.abs(p) - SIZE / 2) < 0.003, np.sign(p) * SIZE / 2, p)
            assert hue_is(color, color_at(near)), (p, color)
        assert inner.sum() > 2000


def test_faces_at_a_seam_keep_their_own_texture_coordinates(tmp_path: Path) -> None:
    mesh = load_mesh(write_obj(tmp_path / "box.obj"))
    corners = mesh.face_attributes[CORNER_UV].reshape(-1, 3, 2)
    # The faces of a corner of the box share its vertex and have different coordinates there.
    assert len(mesh.vertices) == 8
    assert np.abs(corners - mesh.visual.uv[mesh.faces]).max() > 0.1
    colors = mesh_colors.mesh_colors(mesh)
    assert colors is not None
    face = np.arange(12)
    found = colors.at(face, np.full((12, 2), 1 / 3))
    for point, color in zip(mesh.triangles_center, found, strict=True):
        if abs(point[1]) > 0.02 or abs(point[2]) < SIZE[2] / 2 - 1e-6:
            assert hue_is(color.astype(np.uint8), color_at(point))


def test_faces_that_are_no_triangles_have_coordinates_by_vertex(tmp_path: Path) -> None:
    path = write_obj(tmp_path / "box.obj")
    rows = [line for line in path.read_text().splitlines() if not line.startswith("f ")]
    path.write_text("\n".join([*rows, "f 1/1 2/2 4/3 3/4", "f 5/5 6/6 8/7 7/8"]) + "\n")
    assert CORNER_UV not in load_mesh(path).face_attributes


def test_grey_is_not_taken_for_a_texture() -> None:
    """Of the test itself: the colours are told apart."""
    for color in (RED, GREEN, BLUE, GREY):
        dark = (0.6 * np.array(color)).astype(np.uint8)
        assert [hue_is(dark, c) for c in (RED, GREEN, BLUE, GREY)].count(True) == 1
