"""Geometry fused from sensor depth lies where the pixels say, to a hundredth of a pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.options import FusionOptions
from std_toolkit.rendering.choose import get_renderer
from std_toolkit.rendering.frame import FrameJob, _possible_policy
from std_toolkit.rendering.maps import compose
from std_toolkit.rendering.occluders import _trusted_depth, fuse_occluders, load_occluder
from std_toolkit.rendering.placements import frame_placements, place_meshes
from std_toolkit.rendering.raycast import RaycastRenderer
from std_toolkit.scene.model import (
    CameraModel,
    CameraPoses,
    Frame,
    FramePose,
    Frames,
    ObjectTable,
    SceneInfo,
)
from std_toolkit.scene.scene import Scene

CAMERA = Camera(320, 240, 300.0, 305.0, 161.3, 118.6)
DEPTH_SCALE = 0.00002
DISTANCE = 0.7


def plane_depth(pixels: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """z of the plane z = DISTANCE + slope . (x, y) behind pixels (..., 2)."""
    rays = CAMERA.unproject(pixels, 1.0)
    return DISTANCE / (1 - rays[..., :2] @ slope)


def scene_of_a_plane(root: Path, slope: np.ndarray) -> Scene:
    """One frame of a tilted plane, and no object."""
    write_color(root / "color/000000.png", np.full((240, 320, 3), 90, np.uint8))
    depth = plane_depth(CAMERA.pixel_grid(), slope)
    write_depth_png16(root / "depth/000000.png", depth, scale=DEPTH_SCALE)
    scene = Scene.create(
        root,
        SceneInfo(name="plane", cameras={"color": CameraModel.of(CAMERA)}, depth_scale=DEPTH_SCALE),
        Frames(
            frames=[Frame(id=0, name="000000", color="color/000000.png", depth="depth/000000.png")]
        ),
        ObjectTable(models=[], objects=[]),
    )
    pose = FramePose(frame=0, status="registered", T_world_cam=SE3.identity().flat())
    scene.save_poses(CameraPoses(frames=[pose]))
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("axis", [0, 1], ids=["u", "v"])
def test_fused_geometry_lies_where_it_should_to_a_hundredth_of_a_pixel(
    tmp_path: Path, axis: int
) -> None:
    """Pixels moved along a slope change its depth, the other way on the opposite slope.

    A voxel takes the nearest pixel, up to half a pixel off to either side; over all vertices that
    is no shift, unless pixel centres are taken to lie elsewhere.
    """
    shifts = []
    for sign in (1.0, -1.0):
        slope = np.zeros(2)
        slope[axis] = 0.6 * sign
        scene = scene_of_a_plane(tmp_path / f"{sign:g}", slope)
        mesh = load_occluder(*fuse_occluders(scene, FusionOptions()))
        assert mesh is not None
        points = mesh.vertices + mesh.centre
        pixels = CAMERA.project(points)
        # Where voxels are partly out of view, the nearest pixel lies to one side.
        pixels, z = (
            a[((pixels > 10) & (pixels < np.array(CAMERA.size) - 11)).all(axis=1)]
            for a in (pixels, points[:, 2])
        )
        assert len(z) > 5000
        step = np.zeros(2)
        step[axis] = 0.5
        per_pixel = plane_depth(pixels + step, slope) - plane_depth(pixels - step, slope)
        error = plane_depth(pixels, slope) - z
        shifts.append(float(error @ per_pixel / (per_pixel @ per_pixel)))
    assert abs(np.mean(shifts)) < 0.01, shifts


@pytest.mark.parametrize("material", ["diffuse", "transparent"])
def test_readings_on_an_object_hide_nothing(
    make_scene: Callable[..., Scene], material: str
) -> None:
    """In front of glass none counts; on other objects those count that are well in front."""
    scene = make_scene(frames=1, material=material)
    camera, options = scene.camera(scene.frame(0)), FusionOptions()
    placed = place_meshes(scene, frame_placements(scene, 0))[:1]
    corners = np.asarray(placed[0].prepared.vertices) + placed[0].prepared.centre
    nearest, farthest = (f((placed[0].T_cam_obj @ corners)[:, 2]) for f in (np.min, np.max))
    seen = compose(get_renderer("raycast"), camera, placed).index == 0
    for gap in (0.9, 1.1):
        sensor = np.full(seen.shape, nearest - gap * options.clearance_m, np.float32)
        depth, limit = _trusted_depth(scene, sensor, camera, placed, RaycastRenderer(), options)
        counts = material == "diffuse" and gap > 1
        assert (depth[seen] > 0).all() if counts else not depth[seen].any()
        assert limit == pytest.approx(farthest)
        assert depth[0, 0] == sensor[0, 0]  # beside the object


def test_a_policy_needs_what_it_compares_with(make_scene: Callable[..., Scene]) -> None:
    scene = make_scene(frames=1)
    job = FrameJob(str(scene.root), "", "raycast", "fused", 0.01, True, None, None)
    with_occluder = replace(job, occluder=("gt/occluders.ply", "digest"))
    assert _possible_policy(scene, 0, None, job) == "models"
    assert _possible_policy(scene, 0, None, with_occluder) == "fused"
    scene.save_poses(CameraPoses(frames=[FramePose(frame=0, status="unregistered")]))
    assert _possible_policy(scene, 0, None, with_occluder) == "models"


def test_views_without_depth_are_left_out(tmp_path: Path) -> None:
    """A sensor that measured nothing, or only what is behind the objects."""
    scene = scene_of_a_plane(tmp_path / "scene", np.zeros(2))
    nothing = np.zeros((240, 320), np.float32)
    write_depth_png16(scene.root / "depth/000000.png", nothing, scale=DEPTH_SCALE)
    assert load_occluder(*fuse_occluders(scene, FusionOptions())) is None
