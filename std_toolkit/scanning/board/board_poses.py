"""Camera poses of photos in the frame of a printed board: corners and features in one adjustment.

The corners of the board are fixed points of known size, so poses and intrinsics are metric and in
the frame of the board. On a turntable, the board turns with the object: features of the static
background contradict the board and are left out.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.jobs import JobOptions
from std_toolkit.log import logger
from std_toolkit.poses.board_scale import BoardDetection
from std_toolkit.scanning.board.board_adjustment import PosedPhotos, adjust, build_model
from std_toolkit.scanning.board.board_photos import BoardPhotoSettings, PhotoCameras, board_pose
from std_toolkit.scanning.board.object_checks import check_rest

# Angle between viewing directions up to which photos are matched.
_MATCHED_DEG = 40.0
_MATCHES_PER_PHOTO = 8


def pose_photos(
    paths: Sequence[Path],
    found: Sequence[BoardDetection],
    cameras: PhotoCameras,
    work: Path,
    *,
    jobs: JobOptions,
    max_features: int,
) -> PosedPhotos:
    """Poses of the photos in the frame of the board, and refined intrinsics.

    Args:
        paths: the photos.
        found: the board in each.
        cameras: intrinsics to begin with.
        work: folder for features and matches.
        jobs: where features are extracted.
        max_features: number of features per photo.

    Raises:
        ToolkitError: too few photos have a pose, or the object moved.
    """
    start, placed = board_starts(found, cameras)
    if len(start) < BoardPhotoSettings.current().fewest_photos:
        raise ToolkitError(f"the board gives a pose in {len(start)} of {len(paths)} photos")
    uv, pairs = _matches(paths, start, cameras, work, jobs, max_features)
    plane = np.concatenate([f.xyz[:, :2] for f in placed])
    check_rest(
        pairs, uv, start, cameras, [p.name for p in paths],
        reach=(plane.min(axis=0), plane.max(axis=0)),
    )  # fmt: skip
    model = build_model(paths, start, placed, uv, pairs, cameras)
    return adjust(model, placed, cameras.groups)


def board_starts(
    found: Sequence[BoardDetection], cameras: PhotoCameras
) -> tuple[dict[int, SE3], list[BoardDetection]]:
    """T_world_cam by index of the photos in which the board alone gives a pose, and all detections
    with their corners in that world: the frame of the board, z up."""
    start: dict[int, SE3] = {}
    for i, f in enumerate(found):
        camera = cameras.of(i)
        pose = board_pose(f, camera)
        # Corners that a plane does not explain are misread tags.
        if pose is not None and pose[1] < 0.01 * max(camera.size):
            start[i] = pose[0].inverse()
    if not start:
        return {}, list(found)
    # The board's z axis points into the table where its file has y downwards.
    up = float(np.median([T.t[2] for T in start.values()])) > 0
    turn = SE3(np.eye(3) if up else np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    return {i: turn @ T for i, T in start.items()}, [replace(f, xyz=turn @ f.xyz) for f in found]


def _matches(
    paths: Sequence[Path],
    poses: dict[int, SE3],
    cameras: PhotoCameras,
    work: Path,
    jobs: JobOptions,
    max_features: int,
) -> tuple[dict[int, NDArray[np.float64]], list[tuple[int, int, Any]]]:
    """Feature pixels by photo and verified matches (photo, photo, (M, 2) indices)."""
    import shutil

    from std_toolkit.options import PoseOptions
    from std_toolkit.poses.features import FeatureJob, extract_features, load_features
    from std_toolkit.poses.mapping import MappingImage, match_keyframes
    from std_toolkit.poses.small_sets import verified_matches

    folder = work / "features"
    names = [f"{i:04d}" for i in range(len(paths))]
    extract_features(
        [FeatureJob(n, p, cameras.of(i).size, False)
         for i, (n, p) in enumerate(zip(names, paths, strict=True))],
        folder,
        max_features=max_features,
        options=jobs,
    )  # fmt: skip
    images = [
        MappingImage(
            image_id=i + 1,
            name=n,
            camera=f"photo {cameras.groups[i]}",
            features=partial(load_features, folder, n),
        )
        for i, n in enumerate(names)
    ]
    pairs = _pairs(len(paths), poses)
    logger.info("camera poses: matching %d pairs of photos", len(pairs))
    matching = work / "matching"
    shutil.rmtree(matching, ignore_errors=True)
    matching.mkdir(parents=True)
    named = {f"photo {n}": camera for n, camera in enumerate(cameras.cameras)}
    database, _ = match_keyframes(images, pairs, named, matching, options=PoseOptions())
    found = [(a - 1, b - 1, m) for a, b, m in verified_matches(database)]
    shutil.rmtree(matching, ignore_errors=True)
    return {i: load_features(folder, n).uv for i, n in enumerate(names)}, found


def _pairs(count: int, poses: dict[int, SE3]) -> list[tuple[int, int]]:
    """Pairs of photos from similar directions; those without a pose with their neighbours."""
    chosen: set[tuple[int, int]] = set()
    known = sorted(poses)
    axes = np.stack([poses[i].R[:, 2] for i in known])
    places = np.stack([poses[i].t for i in known])
    angle = np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1)))
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    for n, i in enumerate(known):
        order = [m for m in np.argsort(apart[n]) if m != n and angle[n, m] < _MATCHED_DEG]
        chosen |= {(min(i, known[m]), max(i, known[m])) for m in order[:_MATCHES_PER_PHOTO]}
    for i in set(range(count)) - set(known):
        near = sorted(known, key=lambda j: abs(j - i))[:_MATCHES_PER_PHOTO]
        chosen |= {(min(i, j), max(i, j)) for j in near}
    return sorted(chosen)
