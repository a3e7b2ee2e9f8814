"""Camera poses of a real hand-held recording against a printed board, colour only.

The reference is independent of the pipeline: OpenCV finds the tags, a homography with RANSAC
rejects bad corners, IPPE and Levenberg-Marquardt give the pose, all with the given pinhole K.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_error, umeyama
from std_toolkit.geometry.mesh import load_mesh, mesh_diameter, mesh_extents
from std_toolkit.options import KnownCameras, Refinement
from std_toolkit.poses import PoseOptions
from std_toolkit.poses.pose_gates import failed_gates
from std_toolkit.poses.pose_step import estimate_poses
from std_toolkit.scene import CameraPoses, Label, Labels, Model, Object, ObjectTable, Scene

pytestmark = [pytest.mark.real, pytest.mark.slow]

MIN_TAGS = 10
# The mustard bottle annotated in six frames, one by one and independently of the camera poses:
# rough poses along the line of sight off by up to 1 %, turned by up to 4 degrees.
# frame id: the first three rows of T_cam_obj, metres.
# fmt: off
MUSTARD = {
    8: [
        0.872532, -0.481845, 0.080702, 0.317987,
        -0.417115, -0.820712, -0.390444, -0.152293,
        0.254367, 0.307013, -0.917083, 0.604940,
    ],
    40: [
        -0.964538, 0.240045, -0.109745, -0.213737,
        0.187302, 0.329541, -0.925376, 0.034434,
        -0.185967, -0.913116, -0.362816, 0.395908,
    ],
    58: [
        -0.955655, 0.286843, -0.066671, -0.366340,
        0.262837, 0.728686, -0.632403, 0.057647,
        -0.132818, -0.621882, -0.771765, 0.474405,
    ],
    88: [
        0.340105, 0.939950, 0.028665, 0.197873,
        0.640422, -0.209189, -0.738985, -0.039467,
        -0.688613, 0.269690, -0.673112, 0.368964,
    ],
    96: [
        0.329003, 0.938599, -0.103872, 0.176853,
        0.837084, -0.340782, -0.427970, 0.032589,
        -0.437089, 0.053854, -0.897804, 0.445803,
    ],
    114: [
        0.246822, 0.968314, -0.038043, 0.120717,
        0.558900, -0.174314, -0.810707, -0.024111,
        -0.791650, 0.178837, -0.584215, 0.302712,
    ],
}
# fmt: on


@pytest.fixture(scope="module")
def folder(test_data: Path) -> Path:
    path = test_data / "tabletop_board_rgb"
    if not path.is_dir():
        pytest.skip(f"{path} not found")
    return path


@pytest.fixture
def scene(tabletop_poses: Path, tmp_path: Path) -> Scene:
    """Solved without the board; the tests change it."""
    return Scene.open(shutil.copytree(tabletop_poses, tmp_path / "scene", symlinks=True))


@pytest.fixture(scope="module")
def corners(folder: Path) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """(board corners in metres, pixels) of every frame with enough tags, by frame id."""
    board = {
        int(k): np.array(v) / 1000
        for k, v in json.loads((folder / "board_mm.json").read_text()).items()
        if k.isdigit()
    }
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), parameters
    )
    found = {}
    for path in sorted((folder / "color").glob("*.jpg")):
        tags, ids, _ = detector.detectMarkers(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        if ids is None:
            continue
        known = [
            (board[int(i)], t[0]) for i, t in zip(np.ravel(ids), tags, strict=True) if i in board
        ]
        if len(known) >= MIN_TAGS:
            found[int(path.stem)] = (
                np.concatenate([k[0] for k in known]),
                np.concatenate([k[1] for k in known]).astype(np.float64),
            )
    return found


def board_pose(xyz: np.ndarray, uv: np.ndarray, K: np.ndarray) -> SE3:
    """T_cam_board."""
    _, mask = cv2.findHomography(xyz[:, :2] * 1000, uv, cv2.RANSAC, 3.0)
    good = mask.ravel() > 0
    best: tuple[float, SE3] | None = None
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        xyz[good], uv[good], K, None, flags=cv2.SOLVEPNP_IPPE
    )
    for r, t in zip(rotations, translations, strict=True):
        r, t = cv2.solvePnPRefineLM(xyz[good], uv[good], K, None, r, t)
        projected = cv2.projectPoints(xyz[good], r, t, K, None)[0][:, 0]
        error = float(np.linalg.norm(projected - uv[good], axis=1).mean())
        if best is None or error < best[0]:
            best = error, SE3(cv2.Rodrigues(r)[0], t.ravel())
    assert best is not None
    return best[1]


def compare(scene: Scene, reference: dict[int, SE3]) -> dict[str, float]:
    """Errors after similarity alignment of the camera centres: mm, degrees, relative scale."""
    frames = [i for i in reference if scene.T_world_cam(i) is not None]
    ours = [scene.T_world_cam(i) for i in frames]
    truth = [reference[i].inverse() for i in frames]
    fit = umeyama(np.array([T.t for T in ours]), np.array([T.t for T in truth]))
    mm = [1000 * np.linalg.norm(fit @ a.t - b.t) for a, b in zip(ours, truth, strict=True)]
    turned = [
        np.degrees(rotation_error(fit.transform_pose(a), b))
        for a, b in zip(ours, truth, strict=True)
    ]
    return {
        "frames": len(frames),
        "median_mm": float(np.median(mm)),
        "rmse_mm": float(np.sqrt(np.mean(np.square(mm)))),
        "median_deg": float(np.median(turned)),
        "scale": fit.scale,
    }


def test_against_the_board(scene: Scene, corners) -> None:
    assert len(scene.registered_frames()) >= 75
    assert failed_gates(scene.poses) == []
    K = scene.camera(scene.frames[0]).K
    found = compare(scene, {i: board_pose(*c, K) for i, c in corners.items()})
    print(found)
    assert found["frames"] >= 55
    assert found["median_mm"] <= 1.2
    assert found["rmse_mm"] <= 2.0
    assert found["median_deg"] <= 0.2


def test_board_as_scale_source(scene: Scene, corners, folder: Path, capsys) -> None:
    # The model of the first run is reused: only the scale is new.
    estimate_poses(scene, PoseOptions(scale="board", board=folder / "board_mm.json"))
    assert scene.poses is not None and scene.poses.scale is not None
    assert scene.poses.scale.unit == "metre"
    (estimate,) = scene.poses.scale.estimates
    assert estimate.standard_error < 1e-3
    K = scene.camera(scene.frames[0]).K
    found = compare(scene, {i: board_pose(*c, K) for i, c in corners.items()})
    print(found)
    assert abs(found["scale"] - 1) <= 0.002


@pytest.fixture(scope="module")
def third(tabletop_poses: Path, folder: Path, tmp_path_factory) -> tuple[Scene, dict[str, SE3]]:
    """Every third image as a scene without poses, and the poses that all images and the board
    give, by file name."""
    root = tmp_path_factory.mktemp("known")
    every = Scene.open(shutil.copytree(tabletop_poses, root / "all", symlinks=True))
    estimate_poses(every, PoseOptions(scale="board", board=folder / "board_mm.json"))
    chosen = every.frames[::3]
    (root / "images").mkdir()
    for frame in chosen:
        (root / "images" / f"{frame.name}.jpg").symlink_to(every.color_path(frame).resolve())
    K = every.camera(every.frames[0]).K
    words = ["--quiet", "import", "--color", str(root / "images"), "--out", str(root / "third")]
    words += ["--intrinsics", ",".join(str(x) for x in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))]
    assert main(words) == 0
    return Scene.open(root / "third"), {f.name: every.T_world_cam(f.id) for f in chosen}


def known(scene: Scene, poses: dict[str, SE3], folder: Path) -> CameraPoses:
    """Poses of the step with these known cameras."""
    path = folder / "cameras.json"
    path.write_text(json.dumps({k: T.matrix().tolist() for k, T in poses.items()}))
    return estimate_poses(scene, PoseOptions(known=KnownCameras(cameras=path)))


def test_right_known_poses_are_not_accused(third, tmp_path: Path) -> None:
    scene, truth = third
    poses = known(scene, truth, tmp_path)
    assert [p.status for p in poses.frames] == ["registered"] * 26
    assert all(g.passed for g in poses.gates)
    assert not [n for n in poses.notes if "does not fit" in n]


def test_wrong_known_poses_are_named(third, tmp_path: Path) -> None:
    scene, truth = third
    names = list(truth)
    wrong = {
        4: SE3.exp([0.03, 0, 0, 0, 0, 0]),
        11: SE3.exp([0, 0, 0, 0, np.radians(2), 0]),
        17: SE3.exp([0, 0, 0.03, 0, 0, 0]),
        23: SE3.exp([0, 0, 0, 0, 0, np.radians(2)]),
    }
    given = {k: T @ wrong.get(i, SE3.identity()) for i, (k, T) in enumerate(truth.items())}
    given[names[8]] = truth[names[14]]
    poses = known(scene, given, tmp_path)
    lost = [f.name for f, p in zip(scene.frames, poses.frames, strict=True) if not p.T_world_cam]
    assert lost == [names[i] for i in (4, 8, 11, 17, 23)]
    (note,) = [n for n in poses.notes if "does not fit" in n]
    assert all(f"{name}.jpg (explains " in note for name in lost)


def test_known_poses_that_are_late_or_noisy_are_refused(third, tmp_path: Path) -> None:
    scene, truth = third
    late = dict(zip(truth, [*list(truth.values())[:1], *list(truth.values())[:-1]], strict=True))
    with pytest.raises(ToolkitError, match="the list is late by one image"):
        known(scene, late, tmp_path)
    rng = np.random.default_rng(0)
    noisy = {
        k: T @ SE3.exp(rng.normal(size=6) * np.repeat([0.008, np.radians(0.8)], 3))
        for k, T in truth.items()
    }
    with pytest.raises(ToolkitError, match="do not explain the images"):
        known(scene, noisy, tmp_path)


def test_mustard_bottle_as_scale_source(scene: Scene, folder: Path, test_data: Path) -> None:
    """Against the board: both know the metres of the same reconstruction."""
    source = test_data / "ycb_meshes" / "006_mustard_bottle"
    if not source.is_dir():
        pytest.skip(f"{source} not found")
    shutil.copytree(source, scene.root / "models" / "mustard")
    mesh = load_mesh(scene.root / "models" / "mustard" / "textured.obj")
    model = Model(
        id="mustard",
        mesh="models/mustard/textured.obj",
        size_m=mesh_extents(mesh).tolist(),
        diameter_m=mesh_diameter(mesh),
    )
    thing = Object(id=1, name="mustard", model="mustard", material="diffuse")
    scene.save_objects(ObjectTable(models=[model], objects=[thing]))
    views = {str(k): [*v, 0.0, 0.0, 0.0, 1.0] for k, v in MUSTARD.items()}
    first = views.pop("8")
    scene.save_labels(Labels(labels=[Label(object=1, frame=8, T_cam_obj=first, views=views)]))
    board = folder / "board_mm.json"
    poses = estimate_poses(scene, PoseOptions(scale="cad", board=board))
    assert poses.scale is not None and poses.scale.chosen == "cad"
    factors = {e.source: e.factor for e in poses.scale.estimates}
    print(poses.scale)
    assert abs(factors["cad"] / factors["board"] - 1) <= 0.008
    # Unnamed, sources further apart than the limits stop the run.
    strict = PoseOptions(board=board, max_disagreement=1e-4, max_disagreement_sigma=0.5)
    with pytest.raises(ToolkitError, match=r"differ by .* --scale"):
        estimate_poses(scene, strict)
    assert Scene.open(scene.root).poses == poses
    # The bottle is 0.6 % off, 1.2 joint deviations: the board decides.
    report = estimate_poses(scene, PoseOptions(board=board)).scale
    assert report is not None
    assert report.chosen == "board"
    assert report.factor == pytest.approx(factors["board"], rel=5e-4)


@pytest.mark.long  # test_estimate_poses.py refines distortion of a small recording
def test_refined_distortion_agrees_with_a_calibrated_board(
    scene: Scene, corners, folder: Path
) -> None:
    """With the lens modelled on both sides, the two agree twice as well."""
    options = PoseOptions(
        scale="board", board=folder / "board_mm.json", refine=Refinement.DISTORTION
    )
    estimate_poses(scene, options)
    K = scene.info.cameras["color"].camera().K
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    _, K, distortion, *_ = cv2.calibrateCamera(
        [c[0].astype(np.float32) for c in corners.values()],
        [c[1].astype(np.float32) for c in corners.values()],
        (1280, 720),
        K,
        None,
        flags=flags,
    )
    reference = {
        i: board_pose(xyz, cv2.undistortPoints(uv[:, None], K, distortion, P=K)[:, 0], K)
        for i, (xyz, uv) in corners.items()
    }
    found = compare(scene, reference)
    print(found)
    assert found["median_mm"] <= 0.8
    assert found["rmse_mm"] <= 1.2
    assert found["median_deg"] <= 0.2
    assert abs(found["scale"] - 1) <= 0.002
