"""Scans of RGB-D scenes: what the sensor's depth adds, its scale, and depth that is no good."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

pytest.importorskip("manifold3d")

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, so3_exp
from std_toolkit.geometry.ray_caster import RayCaster
from std_toolkit.scanning import scan_step
from std_toolkit.scanning.photos.photos import Photos, is_scene, scene_photos
from std_toolkit.scanning.photos.posed_photos import PosedPhotos
from std_toolkit.scanning.photos.views import View
from std_toolkit.scanning.surface.depth_maps import depth_maps
from std_toolkit.scanning.surface.measured_surface import Side, fused_surface, measure_side
from std_toolkit.scene import CameraModel, Frames, ObjectTable, Scene, SceneInfo
from tests.scene_on_disk import write_frames
from tests.std_toolkit.scanning.ball import CAMERA, ball_views
from tests.std_toolkit.scanning.test_scan_step import options_for, write_photos
from tests.std_toolkit.scanning.test_turned_over import (
    OPTIONS,
    dented_block,
    photos,
    plain,
    standing,
)

# The dent of the block is on its top.
UPSIDE_DOWN = SE3(so3_exp(np.array([np.pi, 0, 0])), np.zeros(3))
NOISE = 0.001
FACTOR = 1.012
CORNERS = np.array([[x, y, 0.0] for x in (-0.1, 0.16) for y in (-0.12, 0.08)])


def measured_views(*, factor: float = FACTOR) -> tuple[list[View], np.ndarray]:
    """Photos of the plain, dented block with noisy sensor depth, and the vertices of the block.

    The true depth is `factor` times what the sensor says.
    """
    mesh = dented_block()
    T = standing(mesh, UPSIDE_DOWN)
    vertices = T @ np.asarray(mesh.vertices)
    caster = RayCaster(vertices, mesh.faces)
    rng = np.random.default_rng(0)
    views = []
    for view in photos(mesh, T, plain):
        local = view.camera.rays()
        world = local @ view.T_world_cam.R.T
        rays = np.concatenate([np.broadcast_to(view.centre, world.shape), world], axis=-1)
        with np.errstate(divide="ignore"):
            table = np.where(world[..., 2] < 0, -view.centre[2] / world[..., 2], np.inf)
        # Rays end at z = 1 in the camera, so distances along them are z-depths.
        depth = np.minimum(caster.cast(rays).distance, table)
        depth = np.where(np.isfinite(depth) & (depth < 2), depth, 0) / factor
        depth += NOISE * rng.normal(size=depth.shape) * (depth > 0)
        views.append(replace(view, sensor=depth.astype(np.float32)))
    return views, vertices


def side_of(views: list[View], folder: Path) -> tuple[Side, PosedPhotos]:
    posed = PosedPhotos(
        views=views, corners=CORNERS, points=np.zeros((0, 3)), on_table=True, facts={},
        warnings=[], digest="", photos=Photos((), (), (240, 180), 1.0),
    )  # fmt: skip
    folder.mkdir()
    side = measure_side(OPTIONS, posed, views, depth_maps, folder, 1, lambda _: None)
    return side, posed


def depth_of_dent(side: Side, middle: np.ndarray, top: float) -> float:
    """How far the surface lies below the top in the middle of the dent, median, metres."""
    found = fused_surface(OPTIONS, [(side, SE3.identity())], {}, 1)
    vertices = np.asarray(found.vertices)
    near = np.abs(vertices[:, :2] - middle) < [0.015, 0.008]
    on_top = near.all(axis=1) & (vertices[:, 2] > 0.5 * top)
    return float(top - np.median(vertices[on_top, 2]))


@pytest.mark.slow
def test_the_sensor_finds_a_plain_hollow_that_photos_alone_fill(tmp_path: Path) -> None:
    views, vertices = measured_views()
    middle = vertices[:, :2].min(axis=0) / 2 + vertices[:, :2].max(axis=0) / 2
    top = float(vertices[:, 2].max())
    bare, _ = side_of([replace(v, sensor=None) for v in views], tmp_path / "bare")
    assert depth_of_dent(bare, middle, top) < 0.004
    side, posed = side_of(views, tmp_path / "measured")
    assert all(v.sensor is None for v in side.views)
    assert depth_of_dent(side, middle, top) == pytest.approx(0.008, abs=0.002)
    scale = float(posed.facts["sensor depth"].split()[1].rstrip(","))
    assert scale == pytest.approx(FACTOR, abs=0.001)
    assert float(posed.facts["sensor depth on the object"].split()[0]) > 60


def test_depth_in_another_unit_is_left_out(tmp_path: Path) -> None:
    views, _ = measured_views(factor=1.2)
    side, posed = side_of(views, tmp_path / "side")
    assert side.sensor == []
    assert "the board is at 1.20 times what it measured" in posed.warnings[0]


def write_scene(root: Path, count: int = 16, *, cameras: int = 1) -> Path:
    """The ball as an RGB-D scene; and cameras.json beside it, of its frames."""
    write_photos(root.parent / "photos", count)
    views = ball_views(count)
    table = write_frames(
        root,
        [v.image for v in views],
        [0.24 * (v.mask if v.mask is not None else 0) for v in views],
    )
    frames = [
        structs.replace(f, name=f"{n:03d}", camera=f"c{n % cameras}")
        for n, f in enumerate(table.frames)
    ]
    info = SceneInfo(
        name="ball",
        cameras={f"c{k}": CameraModel.of(CAMERA) for k in range(cameras)},
        depth_scale=0.001,
    )
    Scene.create(root, info, Frames(frames=frames), ObjectTable(models=[], objects=[]))
    return root


@pytest.mark.slow
def test_a_scene_is_scanned_with_its_own_intrinsics(tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene")
    assert is_scene(root)
    done = scan_step.scan(options_for(tmp_path, photos=root, intrinsics=None))
    assert done.supported.mean() > 0.5
    assert "sensor depth on the object" in done.facts


def test_a_scene_of_several_cameras_is_refused(tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene", cameras=2)
    with pytest.raises(ToolkitError, match=r"several cameras.*c0, c1"):
        scene_photos(root, tmp_path, longest=1600)


def test_a_long_scene_is_sampled(tmp_path: Path) -> None:
    root = write_scene(tmp_path / "scene", 75)
    found = scene_photos(root, tmp_path, longest=80)
    assert 50 <= len(found.paths) <= 60
    assert found.sensor is not None
    depth = found.sensor.depth(0, found.size)
    assert depth is not None
    assert depth.shape == (60, 80)
