"""Trajectories in the formats of other tools, each proven by reading it back."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses.trajectory import write_trajectory
from std_toolkit.scene import CameraModel, CameraPoses, Frame, FramePose, Frames, Scene, SceneInfo

CAMERA = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, (-0.1, 0.01, 0.002, 0.001))


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    rng = np.random.default_rng(0)
    frames = [
        Frame(id=i * 2, name=f"{i:06d}", color=f"color/{i:06d}.png", timestamp=0.1 * i)
        for i in range(5)
    ]
    scene = Scene.create(
        tmp_path / "scene",
        SceneInfo(name="s", cameras={"color": CameraModel.of(CAMERA)}),
        Frames(frames=frames),
    )
    poses = [
        FramePose(
            frame=f.id,
            status="registered",
            T_world_cam=SE3.exp(rng.normal(size=6)).flat(),
            reprojection_px=0.5,
            points=10,
        )
        for f in frames
    ]
    poses[3] = FramePose(frame=6, status="unregistered")
    scene.save_poses(CameraPoses(frames=poses, source="import:test"))
    return scene


def test_csv(scene: Scene, tmp_path: Path) -> None:
    out = tmp_path / "poses.csv"
    assert main(["trajectory", str(scene.root), "--out", str(out)]) == 0
    with out.open() as file:
        rows = list(csv.DictReader(file))
    columns = [f"m{r}{c}" for r in range(4) for c in range(4)]
    assert list(rows[0]) == ["frame", "name", "status", "reprojection_px", *columns]
    assert [r["frame"] for r in rows] == ["0", "2", "4", "6", "8"]
    assert rows[3]["status"] == "unregistered"
    assert all(rows[3][c] == "" for c in [*columns, "reprojection_px"])
    M = np.array([float(rows[1][c]) for c in columns]).reshape(4, 4)
    T = scene.T_world_cam(2)
    assert T is not None and (T.matrix() == M).all()


def test_tum(scene: Scene, tmp_path: Path) -> None:
    write_trajectory(scene, tmp_path / "t.txt", format="tum")
    rows = np.loadtxt(tmp_path / "t.txt")
    assert rows.shape == (4, 8)
    assert np.allclose(rows[:, 0], [0, 0.1, 0.2, 0.4])
    x, y, z, w = rows[2, 4:]
    T = scene.T_world_cam(4)
    assert T is not None
    assert np.allclose(SE3.from_quat([w, x, y, z], rows[2, 1:4]).matrix(), T.matrix(), atol=1e-8)


def test_colmap(scene: Scene, tmp_path: Path) -> None:
    import pycolmap

    write_trajectory(scene, tmp_path / "model", format="colmap")
    assert (tmp_path / "model" / "images.txt").is_file()
    model = pycolmap.Reconstruction(tmp_path / "model")
    assert model.num_reg_images() == 4
    image = model.find_image_with_name("color/000002.png")
    T = scene.T_world_cam(4)
    assert T is not None
    assert np.allclose(image.cam_from_world().matrix(), T.inverse().matrix()[:3], atol=1e-9)
    p = T @ np.array([0.1, 0.2, 1.0])
    pixel = model.camera(image.camera_id).img_from_cam(image.cam_from_world() * p)
    assert np.allclose(pixel, CAMERA.project(np.array([0.1, 0.2, 1.0])) + 0.5, atol=1e-6)
    with pytest.raises(ToolkitError, match="the folder is not empty"):
        write_trajectory(scene, tmp_path / "model", format="colmap")


def test_nerf(scene: Scene, tmp_path: Path) -> None:
    write_trajectory(scene, tmp_path / "transforms.json", format="nerf")
    data = json.loads((tmp_path / "transforms.json").read_text())
    assert len(data["frames"]) == 4
    frame = data["frames"][2]
    assert frame["file_path"] == "color/000002.png"
    M = np.array(frame["transform_matrix"])
    T = scene.T_world_cam(4)
    assert T is not None
    # OpenGL camera: looks along -z, y up. A point one metre ahead is at z = -1.
    assert np.allclose(M @ [0, 0, -1, 1], [*(T @ np.array([0, 0, 1.0])), 1])
    assert np.allclose(M @ [0, 1, 0, 1], [*(T @ np.array([0, -1.0, 0])), 1])
    assert frame["cx"] == CAMERA.cx + 0.5
    assert [frame[k] for k in ("k1", "k2", "p1", "p2")] == list(CAMERA.distortion)


def test_no_poses(tmp_path: Path) -> None:
    scene = Scene.create(
        tmp_path / "scene",
        SceneInfo(name="s", cameras={"color": CameraModel.of(CAMERA)}),
        Frames(frames=[Frame(id=0, name="a", color="color/a.png")]),
    )
    with pytest.raises(ToolkitError, match="no camera poses"):
        write_trajectory(scene, tmp_path / "x.csv")
    with pytest.raises(ToolkitError, match="unknown trajectory format"):
        write_trajectory(scene, tmp_path / "x.csv", format="xyz")


def test_nerf_tells_the_whole_lens_or_refuses_it(scene: Scene, tmp_path: Path) -> None:
    out = tmp_path / "transforms.json"
    for distortion in [(0.1, 0.02, 0.0, 0.001, -0.03), (0.1, 0.02, 0, 0, 0.01, 0.2, 0, 0)]:
        camera = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, distortion)
        scene.save_info(SceneInfo(name="s", cameras={"color": CameraModel.of(camera)}))
        if len(distortion) == 5:
            write_trajectory(scene, out, format="nerf")
            frame = json.loads(out.read_text())["frames"][0]
            assert [frame[k] for k in ("k1", "k2", "p1", "p2", "k3")] == list(distortion)
        else:
            with pytest.raises(ToolkitError, match="k4, k5 and k6"):
                write_trajectory(scene, out, format="nerf")
