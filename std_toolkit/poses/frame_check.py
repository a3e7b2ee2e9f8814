"""Check of the known camera pose of single frames: does another pose explain more features?

Matches are verified with a fundamental matrix, and where tags or boxes repeat, wrong matches lie on
epipolar lines, too. A frame that shares little with the others has few right ones, so that the
median error of its matches says nothing about its pose. A pose is wrong only if another pose of the
frame, relative to points that the other frames determine, explains more of its features.

`count_explained` compares the two on the matches. Frames that fail there are left out of the model,
and `add_frames` compares the two again: it looks for similar features wherever each pose projects
the points of the model, unique or not. Where a pattern repeats, both poses find about as many, and
the frame cannot be judged.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from std_toolkit.arrays import Array
from std_toolkit.errors import listed
from std_toolkit.geometry import SE3, Camera
from std_toolkit.jobs import JobOptions
from std_toolkit.options import PoseOptions
from std_toolkit.poses import features, register
from std_toolkit.poses.colmap import (
    add_image,
    from_rigid3d,
    image_id_of,
    to_colmap_camera,
    to_colmap_pixels,
    to_rigid3d,
)
from std_toolkit.poses.pose_check import Tracks
from std_toolkit.scene import Frame
from std_toolkit.settings import Settings, limit

_STUDY = (
    "five subsets of 76 colour frames of a table with an AprilTag board, every third or fifth: "
    "right poses explain 0.93 to 1.04 of what the best pose explains, 749 poses 30 mm or 2 deg off "
    "at most 0.50"
)
# Enough to compare two poses; few of a long recording's tracks.
_POINTS_OF_FRAME = 300


@dataclass(frozen=True, kw_only=True)
class FrameCheckSettings(Settings):
    """When the pose of one frame is wrong, and when it cannot be judged."""

    better_factor: float = limit(1.5, source=_STUDY)
    """a pose is wrong if another explains this many times as many features"""
    fewest_more: int = limit(
        8, source="twice the 4 features of RANSAC's sample, which fit by construction"
    )
    """... and this many more"""
    usual_factor: float = limit(
        3.0,
        source="three times the usual error, as for outliers; noise of 2 mm and 0.2 deg in all 26 "
        "poses of a real recording accuses none of them",
    )
    """a feature is explained within this many times the median error of all frames, too"""
    fewest_features: int = limit(16, source="twice `fewest_more`")
    """a frame of which fewer features are explained cannot be judged"""
    smallest_angle_deg: float = limit(
        2.0,
        unit="deg",
        source="a parallax of 22 px at a focal length of 640 px: 1 px is 4.5 % of the distance",
    )
    """smallest triangulation angle of a point that tests a pose"""


@dataclass(frozen=True)
class Explained:
    """How many features of a frame two poses explain.

    Attributes:
        given: features that the given pose explains.
        other: those that the best other pose explains.
    """

    given: int
    other: int

    @property
    def contradicts(self) -> bool:
        """Whether the other pose explains more by the limits."""
        limits = FrameCheckSettings.current()
        return self.other >= limits.better_factor * self.given + limits.fewest_more

    @property
    def too_few(self) -> bool:
        return max(self.given, self.other) < FrameCheckSettings.current().fewest_features


@dataclass
class FrameVerdicts:
    """Frames whose poses are wrong or cannot be judged.

    Attributes:
        wrong: what the poses explain, by frame id.
        unclear: why a frame cannot be judged, by frame id.
    """

    wrong: dict[int, Explained] = field(default_factory=dict)
    unclear: dict[int, str] = field(default_factory=dict)

    def notes(self, names: Mapping[int, str]) -> list[str]:
        """Return sentences for the user.

        Args:
            names: file name by frame id.
        """
        found = []
        if self.wrong:
            each = [
                f"{names[f]} (explains {e.given} features, another pose {e.other})"
                for f, e in sorted(self.wrong.items())
            ]
            head = f"the pose of {len(each)} frames does not fit the others"
            found.append(f"{head}: {listed(each, 5)}")
        if self.unclear:
            each = [f"{names[f]} ({why})" for f, why in sorted(self.unclear.items())]
            head = f"{len(each)} frames cannot be judged, their poses are kept"
            found.append(f"{head}: {listed(each, 5)}")
        return found


def points_of_others(
    frame: int,
    tracks: Tracks,
    T_world_cam: Mapping[int, SE3],
    camera: Mapping[int, Camera],
    *,
    px: float,
) -> tuple[Array, Array]:
    """Triangulate the points of a frame from the other frames alone.

    Args:
        frame: frame id.
        tracks: matched features.
        T_world_cam: pose by frame id.
        camera: intrinsics by frame id.
        px: largest reprojection error in the other frames.

    Returns:
        (N, 3) points in the world and (N, 2) pixels of the frame.
    """
    options = pycolmap.EstimateTriangulationOptions()
    options.residual_type = pycolmap.TriangulationResidualType.REPROJECTION_ERROR
    options.min_tri_angle = np.radians(FrameCheckSettings.current().smallest_angle_deg)
    options.ransac.max_error = px
    options.ransac.random_seed = 0
    pixels = to_colmap_pixels(tracks.uv)
    own = np.flatnonzero(tracks.frame == frame)
    track = np.searchsorted(tracks.offsets, own, side="right") - 1
    long = np.flatnonzero(np.diff(tracks.offsets)[track] >= 3)
    long = long[np.linspace(0, len(long) - 1, min(len(long), _POINTS_OF_FRAME)).astype(int)]
    rigid: dict[int, Any] = {}
    rows, points = [], []
    for row, t in zip(own[long].tolist(), track[long].tolist(), strict=True):
        others = [i for i in range(*tracks.offsets[t : t + 2].tolist()) if i != row]
        seen = [int(tracks.frame[i]) for i in others]
        for g in set(seen) - rigid.keys():
            rigid[g] = to_rigid3d(T_world_cam[g].inverse()), to_colmap_camera(camera[g], 1)
        found = pycolmap.estimate_triangulation(
            pixels[others], [rigid[g][0] for g in seen], [rigid[g][1] for g in seen], options
        )
        if found is not None and 2 * np.count_nonzero(found["inliers"]) >= len(others):
            rows.append(row)
            points.append(found["xyz"])
    return np.array(points).reshape(-1, 3), tracks.uv[np.array(rows, dtype=np.int64)]


def count_explained(
    tracks: Tracks, T_world_cam: Mapping[int, SE3], camera: Mapping[int, Camera], *, px: float
) -> tuple[dict[int, Explained], float]:
    """Compare the pose of each frame with the best one for points of the other frames.

    Args:
        tracks: matched features.
        T_world_cam: pose by frame id.
        camera: intrinsics by frame id.
        px: largest reprojection error of a feature that is explained, at least.

    Returns:
        Counts by frame id, and the largest error that they use: where all poses are inexact, no
        frame is blamed for errors that the others have, too.
    """
    points = {f: points_of_others(f, tracks, T_world_cam, camera, px=px) for f in T_world_cam}

    def errors(f: int, T_cam_world: SE3) -> Array:
        xyz, uv = points[f]
        return np.asarray(np.linalg.norm(camera[f].project(T_cam_world @ xyz) - uv, axis=1))

    given = {f: errors(f, T.inverse()) for f, T in T_world_cam.items()}
    medians = [np.median(np.nan_to_num(e, nan=np.inf)) for e in given.values() if len(e)]
    if medians and np.isfinite(usual := float(np.median(medians))):
        px = max(px, FrameCheckSettings.current().usual_factor * usual)
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = px
    options.ransac.random_seed = 0
    result = {}
    for f, (xyz, uv) in points.items():
        count = int((given[f] <= px).sum())
        best = count
        if len(xyz) >= 4:
            lens = to_colmap_camera(camera[f], 1)
            found = pycolmap.estimate_and_refine_absolute_pose(
                to_colmap_pixels(uv), xyz, lens, options
            )
            if found is not None:
                best = int((errors(f, from_rigid3d(found["cam_from_world"])) <= px).sum())
        result[f] = Explained(count, best)
    return result, px


def judge_keyframes(explained: Mapping[int, Explained]) -> tuple[set[int], FrameVerdicts]:
    """Return the frames that `add_frames` has to judge, and verdicts on the others."""
    suspects = {f for f, e in explained.items() if e.contradicts}
    verdicts = FrameVerdicts()
    for f, e in explained.items():
        if f not in suspects and e.too_few:
            verdicts.unclear[f] = f"only {e.given} features match"
    return suspects, verdicts


@dataclass(frozen=True, kw_only=True)
class FrameFeatures:
    """Where the features and the index of the model are.

    Attributes:
        names: name of the feature file by frame id.
        folder: folder of these files.
        index: file of the `register.MapIndex`.
    """

    names: Mapping[int, str]
    folder: Path
    index: Path


def add_frames(
    model: Any,
    rest: Iterable[tuple[int, Frame]],
    poses: Mapping[int, SE3],
    lens: Mapping[int, Camera],
    camera_ids: Mapping[str, int],
    files: FrameFeatures,
    verdicts: FrameVerdicts,
    *,
    px: float,
    keep_wrong: bool,
    options: PoseOptions,
    jobs: JobOptions,
) -> None:
    """Judge the given poses of frames that the model lacks, and add the frames to the model.

    A frame whose pose cannot be judged is added without points.

    Args:
        model: pycolmap.Reconstruction; changed in place.
        rest: the frames with their positions in the recording.
        poses: given T_world_cam by frame id.
        lens: intrinsics by frame id.
        camera_ids: COLMAP camera id by camera key.
        files: features and index.
        verdicts: receives the verdicts.
        px: largest reprojection error of a feature that is explained.
        keep_wrong: whether frames whose pose is wrong are added.
        options: options of the step.
        jobs: where the work runs.

    Raises:
        ToolkitError: features cannot be read.
    """
    rest = list(rest)
    report = register.register_frames(
        [
            register.RegistrationJob(
                files.names[f.id], order, lens[f.id], poses[f.id].inverse(), px
            )
            for order, f in rest
        ],
        files.index,
        files.folder,
        min_points=options.min_points,
        seed=options.seed,
        options=jobs,
    )
    report.raise_if_failed()
    for _, frame in rest:
        found: register.Registration | None = report.results[files.names[frame.id]]
        uv: Array = np.zeros((0, 2))
        ids = np.zeros(0, dtype=np.int64)
        if found is None:
            verdicts.unclear[frame.id] = "too few features match"
        else:
            seen = features.load_features(files.folder, files.names[frame.id]).uv[found.keypoint]
            xyz = np.array([model.point3D(int(p)).xyz for p in found.point_ids])
            local = poses[frame.id].inverse() @ xyz
            explained = Explained(*found.explained)
            # The matches are those of a pose of their own, so they test the given one.
            error = float(np.median(np.linalg.norm(lens[frame.id].project(local) - seen, axis=1)))
            if error <= px:
                uv, ids = seen, found.point_ids
            elif explained.contradicts:
                verdicts.wrong[frame.id] = explained
                if not keep_wrong:
                    continue
            else:
                verdicts.unclear[frame.id] = (
                    f"it explains {explained.given} features, another pose {explained.other}"
                )
        add_image(
            model,
            image_id=image_id_of(frame),
            name=frame.color,
            camera_id=camera_ids[frame.camera],
            T_cam_world=poses[frame.id].inverse(),
            uv=uv,
            point_ids=ids,
        )
