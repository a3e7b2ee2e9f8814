"""Rendered depth against a real sensor's, with reference poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.mesh import load_mesh
from std_toolkit.io.images import read_depth
from std_toolkit.rendering.maps import Maps, render_scene_maps
from std_toolkit.rendering.renderer import PlacedMesh, Renderer

CAMERA = Camera(640, 480, 618.0172729492188, 618.0033569335938, 312.376953125, 232.37530517578125)
# Boxes, cans, bowl, mug and bottles; the others are thin or have poses that are off.
SOLID = {
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "021_bleach_cleanser",
    "024_bowl",
    "025_mug",
}


def rendered_frame(folder: Path, meshes: Path, index: int, renderer: Renderer) -> tuple[Maps, list]:
    """Maps of a frame with the refined reference poses, and the names by object id - 1."""
    names = sorted(p.name for p in meshes.iterdir() if p.is_dir() and p.name != "051_large_clamp")
    reference = scipy.io.loadmat(str(folder / "reference_poses" / f"{index:06d}-color.png.mat"))
    classes = reference["rois"][:, 1].astype(int)
    placed, found = [], []
    for k, (cls, pose) in enumerate(zip(classes, reference["poses_refined"], strict=True)):
        name = names[cls - 1]
        mesh = load_mesh(meshes / name / "textured.obj")
        placed.append(PlacedMesh(k + 1, mesh, SE3.from_quat(pose[:4], pose[4:7])))
        found.append(name)
    return render_scene_maps(renderer, CAMERA, placed), found


@pytest.mark.slow
@pytest.mark.real
def test_rendered_minus_sensor_depth(test_data: Path, renderer: Renderer) -> None:
    """Pose, mesh, units and camera agree with the sensor to a few millimetres.

    The reference poses bound what can be asked: both renderers give the same medians to 0.02 mm,
    within 4 mm for ten of the twelve solid objects, 4.6 mm for the cracker box and 4.5 mm for the
    mug; across the surface (along the normal) all are within 4 mm.
    """
    folder, meshes = test_data / "realsense_ycb_frames", test_data / "ycb_meshes"
    along_z: dict[str, float] = {}
    along_normal: dict[str, float] = {}
    rays = CAMERA.rays()
    for index in range(4):  # the fifth frame has no reference poses
        maps, names = rendered_frame(folder, meshes, index, renderer)
        sensor = read_depth(folder / f"{index:06d}-depth.png", scale=0.001, size=CAMERA.size)
        difference = (maps.depth - sensor) * 1000
        across = difference * -np.einsum("hwi,hwi->hw", maps.normals, rays)
        for k, name in enumerate(names):
            both = (maps.mask == k + 1) & (sensor > 0)
            if name in SOLID:
                assert np.count_nonzero(both) > 1000
                along_z[name] = float(np.median(difference[both]))
                along_normal[name] = float(np.median(across[both]))
    assert len(along_z) == 12
    assert max(abs(v) for v in along_normal.values()) <= 4.0, along_normal
    within = [name for name, v in along_z.items() if abs(v) <= 4.0]
    assert len(within) >= len(along_z) - 2, along_z
    assert max(abs(v) for v in along_z.values()) <= 5.0, along_z
