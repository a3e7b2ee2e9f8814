"""Point clouds of sensor depth: of one frame, and fused over many."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from table_scene import (
    BOX_COLOR,
    BOX_SIZE,
    CAMERA,
    T_WORLD_BOX,
    T_WORLD_TABLE,
    TABLE_COLOR,
    camera_pose,
    write_table_scene,
)

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.io.images import write_depth_png16
from std_toolkit.rendering.point_cloud import (
    FusionCancelled,
    MultiViewCells,
    VoxelGrid,
    _stride,
    frame_cloud,
    fuse_clouds,
    sparse_points,
)
from std_toolkit.scene import Frame, Scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return write_table_scene(tmp_path_factory.mktemp("cloud") / "s", sparse=50)


def off_surface(points: np.ndarray) -> np.ndarray:
    """Metres by which points of the world miss the table and the box."""
    table = np.abs((T_WORLD_TABLE.inverse() @ points)[:, 2])
    q = np.abs(T_WORLD_BOX.inverse() @ points) - np.array(BOX_SIZE) / 2
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    box = np.abs(outside + np.minimum(q.max(axis=1), 0))
    return np.minimum(table, box)


@pytest.mark.slow
@pytest.mark.parametrize("stride", [1, 3])
def test_a_frames_cloud_lies_behind_its_pixels(scene: Scene, stride: int) -> None:
    points, colors = frame_cloud(scene, scene.frames[2], stride=stride)
    depth = scene.read_depth(scene.frames[2])
    assert depth is not None
    part = depth[::stride, ::stride]
    assert points.shape == (np.count_nonzero(part), 3)
    assert (points.dtype, colors.dtype) == (np.float32, np.uint8)
    v, u = np.nonzero(part)
    uv = CAMERA.project(points.astype(float))
    assert uv == pytest.approx(np.stack([u, v], axis=1) * stride, abs=1e-3)
    assert points[:, 2] == pytest.approx(part[v, u], abs=1e-6)
    image = scene.read_color(scene.frames[2])
    assert (colors == image[v * stride, u * stride]).all()


def test_the_fused_cloud_lies_on_the_surfaces(scene: Scene) -> None:
    cloud = fuse_clouds(scene, scene.frames, voxel_m=0.004)
    assert len(cloud.points) == len(cloud.colors) > 5000
    assert cloud.voxel_m == 0.004
    assert cloud.frames == tuple(range(8))
    assert cloud.skipped == {}
    missed = off_surface(cloud.points)
    assert np.quantile(missed, 0.95) < 0.002
    known = np.array([TABLE_COLOR, BOX_COLOR])
    nearest = np.linalg.norm(cloud.colors[:, None].astype(float) - known, axis=2).min(axis=1)
    assert np.mean(nearest < 3) > 0.97


def test_each_voxel_holds_one_point(scene: Scene) -> None:
    cloud = fuse_clouds(scene, scene.frames, voxel_m=0.01)
    cells = np.floor(cloud.points.astype(float) / 0.01 + 1e-6).astype(int)
    # float32 may round a mean across the border of its cell.
    assert len(np.unique(cells, axis=0)) > 0.999 * len(cells)


def test_more_points_than_the_limit_make_the_cells_grow(scene: Scene) -> None:
    cloud = fuse_clouds(scene, scene.frames, voxel_m=0.002, limit=3000)
    assert 1000 < len(cloud.points) <= 3000
    assert cloud.voxel_m > 0.004
    assert np.quantile(off_surface(cloud.points), 0.95) < 0.005


def test_readings_in_mid_air_are_dropped(tmp_path: Path) -> None:
    """Flying pixels beside steps, and what a single frame invented in the air."""
    scene = write_table_scene(tmp_path / "s")
    depth = scene.read_depth(scene.frames[4])
    assert depth is not None
    rng = np.random.default_rng(0)
    specks = rng.random(depth.shape) < 0.01
    depth = np.where(specks, depth * 0.7, depth)
    depth[100:112, 40:52] = 0.3
    write_depth_png16(scene.root / "depth/000004.png", depth, scale=0.0001)
    points, _ = frame_cloud(scene, scene.frames[4])
    assert (off_surface(camera_pose(4, 8) @ points.astype(float)) > 0.03).sum() > 500
    cloud = fuse_clouds(scene, scene.frames)
    assert (off_surface(cloud.points) > 0.03).sum() == 0


def test_what_is_beyond_the_farthest_depth_is_left_out(scene: Scene) -> None:
    near = fuse_clouds(scene, scene.frames[:1], farthest_m=0.75)
    points = camera_pose(0, 8).inverse() @ near.points.astype(float)
    assert 1000 < len(points) < len(fuse_clouds(scene, scene.frames[:1]).points)
    assert points[:, 2].max() <= 0.75 + near.voxel_m


@pytest.mark.parametrize(("voxel_m", "step"), [(0.001, 1), (0.006, 2), (0.01, 3), (0.3, 8)])
def test_two_pixels_fall_into_each_voxel(voxel_m: float, step: int) -> None:
    """At 1 m and a focal length of 700 pixels a pixel is 1.43 mm wide."""
    camera = Camera(64, 48, 700.0, 700.0, 31.5, 23.5)
    depth = np.ones((48, 64), np.float32)
    assert _stride(depth, camera, voxel_m) == step


def test_missing_depth_is_told(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s")
    depth = scene.read_depth(scene.frames[0])
    assert depth is not None
    depth[:, :160] = 0
    write_depth_png16(scene.root / "depth/000000.png", depth, scale=0.0001)
    bare = Frame(id=3, name="000003", color="color/000003.png")
    cloud = fuse_clouds(scene, [scene.frames[0], bare])
    assert cloud.frames == (0,)
    assert cloud.skipped == {3: "no sensor depth"}
    assert cloud.missing == pytest.approx(np.mean(scene.read_depth(scene.frames[0]) == 0), abs=1e-6)
    assert cloud.missing > 0.5


def test_scenes_without_depth_poses_or_metres_are_refused(tmp_path: Path) -> None:
    no_depth = write_table_scene(tmp_path / "a", frames=2, depth=False)
    with pytest.raises(ToolkitError, match=r"frame 1 has no sensor depth.*show the image"):
        frame_cloud(no_depth, no_depth.frames[1])
    with pytest.raises(ToolkitError, match="no sensor depth in these frames"):
        fuse_clouds(no_depth, no_depth.frames)
    no_poses = write_table_scene(tmp_path / "b", frames=2, posed=False)
    with pytest.raises(ToolkitError, match="none of these frames has a camera pose"):
        fuse_clouds(no_poses, no_poses.frames)
    with pytest.raises(ToolkitError, match="no frames were given"):
        fuse_clouds(no_poses, [])
    no_unit = write_table_scene(tmp_path / "c", frames=2, metres=False)
    with pytest.raises(ToolkitError, match="unit of these camera poses is unknown"):
        fuse_clouds(no_unit, no_unit.frames)
    with pytest.raises(ToolkitError, match="at least 1"):
        frame_cloud(no_poses, no_poses.frames[0], stride=0)


def test_progress_rises_to_one_and_fusing_can_be_cancelled(scene: Scene) -> None:
    seen: list[float] = []
    fuse_clouds(scene, scene.frames, progress=seen.append)
    assert seen == pytest.approx([(i + 1) / 8 for i in range(8)])
    seen.clear()
    with pytest.raises(FusionCancelled):
        fuse_clouds(scene, scene.frames, progress=seen.append, cancel=lambda: len(seen) >= 3)
    assert len(seen) == 3


def test_a_distorted_lens_is_undone(tmp_path: Path) -> None:
    scene = write_table_scene(tmp_path / "s", frames=1)
    import msgspec

    camera = scene.info.cameras["color"]
    lens = msgspec.structs.replace(camera, distortion=[0.1, -0.05, 0.001, -0.001])
    scene.save_info(msgspec.structs.replace(scene.info, cameras={"color": lens}))
    frame = scene.frames[0]
    points, _ = frame_cloud(scene, frame, stride=4)
    depth = scene.read_depth(frame)
    assert depth is not None
    v, u = np.nonzero(depth[::4, ::4])
    uv = scene.camera(frame).project(points.astype(float))
    assert uv == pytest.approx(4.0 * np.stack([u, v], axis=1), abs=2e-3)


def test_points_of_the_reconstruction(scene: Scene, tmp_path: Path) -> None:
    found = sparse_points(scene)
    assert found is not None
    xyz, rgb = found
    assert xyz.shape == rgb.shape == (50, 3)
    assert (rgb == 200).all()
    other = write_table_scene(tmp_path / "s", frames=1)
    assert sparse_points(other) is None
    # Points without colours are grey; those that are not finite are left out.
    (other.root / "poses").mkdir(exist_ok=True)
    points = "".join(f"{x} 0.2 0.3\n" for x in ("0.1", "nan", "0.4"))
    head = "ply\nformat ascii 1.0\nelement vertex 3\n"
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    (other.root / "poses/points.ply").write_text(f"{head}{names}end_header\n{points}")
    found = sparse_points(other)
    assert found is not None
    assert found[0][:, 0] == pytest.approx([0.1, 0.4])
    assert (found[1] == [[120] * 3] * 2).all()


def test_voxels_average_over_frames_and_remember_who_saw_them() -> None:
    grid, twice = VoxelGrid(0.1, limit=10), MultiViewCells(0.1)
    first = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [0.55, 0.5, 0.5]])
    means = grid.add(first, np.array([[10, 0, 0], [20, 0, 0], [7, 7, 7]], np.uint8))
    assert means == pytest.approx(np.array([[0.02, 0.01, 0.01], [0.55, 0.5, 0.5]]))
    twice.add(means)
    assert not twice.holds(grid.points).any()
    second = np.array([[0.08, 0.04, 0.01]])
    twice.add(grid.add(second, np.array([[90, 0, 30]], np.uint8)))
    assert grid.points == pytest.approx(np.array([[0.04, 0.02, 0.01], [0.55, 0.5, 0.5]]))
    assert grid.colors.tolist() == [[40, 0, 10], [7, 7, 7]]
    assert twice.holds(grid.points).tolist() == [True, False]
