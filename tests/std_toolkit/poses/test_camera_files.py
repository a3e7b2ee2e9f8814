"""Camera poses from the files of other tools: round trips, conventions, names, and errors."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.geometry.se3 import so3_log
from std_toolkit.options import KnownCameras
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.frame_matching import match_frames
from std_toolkit.poses.hand_eye import read_transform
from std_toolkit.poses.known_cameras import read_known_poses
from std_toolkit.poses.trajectory import write_trajectory
from std_toolkit.scene import CameraModel, CameraPoses, Frame, FramePose, Frames, Scene, SceneInfo

CAMERA = Camera(64, 48, 60.0, 61.0, 31.0, 24.0, (-0.1, 0.01, 0.002, 0.001))
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])


def make_scene(root: Path, *, timed: bool = True) -> Scene:
    """Five frames; the third has no pose."""
    rng = np.random.default_rng(3)
    frames = [
        Frame(
            id=i * 2,
            name=f"{i + 7:06d}",
            color=f"color/{i + 7:06d}.png",
            timestamp=0.1 * i if timed else None,
        )
        for i in range(5)
    ]
    scene = Scene.create(
        root, SceneInfo(name="s", cameras={"color": CameraModel.of(CAMERA)}), Frames(frames=frames)
    )
    poses = [
        FramePose(frame=f.id, status="registered", T_world_cam=SE3.exp(rng.normal(size=6)).flat())
        for f in frames
    ]
    poses[2] = FramePose(frame=4, status="unregistered")
    scene.save_poses(CameraPoses(frames=poses, source="import:test"))
    return scene


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return make_scene(tmp_path / "scene")


def truth_of(scene: Scene) -> dict[int, SE3]:
    poses = {f.id: scene.T_world_cam(f.id) for f in scene.frames}
    return {f: T for f, T in poses.items() if T is not None}


def check_read(path: Path, scene: Scene, *, tolerance: float = 1e-9, **options: object) -> None:
    """The file gives the poses of the scene, and no others."""
    known = read_known_poses(KnownCameras(cameras=path, **options), scene.frames)  # type: ignore[arg-type]
    found, truth = known.poses(), truth_of(scene)
    assert list(found) == list(truth)
    for frame, T in truth.items():
        assert np.abs(found[frame].matrix() - T.matrix()).max() < tolerance


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("format", ["csv", "tum", "colmap", "nerf"])
def test_exported_trajectories_read_back(format: str, timed: bool, tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", timed=timed)
    out = tmp_path / {"csv": "t.csv", "tum": "t.txt", "colmap": "t", "nerf": "t.json"}[format]
    write_trajectory(scene, out, format=format)
    check_read(out, scene, cameras_unit="m")


def test_poses_of_another_scene_read_back(scene: Scene) -> None:
    check_read(scene.root / "poses.json", scene)


def save_txt(path: Path, M: np.ndarray) -> None:
    np.savetxt(path.with_suffix(".txt"), M, fmt="%.17g")


def save_npy(path: Path, M: np.ndarray) -> None:
    np.save(path.with_suffix(".npy"), M[:3])


def save_json(path: Path, M: np.ndarray) -> None:
    path.with_suffix(".json").write_text(json.dumps({"pose": M.tolist()}))


@pytest.mark.parametrize("save", [save_txt, save_npy, save_json])
@pytest.mark.parametrize(
    ("convention", "change"),
    [
        (None, lambda M: M),
        ("world-to-camera", np.linalg.inv),
        ("camera-to-world-opengl", lambda M: M @ FLIP),
        ("world-to-camera-opengl", lambda M: FLIP @ np.linalg.inv(M)),
        ("camera-to-world-unity", lambda M: Y_UP @ M @ Y_UP),
        ("world-to-camera-unity", lambda M: Y_UP @ np.linalg.inv(M) @ Y_UP),
    ],
)
def test_a_folder_of_matrices(
    save: Callable[[Path, np.ndarray], None],
    convention: str | None,
    change: Callable[[np.ndarray], np.ndarray],
    scene: Scene,
    tmp_path: Path,
) -> None:
    folder = tmp_path / "poses"
    folder.mkdir()
    (folder / "README.txt").write_text("poses of the arm")
    for frame, T in truth_of(scene).items():
        M = T.matrix()
        M[:3, 3] *= 1000
        # As 7-Scenes names them: the number tells the image.
        save(folder / f"frame-{frame // 2 + 7:06d}.pose", change(M))
    check_read(folder, scene, cameras_unit="mm", cameras_convention=convention)


def test_all_matrices_in_one_file(scene: Scene, tmp_path: Path) -> None:
    truth = truth_of(scene)
    named = {scene.frame(f).color.split("/")[1]: T.matrix() for f, T in truth.items()}
    (tmp_path / "a.json").write_text(json.dumps({k: M.tolist() for k, M in named.items()}))
    rows = [{"image": k, "w2c": np.linalg.inv(M).tolist()} for k, M in named.items()]
    (tmp_path / "b.json").write_text(json.dumps(rows))
    lines = [" ".join([k, *(f"{x:.17g}" for x in M[:3].ravel())]) for k, M in named.items()]
    (tmp_path / "c.txt").write_text("\n".join(lines))
    for name in ("a.json", "b.json", "c.txt"):
        check_read(tmp_path / name, scene)


def test_matrices_without_names_are_in_the_order_of_the_images(
    scene: Scene, tmp_path: Path
) -> None:
    matrices = np.array([T.matrix() for T in truth_of(scene).values()])
    frames = [f for f in scene.frames if f.id != 4]
    np.save(tmp_path / "a.npy", matrices)
    np.savetxt(tmp_path / "kitti.txt", matrices[:, :3].reshape(4, 12), fmt="%.17g")
    np.savetxt(tmp_path / "blocks.txt", matrices.reshape(16, 4), fmt="%.17g")
    for name in ("a.npy", "kitti.txt", "blocks.txt"):
        known = read_known_poses(KnownCameras(cameras=tmp_path / name), frames)
        assert list(known.row) == [0, 2, 6, 8]
        assert np.allclose(known.poses()[6].matrix(), matrices[2], atol=1e-12)
    with pytest.raises(ToolkitError, match="4 poses without image names for 5 images"):
        match_frames(read_cameras(tmp_path / "a.npy"), scene.frames)


def test_par_file_has_poses_and_intrinsics(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "x_par.txt"
    lines = ["4"]
    for frame, T in truth_of(scene).items():
        T_cam_world = T.inverse()
        numbers = [*CAMERA.K.ravel(), *T_cam_world.R.ravel(), *T_cam_world.t]
        name = scene.frame(frame).color.split("/")[1]
        lines.append(" ".join([name, *(f"{x:.17g}" for x in numbers)]))
    path.write_text("\n".join(lines))
    check_read(path, scene)
    lens = read_cameras(path).lens()
    assert lens is not None
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == (60.0, 61.0, 31.0, 24.0)


@pytest.mark.parametrize("format", ["colmap", "nerf"])
def test_intrinsics_read_back(format: str, scene: Scene, tmp_path: Path) -> None:
    write_trajectory(scene, tmp_path / "out", format=format)
    lens = read_cameras(tmp_path / "out").lens()
    assert lens is not None
    assert np.allclose((lens.fx, lens.fy, lens.cx, lens.cy), (60, 61, 31, 24), atol=1e-9)
    assert (lens.distortion, lens.size) == (CAMERA.distortion, (64, 48))


def test_log_of_a_robot_with_hand_eye(scene: Scene, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    T_flange_cam = SE3.exp(rng.normal(size=6) * 0.3)
    np.savetxt(tmp_path / "hand_eye.txt", T_flange_cam.matrix(), fmt="%.17g")
    w, x, y, z = T_flange_cam.quat()
    document = {"quaternion_xyzw": [x, y, z, w], "translation": (T_flange_cam.t * 1000).tolist()}
    (tmp_path / "hand_eye.json").write_text(json.dumps(document))
    log = tmp_path / "log.csv"
    lines = ["Timestamp, x, y, z, rx, ry, rz"]
    for frame, T in truth_of(scene).items():
        flange = T @ T_flange_cam.inverse()
        numbers = [*(flange.t * 1000), *so3_log(flange.R)]
        stamp = 0.05 * frame + 0.003
        lines.append(", ".join(f"{v:.17g}" for v in (stamp, *numbers)))
        # The robot logs more often than the camera takes images.
        lines.append(", ".join(f"{v:.17g}" for v in (stamp + 0.03, *(numbers * np.full(6, 1.1)))))
    log.write_text("\n".join(lines))
    options = {"cameras_unit": "mm"}
    check_read(log, scene, hand_eye=tmp_path / "hand_eye.txt", **options)
    check_read(
        log, scene, hand_eye=tmp_path / "hand_eye.json", hand_eye_unit="mm", tolerance=1e-9,
        **options,
    )  # fmt: skip


def test_time_stamps_in_file_names(tmp_path: Path) -> None:
    stamps = [1305031102.175304, 1305031102.211214]
    frames = [
        Frame(id=i, name=f"{s:.6f}", color=f"color/{s:.6f}.png") for i, s in enumerate(stamps)
    ]
    lines = [f"{s + 0.004:.4f} {i} 0 0 0 0 0 1" for i, s in enumerate(reversed(stamps))]
    (tmp_path / "groundtruth.txt").write_text(
        "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines)
    )
    filed = read_cameras(tmp_path / "groundtruth.txt")
    assert match_frames(filed, frames) == {0: 1, 1: 0}
    with pytest.raises(ToolkitError, match=r"no pose of this file .* first image is 1305031102"):
        match_frames(filed, frames, max_dt=0.001)


def test_the_unit_of_a_reconstruction_must_be_named(scene: Scene, tmp_path: Path) -> None:
    write_trajectory(scene, tmp_path / "t.json", format="nerf")
    with pytest.raises(ToolkitError, match="unit of a transforms file is not stated"):
        read_known_poses(KnownCameras(cameras=tmp_path / "t.json"), scene.frames)


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("a.txt", "", "has no camera poses"),
        ("a.txt", "1 2 3\n4 5 6\n", "unknown layout of camera poses: 3 columns"),
        ("a.txt", "1.png 0 0 0 0 0 0 2\n", "quaternion .* length 1"),
        ("a.txt", "1.png 0 0 x 0 0 0 1\n", "line 1.*not a number"),
        ("a.txt", "1.png 0 0 nan 0 0 0 1\n", "no camera poses: all are not finite or zero"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 2 0\n", "line 1.*not a rotation"),
        ("a.csv", "name,x,y,z\na,1,2,3\n", "columns do not hold a pose"),
        ("a.csv", "name,x,y,z,rx,ry,rz\na,1,2,3,0,0\n", "line 2.*not a number"),
        ("a.csv", "name,x,y,z,rx,ry,rz\n", "has no camera poses"),
        ("a.json", "{", "not valid JSON"),
        ("a.json", "3", "not a file of camera poses"),
        ("a.json", '{"frames": []}', "has no camera poses"),
        ("a.json", '{"a": {"b": 1}}', "not a camera pose"),
        ("a.json", '{"a": [[1, 2], [3, 4]]}', "needs 4x4"),
        ("a.json", '{"frames": [{"transform_matrix": [[1]]}]}', "needs 4x4"),
        ("a.npy", "x", "not a numpy array"),
        ("a.pkl", "x", "pickled files are not read"),
        ("images.bin", "x", "give the folder of the COLMAP model"),
    ],
)
def test_bad_files_give_one_line(name: str, text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ToolkitError, match=problem) as error:
        read_cameras(path)
    assert "\n" not in str(error.value) and str(path) in str(error.value)


def rounded(path: Path, scene: Scene, decimals: int) -> float:
    """Write a folder of matrices with so many decimals; return how far they are off orthonormal."""
    path.mkdir()
    off = []
    for frame, T in truth_of(scene).items():
        M = np.round(T.matrix(), decimals)
        off.append(np.abs(M[:3, :3] @ M[:3, :3].T - np.eye(3)).max())
        np.savetxt(path / f"frame-{frame // 2 + 7:06d}.pose.txt", M)
    return float(max(off))


@pytest.mark.parametrize("decimals", [3, 2])
def test_rounded_rotations_are_projected_with_one_warning(
    decimals: int, scene: Scene, tmp_path: Path, caplog
) -> None:
    off = rounded(tmp_path / "poses", scene, decimals)
    assert 1e-4 < off < 1e-2
    with caplog.at_level("WARNING", logger="std_toolkit"):
        check_read(tmp_path / "poses", scene, tolerance=0.6 * 10**-decimals * 3)
    said = [r.getMessage() for r in caplog.records if "orthonormal" in r.getMessage()]
    assert len(said) == 1
    assert f"{tmp_path / 'poses'}: the rotations of 4 of 4 poses are up to {off:.2g} off" in said[0]
    known = read_known_poses(KnownCameras(cameras=tmp_path / "poses"), scene.frames)
    for T in known.poses().values():
        assert np.abs(T.R @ T.R.T - np.eye(3)).max() < 1e-14
    assert "the nearest rotations are used" in known.note()


def test_exact_rotations_bring_no_warning(scene: Scene, tmp_path: Path, caplog) -> None:
    assert rounded(tmp_path / "poses", scene, 6) < 1e-4
    with caplog.at_level("WARNING", logger="std_toolkit"):
        check_read(tmp_path / "poses", scene, tolerance=1e-5)
    assert not [r for r in caplog.records if "orthonormal" in r.getMessage()]


def test_rotations_that_are_off_by_more_than_rounding_are_refused(tmp_path: Path) -> None:
    T = SE3.exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]).matrix()
    for name, change in {
        "scaled": np.diag([1.01, 1.01, 1.01]),
        "sheared": np.eye(3) + np.outer([1, 0, 0], [0, 0.02, 0]),
        "mirrored": np.diag([1.0, 1.0, -1.0]),
    }.items():
        M = T.copy()
        M[:3, :3] = change @ M[:3, :3]
        np.savetxt(tmp_path / f"{name}.txt", M)
        with pytest.raises(ToolkitError, match="not a rotation matrix"):
            read_cameras(tmp_path / f"{name}.txt")


@pytest.mark.parametrize("w", [0.00118, 1000.0, -2.0])
def test_homogeneous_poses_are_divided_by_w(w: float, scene: Scene, tmp_path: Path, caplog) -> None:
    frames = [
        {"file_path": scene.frame(f).color, "transform_matrix": (T.matrix() @ FLIP * w).tolist()}
        for f, T in truth_of(scene).items()
    ]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    with caplog.at_level("WARNING", logger="std_toolkit"):
        check_read(tmp_path / "transforms.json", scene, cameras_unit="m")
    (said,) = [r.getMessage() for r in caplog.records if "last row" in r.getMessage()]
    assert f"the last row of 4 of 4 poses is 0 0 0 w, w = {w:.6g}" in said


def test_only_positions_are_divided_where_the_rotation_is_one(scene: Scene, tmp_path: Path) -> None:
    rows = {}
    for f, T in truth_of(scene).items():
        M = T.matrix()
        M[:, 3] *= 0.25
        rows[scene.frame(f).name] = M.tolist()
    (tmp_path / "a.json").write_text(json.dumps(rows))
    check_read(tmp_path / "a.json", scene)


def test_other_last_rows_are_refused(tmp_path: Path) -> None:
    T = SE3.exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]).matrix()
    for last, problem in {
        (0, 0, 0, 0): "last row of a pose must be 0 0 0 1",
        (0.1, 0, 0, 1): "last row of a pose must be 0 0 0 1",
        (0, 0, 0, -1): "not a rotation matrix",
    }.items():
        np.savetxt(tmp_path / "a.txt", np.vstack([T[:3], last]))
        with pytest.raises(ToolkitError, match=problem):
            read_cameras(tmp_path / "a.txt")
    half = np.diag([0.5, 0.5, 0.5, 2.0]) @ T  # neither the block nor the block over w
    np.savetxt(tmp_path / "a.txt", half)
    with pytest.raises(ToolkitError, match="not a rotation matrix"):
        read_cameras(tmp_path / "a.txt")


@pytest.mark.real
def test_poses_of_kinectfusion_are_taken(test_data: Path, tmp_path: Path, caplog) -> None:
    source = test_data / "kinect_kitchen"
    for path in source.glob("*.pose.txt"):
        (tmp_path / path.name).symlink_to(path)
    filed = read_cameras(tmp_path)
    assert len(filed.matrices) == 64
    (repair,) = filed.repairs
    assert "of 64 of 64 poses are up to 0.00019 off orthonormal" in repair
    first = np.loadtxt(source / "frame-000000.pose.txt")
    assert np.abs(filed.matrices[0] - first).max() < 1e-4


def test_shift_of_the_list(scene: Scene, tmp_path: Path) -> None:
    truth = list(truth_of(scene).items())
    rows = [[scene.frame(f).name, T.matrix().tolist()] for f, T in truth]
    (tmp_path / "a.json").write_text(json.dumps(dict(rows)))
    # In another order than the images: the shift is that of the images.
    (tmp_path / "b.json").write_text(json.dumps(dict(rows[::-1])))
    for name in ("a.json", "b.json"):
        known = read_known_poses(KnownCameras(cameras=tmp_path / name), scene.frames)
        for step in (1, -1):
            found = known.shifted(step)
            kept = truth[:-1] if step > 0 else truth[1:]
            assert list(found) == [f for f, _ in kept]
            for (_, T), f in zip(truth[step:] if step > 0 else truth[:-1], found, strict=True):
                assert np.allclose(found[f].matrix(), T.matrix(), atol=1e-9)


def test_bad_folders_give_one_line(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(ToolkitError, match="no such file or folder of camera poses"):
        read_cameras(tmp_path / "none")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ToolkitError, match="no camera poses in this folder"):
        read_cameras(empty)
    broken = tmp_path / "model"
    broken.mkdir()
    for part in ("cameras", "images", "points3D"):
        (broken / f"{part}.bin").write_bytes(b"\x05\x00")
    with pytest.raises(ToolkitError, match="the COLMAP file is damaged"):
        read_cameras(broken)
    save_txt(empty / "1", np.eye(4))
    np.savetxt(empty / "2.txt", np.zeros((8, 4)))
    with pytest.raises(ToolkitError, match=r"2\.txt"):
        read_cameras(empty)
    with pytest.raises(ToolkitError, match="file not found"):
        read_transform(tmp_path / "none.txt", unit_in_m=1.0)


def test_two_poses_of_one_image_are_refused(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text("000007.png 0 0 0 0 0 0 1\n000007.png 0 0 1 0 0 0 1\n")
    with pytest.raises(ToolkitError, match="two poses of one image"):
        read_known_poses(KnownCameras(cameras=path), scene.frames)


def test_images_with_different_intrinsics_have_no_common_camera(
    scene: Scene, tmp_path: Path
) -> None:
    write_trajectory(scene, tmp_path / "t.json", format="nerf")
    document = json.loads((tmp_path / "t.json").read_text())
    document["frames"][1]["fl_x"] = 90.0
    (tmp_path / "t.json").write_text(json.dumps(document))
    with pytest.raises(ToolkitError, match="different intrinsics"):
        read_cameras(tmp_path / "t.json").lens()


POSE = SE3.from_quat((0.5, 0.1, 0.7, -0.5), (1.0, 2.0, 3.0))
NAMED_COLUMNS = {
    "a comment": "# timestamp tx ty tz qw qx qy qz\n7 {t} {wxyz}\n",
    "euroc": "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],"
    "q_RS_z [],v_RS_R_x [m s^-1]\n7 {t} {wxyz} 0.1\n",
    "csv": "name,pos_x,pos_y,pos_z,q_w,q_x,q_y,q_z\n7 {t} {wxyz}\n",
    "tum": "# timestamp tx ty tz qx qy qz qw\n7 {t} {xyzw}\n",
    "tum, rotation first": "# time qx qy qz qw tx ty tz\n7 {xyzw} {t}\n",
}


@pytest.mark.parametrize("kind", NAMED_COLUMNS)
def test_columns_that_are_named_in_any_order(kind: str, tmp_path: Path) -> None:
    w, x, y, z = POSE.quat()
    words = {"t": "1 2 3", "wxyz": f"{w} {x} {y} {z}", "xyzw": f"{x} {y} {z} {w}"}
    head, row = NAMED_COLUMNS[kind].format(**words).splitlines()
    row = row.replace(" ", ",") if "," in head else row
    (tmp_path / "poses.csv").write_text(f"{head}\n{row}\n")
    found = read_cameras(tmp_path / "poses.csv")
    assert found.keys == ["7"]
    np.testing.assert_allclose(found.matrices, [POSE.matrix()], atol=1e-12)


def test_a_log_of_redwood(tmp_path: Path) -> None:
    rows = "".join(" ".join(map(repr, map(float, row))) + "\n" for row in POSE.matrix())
    (tmp_path / "trajectory.log").write_text(f"0 0 1\n{rows}1 1 2\n{rows}")
    found = read_cameras(tmp_path / "trajectory.log")
    np.testing.assert_allclose(found.matrices, 2 * [POSE.matrix()], atol=1e-12)


def test_degrees_are_no_rotation_vector(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("name,x,y,z,rx,ry,rz\na,0,0,0,0,17,3\n")
    with pytest.raises(ToolkitError, match=r"line 2: a rotation vector is in radians"):
        read_cameras(tmp_path / "p.csv")


def test_null_for_a_lost_image(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text(
        "name,x,y,z,qw,qx,qy,qz\na,1,2,3,1,0,0,0\nb,null,null,null,null,null,null,null\n"
    )
    assert read_cameras(tmp_path / "p.csv").keys == ["a"]
    (tmp_path / "poses").mkdir()
    (tmp_path / "poses/0.json").write_text(json.dumps(POSE.matrix().tolist()))
    (tmp_path / "poses/1.json").write_text("null")
    assert read_cameras(tmp_path / "poses").lost == {1}
