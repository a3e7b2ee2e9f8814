"""Amodal silhouettes: clipped, unclipped, and with lens distortion."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.maps import compose, mask_box, object_silhouette, render_scene_maps
from std_toolkit.rendering.mesh import prepare_mesh
from std_toolkit.rendering.renderer import PlacedMesh, Renderer, image_window, object_window

CAMERA = Camera(320, 240, 300.0, 300.0, 159.5, 119.5)


def plate(x: float, y: float, z: float = 1.0) -> tuple[trimesh.Trimesh, SE3]:
    """A 0.2 m square (60 px at 1 m) with its centre at (x, y, z), camera frame."""
    return trimesh.creation.box((0.2, 0.2, 1e-4)), SE3(np.eye(3), np.array([x, y, z]))


def test_pixels_outside_the_image_count(renderer: Renderer) -> None:
    """Centred on the image's corner: a quarter inside, all of it on the 3 x 3 canvas."""
    mesh, pose = plate(159.5 / 300, 119.5 / 300)
    full = object_silhouette(renderer, CAMERA, mesh, pose)
    clipped = object_silhouette(renderer, CAMERA, mesh, pose, canvas=1)
    assert full.px_all == pytest.approx(60 * 60, rel=0.05)
    assert full.box is not None
    assert full.box[0] == pytest.approx(289, abs=1)
    assert full.box[2] == pytest.approx(349, abs=1)
    assert clipped.px_all == np.count_nonzero(full.image_mask(CAMERA))
    assert clipped.px_all == pytest.approx(30 * 30, rel=0.1)
    assert clipped.box == mask_box(clipped.image_mask(CAMERA))


def test_the_canvas_has_an_end(renderer: Renderer) -> None:
    mesh, pose = plate(0.0, 0.0, z=0.04)  # fills far more than nine images
    full = object_silhouette(renderer, CAMERA, mesh, pose)
    assert full.px_all == 9 * 320 * 240
    assert full.box == (-320, -240, 639, 479)


def test_nothing_in_view(renderer: Renderer) -> None:
    mesh, pose = plate(5.0, 0.0)
    empty = object_silhouette(renderer, CAMERA, mesh, pose)
    assert empty.px_all == 0
    assert empty.box is None
    assert not empty.image_mask(CAMERA).any()


def test_beside_the_image_but_on_the_canvas(renderer: Renderer) -> None:
    mesh, pose = plate(0.8, 0.0)
    aside = object_silhouette(renderer, CAMERA, mesh, pose)
    assert aside.px_all == pytest.approx(60 * 60, rel=0.05)
    assert aside.image is None
    assert not aside.image_mask(CAMERA).any()


def test_distortion_inside_pinhole_outside() -> None:
    lens = Camera(320, 240, 300.0, 300.0, 159.5, 119.5, (-0.2, 0.05, 0.0, 0.0))
    renderer = get_renderer("raycast")
    mesh, pose = plate(0.5, 0.0)
    full = object_silhouette(renderer, lens, mesh, pose)
    inside = object_silhouette(renderer, lens, mesh, pose, canvas=1)
    assert inside.px_all == np.count_nonzero(full.image_mask(lens))
    assert np.array_equal(full.image_mask(lens), inside.image_mask(lens))
    assert full.px_all > inside.px_all > 0
    assert full.box is not None
    assert full.box[2] >= 320


def test_silhouettes_ignore_what_is_in_front(renderer: Renderer) -> None:
    front, back = plate(0.0, 0.0, 0.9), plate(0.02, 0.0, 1.0)
    maps = render_scene_maps(renderer, CAMERA, [PlacedMesh(3, *back), PlacedMesh(8, *front)])
    assert np.count_nonzero(maps.mask == 8) == maps.silhouettes[8].px_all
    assert np.count_nonzero(maps.mask == 3) < 0.2 * maps.silhouettes[3].px_all
    hidden = maps.silhouettes[3].image_mask(CAMERA) & (maps.mask == 8)
    assert hidden.sum() + np.count_nonzero(maps.mask == 3) == maps.silhouettes[3].px_all


def test_ids_must_differ(renderer: Renderer) -> None:
    with pytest.raises(ToolkitError, match="must be unique"):
        render_scene_maps(renderer, CAMERA, [PlacedMesh(3, *plate(0, 0))] * 2)
    with pytest.raises(ToolkitError, match=r"1\.\.254"):
        render_scene_maps(renderer, CAMERA, [PlacedMesh(0, *plate(0, 0))])


def test_a_window_of_a_lens_holds_every_pixel_of_the_object() -> None:
    """Small plates anywhere in the image: none loses a row or column at its border."""
    lens = Camera(160, 120, 150.0, 150.0, 79.5, 59.5, (-0.2, 0.05, 0.001, -0.002))
    raycast = get_renderer("raycast")
    rng = np.random.default_rng(0)
    prepared = prepare_mesh(trimesh.creation.box((0.1, 0.1, 1e-4)))
    for x, y in rng.uniform([-0.4, -0.3], [0.4, 0.3], (60, 2)):
        pose = SE3(np.eye(3), np.array([x, y, 1.0]))
        window = object_window(lens, prepared, pose)
        whole = raycast.draw(lens, prepared, pose, window=image_window(lens)).depth > 0
        assert window is not None
        rows, columns = window.slices_in(image_window(lens))
        assert np.count_nonzero(whole[rows, columns]) == np.count_nonzero(whole) > 100


def test_pixels_without_an_object_have_no_face(renderer: Renderer) -> None:
    mesh, pose = plate(0.0, 0.0)
    composition = compose(renderer, CAMERA, [PlacedMesh(1, mesh, pose)])
    drawn = composition.index >= 0
    assert 0 < np.count_nonzero(drawn) < drawn.size
    assert (composition.face[~drawn] == -1).all()
    assert (composition.face[drawn] >= 0).all()


@pytest.mark.parametrize("distortion", [(), (0.1, -0.05, 0.001, 0.0)], ids=["pinhole", "lens"])
def test_the_window_fits_the_silhouette(distortion: tuple[float, ...]) -> None:
    """No pixel of the object is outside the window, and the window is hardly larger."""
    camera = Camera(320, 240, 300.0, 300.0, 159.5, 119.5, distortion)
    for x, y in ((-0.31, 0.15), (0.27, -0.12), (0.0, 0.0)):
        mesh, pose = plate(x, y)
        window = object_window(camera, prepare_mesh(mesh), pose)
        box = object_silhouette(get_renderer("raycast"), camera, mesh, pose, canvas=1).box
        assert window is not None
        assert box is not None
        found = np.array([window.x, window.y, window.x1 - 1, window.y1 - 1])
        slack = (np.array(box) - found) * [1, 1, -1, -1]
        assert (slack >= 0).all(), (found, box)
        assert (slack <= (3 if distortion else 1)).all(), (found, box)
