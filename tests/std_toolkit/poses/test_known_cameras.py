"""Known camera poses: checked by reprojection, kept or refined, wrong conventions named."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from std_toolkit.cli.main import main
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, rotation_angle, umeyama
from std_toolkit.jobs import JobOptions
from std_toolkit.options import KnownCameras
from std_toolkit.poses import PoseOptions
from std_toolkit.poses.features import FeatureJob, extract_features
from std_toolkit.poses.known_model import align_poses
from std_toolkit.poses.pose_check import Tracks, join_tracks
from std_toolkit.poses.pose_step import estimate_poses
from std_toolkit.poses.reconstruct import feature_name, image_digests
from std_toolkit.scene import CameraPoses, Scene
from tests.std_toolkit.poses.conftest import CAMERA, Recording, make_recording

OPTIONS = PoseOptions(threads=1, max_features=1500)
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def ring() -> Recording:
    return make_recording(6, arc_deg=70, seed=4)


@pytest.fixture(scope="module")
def images(ring: Recording, tmp_path_factory) -> Scene:
    """A scene whose features are extracted; tests copy it."""
    scene = ring.write(tmp_path_factory.mktemp("known") / "scene", depth=False)
    scene = ring.write(tmp_path_factory.mktemp("known") / "scene", depth=False)
    jobs = [FeatureJob(f.name, scene.color_path(f), CAMERA.size, False) for f in scene.frames]
    digests, folder = image_digests(scene), scene.root / ".std" / "poses" / "features"
    named = [feature_name(f, digests[f.id], False, OPTIONS) for f in scene.frames]
    jobs = [replace(job, name=name) for job, name in zip(jobs, named, strict=True)]
    extract_features(
        jobs, folder, max_features=OPTIONS.max_features, options=JobOptions(engine="serial")
    )
    return scene


@pytest.fixture
def scene(images: Scene, tmp_path: Path) -> Scene:
    shutil.copytree(images.root, tmp_path / "scene")
    return Scene.open(tmp_path / "scene")


def run(scene: Scene, path: Path, **known: object) -> CameraPoses:
    chosen = KnownCameras(cameras=path, **known)  # type: ignore[arg-type]
    return estimate_poses(scene, replace(OPTIONS, known=chosen))


def save(folder: Path, poses: dict[str, np.ndarray]) -> Path:
    folder.mkdir(parents=True)
    for name, M in poses.items():
        np.savetxt(folder / f"{name}.txt", M, fmt="%.17g")
    return folder


def matrices(recording: Recording) -> dict[str, np.ndarray]:
    return {f"{i:06d}": T.matrix() for i, T in enumerate(recording.truth)}


@pytest.mark.slow
def test_known_poses_are_kept_exactly(ring: Recording, tmp_path: Path) -> None:
    scene = ring.write(tmp_path / "scene")
    poses = run(scene, save(tmp_path / "poses", matrices(ring)))
    for row, T in zip(poses.frames, ring.truth, strict=True):
        assert row.T_world_cam is not None and row.reprojection_px is not None
        assert np.abs(np.reshape(row.T_world_cam, (4, 4)) - T.matrix()).max() < 1e-9
        assert row.points > 50 and row.reprojection_px < 0.5 and row.covariance is not None
    assert all(g.passed for g in poses.gates) and len(poses.gates) == 6
    assert poses.source == "import:matrices"
    assert poses.scale is not None and (poses.scale.unit, poses.scale.chosen) == ("metre", "given")
    # Sensor depth confirms the unit.
    assert poses.scale.estimates[0].factor == pytest.approx(1, abs=5e-3)
    assert "read as camera-to-world in OpenCV axes, unit m" in poses.notes[0]
    assert (scene.root / "poses" / "sparse" / "images.bin").is_file()
    before = (scene.root / "poses.json").stat().st_mtime_ns
    assert run(scene, tmp_path / "poses").frames == poses.frames
    assert (scene.root / "poses.json").stat().st_mtime_ns == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            np.linalg.inv,
            "world-to-camera in OpenCV axes explains them: .*convention world-to-camera",
        ),
        (lambda M: M @ FLIP, "camera-to-world in OpenGL axes explains .* camera-to-world-opengl"),
        (lambda M: FLIP @ np.linalg.inv(M), "world-to-camera in OpenGL axes .*-to-camera-opengl"),
        (lambda M: Y_UP @ M @ Y_UP, "Unity axes explains .* camera-to-world-unity"),
    ],
)
def test_the_right_convention_is_named(
    change, named: str, ring: Recording, scene: Scene, tmp_path: Path
) -> None:
    path = save(tmp_path / "poses", {k: change(M) for k, M in matrices(ring).items()})
    with pytest.raises(
        ToolkitError, match="these poses do not explain the images: .*" + named
    ) as e:
        run(scene, path)
    assert not (scene.root / "poses.json").exists()
    assert "\n" not in str(e.value)


@pytest.mark.slow
def test_poses_of_other_images_are_refused_unless_asked_for(
    ring: Recording, scene: Scene, tmp_path: Path
) -> None:
    shuffled = dict(zip(matrices(ring), reversed(matrices(ring).values()), strict=True))
    path = save(tmp_path / "poses", shuffled)
    with pytest.raises(ToolkitError, match=r"do not explain the images: .* px; limit 4 px"):
        run(scene, path)
    poses = run(scene, path, cameras_unchecked=True)
    assert any("do not explain the images" in note for note in poses.notes)


@pytest.mark.slow
def test_a_list_that_is_shifted_by_one_image_is_named(tmp_path: Path) -> None:
    """Poses at equal steps of an arc would fit when shifted: their steps are unequal here."""
    every = make_recording(15, arc_deg=70, seed=4)
    part = [0, 1, 4, 6, 10, 11, 14]
    uneven = Recording([every.colors[i] for i in part], [], [every.truth[i] for i in part])
    scene = uneven.write(tmp_path / "scene", depth=False)
    names, rows = list(matrices(uneven)), list(matrices(uneven).values())
    late = dict(zip(names[1:], rows[:-1], strict=True))
    with pytest.raises(ToolkitError, match=r"the pose of the next row .* is late by one image"):
        run(scene, save(tmp_path / "late", late))
    early = dict(zip(names[:-1], rows[1:], strict=True))
    with pytest.raises(ToolkitError, match=r"the pose of the previous row .* early by one image"):
        run(scene, save(tmp_path / "early", early))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [True, False])
def test_the_unit_is_checked(depth: bool, ring: Recording, scene: Scene, tmp_path: Path) -> None:
    if depth:
        scene = ring.write(tmp_path / "with_depth")
    scaled = {k: M * np.array([[1, 1, 1, 1000.0]]) for k, M in matrices(ring).items()}
    for M in scaled.values():
        M[3, 3] = 1
    path = save(tmp_path / "poses", scaled)
    with pytest.raises(ToolkitError, match="use --cameras-unit mm"):
        run(scene, path)
    poses = run(scene, path, cameras_unit="mm")
    assert np.allclose(poses.frames[3].T_world_cam, ring.truth[3].flat(), atol=1e-9)
    poses = run(scene, path, cameras_unit="unknown")
    assert poses.scale is not None
    assert poses.scale.unit == ("metre" if depth else "unknown")
    if depth:
        assert poses.frames[3].T_world_cam is not None
        assert np.allclose(poses.frames[3].T_world_cam, ring.truth[3].flat(), atol=5e-3)


@pytest.mark.slow
def test_frames_without_a_pose_and_with_a_wrong_one(
    ring: Recording, scene: Scene, tmp_path: Path, capsys
) -> None:
    given = matrices(ring)
    del given["000001"]
    given["000003"] = given["000003"] @ SE3.exp([0.03, 0, 0, 0, 0.04, 0]).matrix()
    path = save(tmp_path / "poses", given)
    words = ["--quiet", "poses", str(scene.root), "--cameras", str(path), "--threads", "1"]
    words += ["--max-features", "1500"]
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert "registered 4 of 6 frames" in out and "unregistered: 000001, 000003" in out
    assert "the pose of 1 frames does not fit the others: 000003.png (explains " in out
    assert "cannot be judged" not in out
    assert "poses has no pose for 000001" in err
    poses = Scene.open(scene.root).poses
    assert poses is not None
    assert [p.status == "registered" for p in poses.frames] == [
        True,
        False,
        True,
        False,
        True,
        True,
    ]


@pytest.mark.slow
def test_refinement_keeps_scale_and_frame(ring: Recording, scene: Scene, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noisy = {
        k: M
        @ SE3.exp(np.concatenate([rng.normal(size=3) * 2e-3, rng.normal(size=3) * 2e-3])).matrix()
        for k, M in matrices(ring).items()
    }
    path = save(tmp_path / "poses", noisy)
    poses = run(scene, path, cameras_use="refine")
    assert "refined: the poses moved by" in poses.notes[-1]
    refined = [SE3.from_matrix(np.reshape(p.T_world_cam, (4, 4))) for p in poses.frames]  # type: ignore[arg-type]
    given = [SE3.from_matrix(M) for M in noisy.values()]
    # The best similarity to the given poses is the identity.
    scale, T = align_poses(refined, given)
    assert abs(scale - 1) < 1e-6 and np.abs(T.log()).max() < 1e-6

    def turn(poses: list[SE3]) -> float:
        """Median rotation between neighbours against the truth, degrees."""
        pairs = zip(poses, poses[1:], ring.truth, ring.truth[1:], strict=False)
        errors = [
            rotation_angle((a.inverse() @ b).R.T @ (c.inverse() @ d).R) for a, b, c, d in pairs
        ]
        return float(np.degrees(np.median(errors)))

    assert turn(refined) < 0.5 * turn(given)
    ours, truth = (np.array([p.t for p in x]) for x in (refined, ring.truth))
    assert umeyama(ours, truth).scale == pytest.approx(1, abs=0.01)


@pytest.mark.slow
def test_log_of_a_robot(ring: Recording, scene: Scene, tmp_path: Path) -> None:
    X = SE3.exp([0.05, -0.02, 0.08, 0.3, -0.2, 1.2])
    np.savetxt(tmp_path / "hand_eye.txt", X.matrix())
    np.savetxt(tmp_path / "inverse.txt", X.inverse().matrix())
    flange = {k: M @ X.inverse().matrix() for k, M in matrices(ring).items()}
    path = save(tmp_path / "log", flange)
    poses = run(scene, path, hand_eye=tmp_path / "hand_eye.txt")
    assert np.allclose(poses.frames[5].T_world_cam, ring.truth[5].flat(), atol=1e-9)
    assert "hand-eye transform hand_eye.txt" in poses.notes[0]
    with pytest.raises(ToolkitError, match="inverse hand-eye transform explains them"):
        run(scene, path, hand_eye=tmp_path / "inverse.txt")
    with pytest.raises(ToolkitError, match="do not explain the images"):
        run(scene, path)
    with pytest.raises(ToolkitError, match="--hand-eye needs --cameras"):
        estimate_poses(scene, PoseOptions(known=KnownCameras(hand_eye=path)))


@pytest.mark.slow
def test_import_with_known_poses(ring: Recording, scene: Scene, tmp_path: Path, capsys) -> None:
    images = scene.root / "color"
    path = save(tmp_path / "poses", matrices(ring))
    K = f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}"
    words = ["--quiet", "import", "--color", str(images), "--cameras", str(path)]
    assert main([*words, "--out", str(tmp_path / "a")]) == 1
    assert "the file of camera poses has no intrinsics" in capsys.readouterr().err
    wrong = [*words, "--intrinsics", K, "--cameras-convention", "world-to-camera"]
    assert main([*wrong, "--out", str(tmp_path / "a")]) == 1
    assert "camera-to-world in OpenCV axes explains them" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
    assert main([*words, "--intrinsics", K, "--out", str(tmp_path / "a")]) == 0
    assert "registered 6 of 6 frames" in capsys.readouterr().out
    scene = Scene.open(tmp_path / "a")
    T = scene.T_world_cam(2)
    assert T is not None and np.allclose(T.matrix(), ring.truth[2].matrix(), atol=1e-9)


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.parametrize("use", ["keep", "refine"])
def test_known_cameras_of_the_dino_ring(use: str, test_data: Path, tmp_path: Path) -> None:
    folder = test_data / "dino_ring"
    words = ["--quiet", "import", "--color", str(folder / "*.png"), "--off-centre"]
    words += ["--cameras", str(folder / "dinoSR_par.txt"), "--cameras-use", use]
    assert main([*words, "--out", str(tmp_path / "scene")]) == 0
    scene = Scene.open(tmp_path / "scene")
    assert scene.poses is not None and all(g.passed for g in scene.poses.gates)
    errors = [p.reprojection_px for p in scene.poses.frames]
    assert len(scene.registered_frames()) == 16
    assert np.median([e for e in errors if e is not None]) < 1.0
    assert scene.camera(scene.frames[0]).fx == 3310.4
    # The camera circles at 0.65 m from the figure, which is at the origin.
    centres = np.array([p.T_world_cam for p in scene.poses.frames]).reshape(16, 4, 4)[:, :3, 3]
    assert np.allclose(np.linalg.norm(centres, axis=1), 0.65, atol=0.06)


def test_tracks_join_pairs_and_drop_contradictions() -> None:
    uv = {f: np.array([[10.0 * f, i] for i in range(3)]) for f in (3, 5, 8)}
    pairs = [
        (3, 5, np.array([[0, 0], [1, 1]])),
        (5, 8, np.array([[0, 2], [1, 1]])),
        (3, 8, np.array([[2, 1]])),  # contradicts the track of feature 1
    ]
    tracks = join_tracks(pairs, uv)
    assert len(tracks) == 1 and tracks.frame.tolist() == [3, 5, 8]
    assert tracks.uv.tolist() == [[30, 0], [50, 0], [80, 2]]
    assert len(join_tracks([], uv)) == 0


def test_error_of_tracks_is_that_of_the_pose() -> None:
    rng = np.random.default_rng(1)
    xyz = rng.uniform([-0.2, -0.2, 0.9], [0.2, 0.2, 1.1], size=(40, 3))
    poses = {i: SE3.exp([0.2 * i, 0, 0, 0, -0.1 * i, 0]) for i in range(4)}
    uv = np.stack([CAMERA.project(poses[i].inverse() @ xyz) for i in range(4)], axis=1)
    tracks = Tracks(np.tile(np.arange(4), 40), uv.reshape(-1, 2), np.arange(0, 161, 4))
    cameras = dict.fromkeys(range(4), CAMERA)
    assert tracks.errors(poses, cameras).max() < 1e-6
    # One pose turned by 2 degrees: its own features are off by 15 px, the others by nothing.
    wrong = {**poses, 2: poses[2] @ SE3.exp([0, 0, 0, 0.035, 0, 0])}
    errors = tracks.errors(wrong, cameras).reshape(40, 4)
    assert 10 < np.median(errors[:, 2]) < 20
    assert np.median(errors[:, [0, 1, 3]]) < 1e-6
    behind = {i: T @ SE3(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) for i, T in poses.items()}
    assert np.median(tracks.errors(behind, cameras)) == 1000


def test_alignment_of_poses_on_a_line() -> None:
    rng = np.random.default_rng(2)
    source = [SE3(SE3.exp(rng.normal(size=6)).R, np.array([0.1 * i, 0, 0])) for i in range(4)]
    R = SE3.exp(rng.normal(size=6)).R
    target = [SE3(R @ T.R, 2.5 * R @ T.t + [1, 2, 3]) for T in source]
    scale, T = align_poses(source, target)
    assert scale == pytest.approx(2.5)
    assert np.allclose(T.R, R) and np.allclose(T.t, [1, 2, 3])
