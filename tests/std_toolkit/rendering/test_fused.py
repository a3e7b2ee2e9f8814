"""Geometry fused from sensor depth lies where the pixels say, to a hundredth of a pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.images import write_color, write_depth_png16
from std_toolkit.options import FusionOptions
from std_toolkit.rendering.occluders import fuse_occluders, load_occluder
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
