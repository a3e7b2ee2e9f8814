"""Wrong camera poses of single frames: named only if another pose explains more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.options import KnownCameras
from std_toolkit.poses import PoseOptions, register
from std_toolkit.poses.camera_table import FiledCameras
from std_toolkit.poses.colmap import to_colmap_camera
from std_toolkit.poses.features import describe_image, feature_path, train_vocabulary
from std_toolkit.poses.frame_check import (
    Explained,
    FrameFeatures,
    FrameVerdicts,
    add_frames,
    count_explained,
    judge_keyframes,
    points_of_others,
)
from std_toolkit.poses.known_cameras import Convention, KnownPoses
from std_toolkit.poses.pose_check import Tracks, refuse_shifted
from std_toolkit.scene import Frame
from tests.std_toolkit.poses.conftest import CAMERA, look_at

LENS = dict.fromkeys(range(8), CAMERA)
FAULTS = {
    "30 mm sideways": [0.03, 0, 0, 0, 0, 0],
    "30 mm along the view": [0, 0, 0.03, 0, 0, 0],
    "2 deg about the horizontal": [0, 0, 0, np.radians(2), 0, 0],
    "2 deg about the vertical": [0, 0, 0, 0, np.radians(2), 0],
}


def arc(count: int) -> dict[int, SE3]:
    """T_world_cam at 0.7 m around the origin, 8 degrees apart."""
    angles = np.radians(8.0 * np.arange(count))
    eyes = [np.array([0.5 * np.sin(a), -0.5 * np.cos(a), 0.5]) for a in angles]
    return {i: look_at(eye, np.zeros(3)) for i, eye in enumerate(eyes)}


def project(T_world_cam: SE3, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    return CAMERA.project(T_world_cam.inverse() @ xyz)


def tracks_of(poses: dict[int, SE3], xyz: NDArray[np.float64], noise_px: float) -> Tracks:
    """Every point seen in every frame."""
    rng = np.random.default_rng(0)
    uv = np.stack([project(T, xyz) for T in poses.values()], axis=1).reshape(-1, 2)
    uv += rng.normal(scale=noise_px, size=uv.shape)
    n = len(poses)
    return Tracks(np.tile(list(poses), len(xyz)), uv, np.arange(0, n * len(xyz) + 1, n))


@pytest.fixture
def xyz() -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.15], size=(60, 3))


def test_points_of_others_do_not_depend_on_the_pose_of_the_frame(xyz) -> None:
    truth = arc(5)
    tracks = tracks_of(truth, xyz, 0.0)
    for pose in (truth[2], truth[2] @ SE3.exp([0.3, 0, 0, 0, 0.5, 0])):
        points, uv = points_of_others(2, tracks, {**truth, 2: pose}, LENS, px=4.0)
        assert np.abs(points - xyz).max() < 1e-6
        assert np.abs(uv - project(truth[2], xyz)).max() < 1e-6


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("frame", [0, 3])
def test_one_wrong_pose_is_found(fault: str, frame: int, xyz) -> None:
    truth = arc(6)
    tracks = tracks_of(truth, xyz, 0.5)
    given = {**truth, frame: truth[frame] @ SE3.exp(FAULTS[fault])}
    explained, px = count_explained(tracks, given, LENS, px=4.0)
    suspects, verdicts = judge_keyframes(explained)
    assert px == 4.0
    assert suspects == {frame} and not verdicts.unclear
    assert explained[frame].given < 25 and explained[frame].other >= 58


def test_right_poses_are_not_accused(xyz) -> None:
    truth = arc(6)
    explained, _ = count_explained(tracks_of(truth, xyz, 0.5), truth, LENS, px=4.0)
    assert judge_keyframes(explained) == (set(), FrameVerdicts())


def test_wrong_matches_that_win_the_median_do_not_accuse_a_frame(xyz) -> None:
    """Of frame 4 three quarters of the matches are wrong, each on its own."""
    truth = arc(5)
    tracks = tracks_of(truth, xyz, 0.5)
    uv = tracks.uv.copy()
    wrong = np.flatnonzero(tracks.frame == 4)[:40]
    uv[wrong] = np.random.default_rng(3).uniform(0, 360, size=(40, 2))
    errors = Tracks(tracks.frame, uv, tracks.offsets).errors(truth, LENS)
    assert np.median(errors[tracks.frame == 4]) > 4.0
    explained, _ = count_explained(Tracks(tracks.frame, uv, tracks.offsets), truth, LENS, px=4.0)
    suspects, verdicts = judge_keyframes(explained)
    assert not suspects and not verdicts.unclear
    assert explained[4].given >= 18


def test_no_frame_is_blamed_for_errors_of_all(xyz) -> None:
    rng = np.random.default_rng(2)
    truth = arc(7)
    noisy = {
        f: T @ SE3.exp(np.concatenate([rng.normal(size=3) * 3e-3, rng.normal(size=3) * 5e-3]))
        for f, T in truth.items()
    }
    tracks = tracks_of(truth, xyz, 0.5)
    explained, px = count_explained(tracks, noisy, LENS, px=4.0)
    assert px > 4.0
    assert judge_keyframes(explained)[0] == set()
    wrong = {**noisy, 3: noisy[3] @ SE3.exp([0.1, 0, 0, 0, 0.2, 0])}
    explained, _ = count_explained(tracks, wrong, LENS, px=4.0)
    assert judge_keyframes(explained)[0] == {3}


def test_a_frame_with_few_features_cannot_be_judged(xyz) -> None:
    truth = arc(4)
    tracks = tracks_of(truth, xyz[:12], 0.3)
    suspects, verdicts = judge_keyframes(count_explained(tracks, truth, LENS, px=4.0)[0])
    assert not suspects
    assert verdicts.unclear == dict.fromkeys(range(4), "only 12 features match")
    names = {i: f"{i}.png" for i in range(4)}
    (note,) = verdicts.notes(names)
    assert note.startswith("4 frames cannot be judged, their poses are kept: 0.png (only 12 feat")


def test_limits_of_an_accusation() -> None:
    assert Explained(0, 8).contradicts and not Explained(0, 7).contradicts
    assert Explained(100, 158).contradicts and not Explained(100, 157).contradicts


def test_a_shift_of_the_list_is_named_where_frames_fail(xyz) -> None:
    rng = np.random.default_rng(4)
    truth = {f: T @ SE3.exp(rng.normal(size=6) * 0.05) for f, T in arc(8).items()}
    tracks = tracks_of(truth, xyz, 0.3)
    matrices = np.array([T.matrix() for T in truth.values()])
    for filed, row, said in (
        (matrices, {f: f for f in range(8)}, None),
        (matrices, {f: f - 1 for f in range(1, 8)}, "the pose of the next row .* late by one"),
        (matrices, {f: f + 1 for f in range(7)}, "the pose of the previous row .* early by one"),
    ):
        known = KnownPoses(
            filed=FiledCameras(path=Path("log.txt"), kind="matrices", matrices=filed),
            row=row,
            convention=Convention(),
            options=KnownCameras(),
        )
        own = tracks.among(row)
        median = float(np.median(own.errors(known.poses(), LENS)))
        if said is None:
            refuse_shifted(known, own, LENS, median)
        else:
            with pytest.raises(ToolkitError, match=said):
                refuse_shifted(known, own, LENS, median)


def save_features(folder: Path, name: str, uv: NDArray, descriptors: NDArray) -> None:
    keypoints = np.column_stack([uv, np.ones((len(uv), 2))]).astype(np.float32)
    np.savez(feature_path(folder, name), keypoints=keypoints, descriptors=descriptors)


def descriptors_of(count: int, seed: int) -> NDArray[np.uint8]:
    x = np.abs(np.random.default_rng(seed).normal(size=(count, 128)))
    return np.round(512 * x / np.linalg.norm(x, axis=1, keepdims=True)).astype(np.uint8)


class TwoBoxes:
    """Two equal boxes. Keyframes 0 to 3 see the first, 4 to 6 the second, frame 7 one of them.

    The share of the points of the second box that are in the model is `share`; `unlike` gives
    it a print of its own.
    """

    def __init__(self, folder: Path, *, share: float, unlike: bool = False) -> None:
        rng = np.random.default_rng(5)
        box = rng.uniform([-0.08, -0.08, 0], [0.08, 0.08, 0.1], size=(60, 3))
        aside = np.array([0.1, 0, 0])
        self.first, self.second = box - aside, box + aside
        xyz = np.concatenate([self.first, self.second[: round(60 * share)]])
        self.print = descriptors_of(60, 6)
        appearance = np.concatenate(
            [self.print, (descriptors_of(60, 7) if unlike else self.print)[: len(xyz) - 60]]
        )
        self.poses, self.folder = arc(8), folder
        self.model = pycolmap.Reconstruction()
        self.model.add_camera_with_trivial_rig(to_colmap_camera(CAMERA, 1))
        ids = [self.model.add_point3D(p, pycolmap.Track(), np.zeros(3, np.uint8)) for p in xyz]
        seen = [np.arange(60)] * 4 + [np.arange(60, len(xyz))] * 3
        for k, rows in enumerate(seen):
            save_features(folder, f"k{k}", project(self.poses[k], xyz[rows]), appearance[rows])
        words = train_vocabulary([appearance], seed=0)
        register.MapIndex(
            order=np.arange(7),
            names=np.array([f"k{k}" for k in range(7)]),
            offsets=np.cumsum([0, *(len(s) for s in seen)]),
            keypoint=np.concatenate([np.arange(len(s)) for s in seen]),
            point=np.concatenate(seen),
            xyz=xyz,
            point_ids=np.array(ids, dtype=np.int64),
            centres=np.array([self.poses[k].t for k in range(7)]),
            vectors=np.zeros((7, len(describe_image(self.print, words))), np.float32),
            vocabulary=words,
        ).save(folder / "index.npz")

    def judge(self, box: NDArray[np.float64], given: SE3, *, keep: bool = False) -> FrameVerdicts:
        """Verdict on a frame that sees a box with the print of the first."""
        save_features(self.folder, "f", project(self.poses[7], box), self.print)
        verdicts = FrameVerdicts()
        add_frames(
            self.model,
            [(7, Frame(id=7, name="f", color="color/f.png"))],
            {7: given},
            LENS,
            {"color": 1},
            FrameFeatures(names={7: "f"}, folder=self.folder, index=self.folder / "index.npz"),
            verdicts,
            px=4.0,
            keep_wrong=keep,
            options=PoseOptions(threads=1),
            jobs=JobOptions(engine="serial"),
        )
        return verdicts


def test_boxes_alike_are_no_accusation(tmp_path: Path) -> None:
    """Frame 7 sees the second box from its true pose; more of its features match the first."""
    scene = TwoBoxes(tmp_path, share=0.8)
    verdicts = scene.judge(scene.second, scene.poses[7])
    assert not verdicts.wrong
    assert verdicts.unclear == {7: "it explains 48 features, another pose 60"}
    image = scene.model.image(8)
    assert image.has_pose and image.num_points3D == 0
    (note,) = verdicts.notes({7: "f.png"})
    assert note.startswith("1 frames cannot be judged, their poses are kept: f.png (it explains")


def test_a_wrong_pose_of_what_is_unlike_is_an_accusation(tmp_path: Path) -> None:
    """The same with a second box of another print: then frame 7 sees the first, elsewhere."""
    scene = TwoBoxes(tmp_path, share=0.8, unlike=True)
    verdicts = scene.judge(scene.second, scene.poses[7])
    assert verdicts.wrong.keys() == {7} and not verdicts.unclear
    assert verdicts.wrong[7].given <= 5 and verdicts.wrong[7].other == 60
    assert not scene.model.exists_image(8)
    assert "f.png (explains " in verdicts.notes({7: "f.png"})[0]


def test_a_right_pose_is_added_with_its_points(tmp_path: Path) -> None:
    scene = TwoBoxes(tmp_path, share=0.8)
    verdicts = scene.judge(scene.first, scene.poses[7])
    assert verdicts == FrameVerdicts()
    assert scene.model.image(8).num_points3D == 60


def test_unchecked_poses_are_named_and_kept(tmp_path: Path) -> None:
    scene = TwoBoxes(tmp_path, share=0.8, unlike=True)
    verdicts = scene.judge(scene.second, scene.poses[7], keep=True)
    assert verdicts.wrong.keys() == {7}
    assert scene.model.image(8).has_pose and scene.model.image(8).num_points3D == 0


def test_a_frame_without_matches_cannot_be_judged(tmp_path: Path) -> None:
    scene = TwoBoxes(tmp_path, share=0.8)
    scene.print = descriptors_of(60, 99)
    assert scene.judge(scene.first, scene.poses[7]).unclear == {7: "too few features match"}
