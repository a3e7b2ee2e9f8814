"""Objects cast one by one and put together are the objects cast together."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from depth_picture import CAMERA, bottle_mesh, mesh_object
from tiny_camera import camera_pose

from std_toolkit.geometry.se3 import SE3, so3_exp
from std_toolkit.labels.refine.caster import LayerStore, WorldCaster, cast_patch, image_box
from std_toolkit.labels.refine.problem import RefineObject

VIEW = camera_pose(0.2, radius=0.45, height=0.3)
BACK = SE3(so3_exp([0.0, 0.0, 0.4]), np.array([-0.02, 0.01, 0.05]))
FRONT = SE3(so3_exp([0.0, 0.0, -0.9]), np.array([0.01, -0.08, 0.0]))


def things() -> list[RefineObject]:
    return [
        mesh_object(trimesh.creation.box((0.08, 0.05, 0.1)), BACK, "box"),
        mesh_object(bottle_mesh(), FRONT, "bottle"),
    ]


@pytest.mark.parametrize("first", [0, 1])
def test_layers_put_together_are_what_single_rays_meet(first: int) -> None:
    both = things()
    caster = WorldCaster(both, [BACK, FRONT])
    thing, pose = both[first], (BACK, FRONT)[first]
    patch = cast_patch(caster, thing, pose, CAMERA, VIEW, margin=12)
    h, w = patch.hits.object.shape
    v, u = np.mgrid[patch.y : patch.y + h, patch.x : patch.x + w]
    rays = caster.cast(CAMERA, VIEW, np.stack([u, v], axis=-1).astype(float))
    assert set(np.unique(rays.object)) == {-1, 0, 1}
    # A ray along an edge may meet either side: it is one of thousands.
    assert np.mean(patch.hits.object != rays.object) < 1e-3
    same = (patch.hits.object == rays.object) & (rays.object >= 0)
    assert np.abs(patch.hits.depth[same] - rays.depth[same]).max() < 1e-5
    assert np.percentile(np.abs(patch.hits.normal - rays.normal)[same], 99.9) < 1e-3
    assert patch.among == (0, 1)


def test_normals_are_made_only_where_they_are_needed() -> None:
    caster = WorldCaster(things(), [BACK, FRONT])
    v, u = np.mgrid[60:180:3, 80:240:3]
    pixels = np.stack([u, v], axis=-1).astype(float)
    whole = caster.cast(CAMERA, VIEW, pixels)
    wanted = (u + v) % 2 == 0
    some = caster.cast(CAMERA, VIEW, pixels, facing=wanted)
    assert np.array_equal(some.object, whole.object) and np.array_equal(some.depth, whole.depth)
    assert (whole.object >= 0).any()
    assert np.array_equal(some.normal[wanted], whole.normal[wanted])
    assert not some.normal[~wanted].any()


def test_only_what_moved_is_cast_again() -> None:
    box, bottle = things()
    layers = LayerStore()
    surface = box.surface
    first = layers.layer(surface, BACK, CAMERA, VIEW)
    assert layers.layer(surface, SE3(BACK.R.copy(), BACK.t.copy()), CAMERA, VIEW) is first
    moved = layers.layer(surface, SE3(BACK.R, BACK.t + np.array([0.001, 0, 0])), CAMERA, VIEW)
    assert moved is not first
    assert layers.layer(bottle.surface, BACK, CAMERA, VIEW) is not first
    smaller = CAMERA.resized(160, 120)
    assert layers.layer(surface, BACK, smaller, VIEW).depth.size < 0.4 * first.depth.size


def test_the_box_around_an_image_holds_all_of_it_and_little_else() -> None:
    can = mesh_object(trimesh.creation.cylinder(0.03, 0.1, sections=90), BACK, "can")
    T = VIEW.inverse() @ BACK
    x0, y0, x1, y1 = image_box(can.surface, T, CAMERA)
    rays = WorldCaster([can], [BACK]).cast(CAMERA, VIEW, CAMERA.pixel_grid())
    v, u = np.nonzero(rays.object == 0)
    assert x0 <= u.min() and y0 <= v.min() and x1 >= u.max() and y1 >= v.max()
    assert (x1 - x0 + 1) * (y1 - y0 + 1) < 1.35 * np.ptp(u) * np.ptp(v)


def test_what_reaches_beside_the_camera_is_cast_in_the_whole_image() -> None:
    board = mesh_object(trimesh.creation.box((2.0, 2.0, 0.01)), SE3.identity(), "board")
    assert image_box(board.surface, VIEW.inverse(), CAMERA) is None
    layer = LayerStore().layer(board.surface, SE3.identity(), CAMERA, VIEW)
    assert layer.depth.shape == (CAMERA.height, CAMERA.width)
    behind = SE3(np.eye(3), VIEW.t + 3 * (VIEW.t - np.array([0, 0, 0.05])))
    can = mesh_object(trimesh.creation.cylinder(0.03, 0.1), behind, "can")
    assert LayerStore().layer(can.surface, behind, CAMERA, VIEW) is None


def test_layers_that_were_not_used_for_longest_are_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("std_toolkit.labels.refine.caster._MOST_BYTES", 1_500_000)
    layers, surface = LayerStore(), things()[0].surface
    poses = [SE3(BACK.R, BACK.t + np.array([0.0002 * k, 0, 0])) for k in range(40)]
    kept = [layers.layer(surface, T, CAMERA, VIEW) for T in poses]
    assert sum(x.depth.nbytes + x.normal.nbytes for x in kept) > 3_000_000
    assert layers.layer(surface, poses[-1], CAMERA, VIEW) is kept[-1]
    assert layers.layer(surface, poses[0], CAMERA, VIEW) is not kept[0]
