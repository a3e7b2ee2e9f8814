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

from std_toolkit.geometry import SE3, rotation_error, umeyama
from std_toolkit.poses import PoseOptions
from std_toolkit.poses.options import Refinement
from std_toolkit.poses.step import estimate_poses, failed_gates
from std_toolkit.scene import CameraModel, Frame, Frames, Scene, SceneInfo

pytestmark = [pytest.mark.real, pytest.mark.slow]

MIN_TAGS = 10


@pytest.fixture(scope="module")
def folder(test_data: Path) -> Path:
    path = test_data / "tabletop_board_rgb"
    if not path.is_dir():
        pytest.skip(f"{path} not found")
    return path


@pytest.fixture(scope="module")
def scene(folder: Path, tmp_path_factory) -> Scene:
    """Solved without the board."""
    root = tmp_path_factory.mktemp("tabletop") / "scene"
    (root / "color").mkdir(parents=True)
    K = np.array(json.loads((folder / "cam_intrinsics.json").read_text())["K"])
    frames = []
    for path in sorted((folder / "color").glob("*.jpg")):
        shutil.copyfile(path, root / "color" / path.name)
        frames.append(Frame(id=int(path.stem), name=path.stem, color=f"color/{path.name}"))
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = CameraModel(width=1280, height=720, fx=fx, fy=fy, cx=cx, cy=cy)
    scene = Scene.create(
        root, SceneInfo(name="tabletop", cameras={"color": camera}), Frames(frames=frames)
    )
    estimate_poses(scene, PoseOptions(scale="none"))
    return scene


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
