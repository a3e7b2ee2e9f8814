"""Registration of the remaining frames: matching with the map, absolute pose, guided search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry import SE3, Camera
from std_toolkit.io.atomic import atomic_path
from std_toolkit.jobs import JobOptions, JobReport, run_jobs
from std_toolkit.poses.features import describe_image, load_features, match_descriptors
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Keyframes that a frame is matched with: nearest in time, and most similar.
NEAR_KEYFRAMES = 4
ALIKE_KEYFRAMES = 3
SEARCH_RADIUS_PX = 6.0


@dataclass(frozen=True, kw_only=True)
class RegisterSettings(Settings):
    """When a frame is registered to a model."""

    ransac_px: float = limit(6.0, unit="px", source=NOT_RECORDED)
    """largest reprojection error of an inlier of RANSAC"""
    inlier_px: float = limit(3.0, unit="px", source=NOT_RECORDED)
    """largest reprojection error of an inlier after refinement"""
    inlier_share: float = limit(0.2, source=NOT_RECORDED)
    """a pose with a smaller fraction of inliers among its matches may be due to chance"""


@dataclass(frozen=True, eq=False)
class MapIndex:
    """Triangulated features of every keyframe, for registration.

    Attributes:
        order: (K,) position of each keyframe in the recording.
        names: (K,) names of the feature files of the keyframes.
        offsets: (K + 1,) ranges of the keyframes in `keypoint` and `point`.
        keypoint: (M,) index into the features of the keyframe.
        point: (M,) row of `xyz`.
        xyz: (P, 3) points, world frame, units of the model.
        point_ids: (P,) COLMAP point ids.
        centres: (K, 3) camera centres.
        vectors: (K, V) image vectors.
        vocabulary: (W, 128) cluster centres used for the vectors.
    """

    order: NDArray[np.int64]
    names: NDArray[np.str_]
    offsets: NDArray[np.int64]
    keypoint: NDArray[np.int64]
    point: NDArray[np.int64]
    xyz: NDArray[np.float64]
    point_ids: NDArray[np.int64]
    centres: NDArray[np.float64]
    vectors: NDArray[np.float32]
    vocabulary: NDArray[np.float32]

    def save(self, path: Path) -> None:
        with atomic_path(path) as temporary:
            np.savez(temporary, **self.__dict__)

    @staticmethod
    def load(path: Path) -> MapIndex:
        with np.load(path, allow_pickle=False) as data:
            return MapIndex(**{key: data[key] for key in data.files})


@dataclass(frozen=True)
class RegistrationJob:
    """One frame to register.

    Attributes:
        name: name of its feature file.
        order: position in the recording.
        camera: intrinsics.
        given: T_cam_world to compare with the pose found, if any.
        given_px: largest error of the features that are counted for the comparison.
    """

    name: str
    order: int
    camera: Camera
    given: SE3 | None = None
    given_px: float = 0.0


@dataclass(frozen=True, eq=False)
class Registration:
    """Pose of a frame in the map.

    Attributes:
        T_cam_world: pose, units of the model.
        keypoint: (N,) inlier features of the frame.
        point_ids: (N,) id of the COLMAP point of each feature.
        explained: number of features that the given pose and this pose explain.
    """

    T_cam_world: SE3
    keypoint: NDArray[np.int64]
    point_ids: NDArray[np.int64]
    explained: tuple[int, int] = (0, 0)


def build_index(
    model: Any,
    keyframes: Sequence[tuple[int, str, int]],
    vectors: dict[int, NDArray[np.float32]],
    vocabulary: NDArray[np.float32],
) -> MapIndex:
    """Build the index of the registered keyframes of a model.

    Args:
        model: pycolmap.Reconstruction.
        keyframes: (image id, name of the feature file, position in the recording).
        vectors: image vector by image id.
        vocabulary: cluster centres used for the vectors.
    """
    point_ids = np.array(sorted(model.point3D_ids()), dtype=np.int64)
    row_of = {int(p): i for i, p in enumerate(point_ids)}
    points = model.points3D
    xyz = np.array([points[int(p)].xyz for p in point_ids]).reshape(-1, 3)
    kept = [k for k in keyframes if model.exists_image(k[0]) and model.image(k[0]).has_pose]
    offsets, keypoint, point, centres = [0], [], [], []
    for image_id, _, _ in kept:
        image = model.image(image_id)
        for i in image.get_observation_point2D_idxs():
            keypoint.append(i)
            point.append(row_of[image.points2D[i].point3D_id])
        offsets.append(len(keypoint))
        centres.append(image.projection_center())
    return MapIndex(
        order=np.array([k[2] for k in kept], dtype=np.int64),
        names=np.array([k[1] for k in kept]),
        offsets=np.array(offsets, dtype=np.int64),
        keypoint=np.array(keypoint, dtype=np.int64),
        point=np.array(point, dtype=np.int64),
        xyz=xyz,
        point_ids=point_ids,
        centres=np.array(centres).reshape(-1, 3),
        vectors=np.stack([vectors[k[0]] for k in kept]),
        vocabulary=vocabulary,
    )


def register_frames(
    jobs: Sequence[RegistrationJob],
    index_path: Path,
    features: Path,
    *,
    min_points: int,
    seed: int,
    options: JobOptions,
) -> JobReport[Registration | None]:
    """Register every frame against the saved map; None for a frame without a reliable pose.

    Args:
        jobs: the frames; their features must be in `features`.
        index_path: file written by `MapIndex.save`.
        features: folder of the feature files.
        min_points: minimum number of inliers of a registered frame.
        seed: seed of RANSAC.
        options: where the work runs.
    """
    call = partial(
        _register, index_path=index_path, features=features, min_points=min_points, seed=seed
    )
    report = run_jobs(call, list(jobs), name="register", key=lambda j: j.name, options=options)
    _load_index.cache_clear()
    _keyframe_descriptors.cache_clear()
    return report


def _register(
    job: RegistrationJob, *, index_path: Path, features: Path, min_points: int, seed: int
) -> Registration | None:
    limits = RegisterSettings.current()
    import pycolmap

    from std_toolkit.poses.colmap import from_rigid3d, to_colmap_camera, to_colmap_pixels

    index = _load_index(index_path, index_path.stat().st_mtime_ns)
    frame = load_features(features, job.name)
    uv = frame.uv
    chosen = _candidates(index, job.order, frame.descriptors)
    matches = [_match_keyframe(index, features, k, frame.descriptors) for k in chosen]
    keypoint, point = _merge(matches)
    if len(keypoint) < min_points:
        return None
    camera = to_colmap_camera(job.camera, 1)
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = limits.ransac_px
    estimation.ransac.random_seed = seed
    pixels = to_colmap_pixels(uv)
    found = pycolmap.estimate_and_refine_absolute_pose(
        pixels[keypoint], index.xyz[point], camera, estimation
    )
    if found is None or found["num_inliers"] < max(
        min_points // 2, limits.inlier_share * len(keypoint)
    ):
        return None
    pose = found["cam_from_world"]
    # The pose predicts where points rejected by the ratio test project to. Searching there doubles
    # the number of observations and spreads them over the image.
    for radius in (SEARCH_RADIUS_PX, limits.inlier_px):
        keypoint, point = _search(
            index, features, chosen, from_rigid3d(pose), job.camera, frame.descriptors, uv, radius
        )
        if len(keypoint) < min_points:
            return None
        refinement = pycolmap.AbsolutePoseRefinementOptions()
        refinement.gradient_tolerance = 1e-6
        refined = pycolmap.refine_absolute_pose(
            pose,
            pixels[keypoint],
            index.xyz[point],
            np.ones(len(keypoint), dtype=bool),
            camera,
            refinement,
        )
        if refined is None:
            return None
        pose = refined["cam_from_world"]
    T_cam_world = from_rigid3d(pose)
    error = np.linalg.norm(
        job.camera.project(T_cam_world @ index.xyz[point]) - uv[keypoint], axis=1
    )
    good = error < limits.inlier_px
    if good.sum() < min_points:
        return None
    explained = (0, 0)
    if job.given is not None:
        given, other = (
            len(
                _search(
                    index, features, chosen, T, job.camera, frame.descriptors, uv, job.given_px
                )[0]
            )
            for T in (job.given, T_cam_world)
        )
        explained = given, other
    return Registration(T_cam_world, keypoint[good], index.point_ids[point[good]], explained)


def _candidates(index: MapIndex, order: int, descriptors: NDArray[np.uint8]) -> list[int]:
    near = np.argsort(np.abs(index.order - order), kind="stable")[:NEAR_KEYFRAMES]
    vector = describe_image(descriptors, index.vocabulary)
    alike = np.argsort(-(index.vectors @ vector), kind="stable")[:ALIKE_KEYFRAMES]
    return list(dict.fromkeys([*near.tolist(), *alike.tolist()]))


@lru_cache(maxsize=2)
def _load_index(path: Path, changed: int) -> MapIndex:  # noqa: ARG001 - a new file, a new entry
    return MapIndex.load(path)


@lru_cache(maxsize=64)
def _keyframe_descriptors(features: Path, name: str) -> NDArray[np.uint8]:
    return load_features(features, name).descriptors


def _descriptors_of(index: MapIndex, features: Path, k: int) -> NDArray[np.uint8]:
    every = _keyframe_descriptors(features, str(index.names[k]))
    return every[index.keypoint[index.offsets[k] : index.offsets[k + 1]]]


def _match_keyframe(
    index: MapIndex, features: Path, k: int, descriptors: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    pairs = match_descriptors(descriptors, _descriptors_of(index, features, k))
    points = index.point[index.offsets[k] : index.offsets[k + 1]]
    return pairs[:, 0], points[pairs[:, 1]]


def _merge(
    found: Sequence[tuple[NDArray[np.int64], NDArray[np.int64]]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    both = np.concatenate([np.stack(f, axis=1) for f in found]) if found else np.zeros((0, 2), int)
    # Several keyframes may match the same point: keep one row per (feature, point).
    unique = np.unique(both, axis=0)
    return unique[:, 0], unique[:, 1]


def _search(
    index: MapIndex,
    features: Path,
    chosen: Sequence[int],
    T_cam_world: SE3,
    camera: Camera,
    descriptors: NDArray[np.uint8],
    uv: NDArray[np.float64],
    radius: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    from scipy.spatial import cKDTree

    points = np.concatenate([index.point[index.offsets[k] : index.offsets[k + 1]] for k in chosen])
    appearance = np.concatenate([_descriptors_of(index, features, k) for k in chosen])
    projected = camera.project(T_cam_world @ index.xyz[points])
    inside = (
        np.isfinite(projected).all(axis=1)
        & (projected > -0.5).all(axis=1)
        & (projected < [camera.width - 0.5, camera.height - 0.5]).all(axis=1)
    )
    rows = np.flatnonzero(inside)
    if len(rows) == 0 or len(uv) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    near = cKDTree(uv).query_ball_point(projected[rows], radius)
    row = np.repeat(rows, [len(n) for n in near])
    candidate = np.concatenate([np.asarray(n, dtype=np.int64) for n in near])
    if len(candidate) == 0:
        return candidate, candidate
    products = np.einsum(
        "ij,ij->i", appearance[row].astype(np.float32), descriptors[candidate].astype(np.float32)
    )
    angle = np.arccos(np.clip(products / 512.0**2, -1, 1))
    keep = angle < 0.5
    order = np.argsort(angle[keep], kind="stable")
    candidate, point = candidate[keep][order], points[row[keep]][order]
    # Sorted by appearance, so that each feature and each point is used once in its best match.
    _, first = np.unique(candidate, return_index=True)
    mask = np.zeros(len(candidate), dtype=bool)
    mask[first] = True
    candidate, point = candidate[mask], point[mask]
    _, first = np.unique(point, return_index=True)
    first.sort()
    return candidate[first], point[first]
