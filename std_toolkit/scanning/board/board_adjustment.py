"""Corners of a printed board and features of the photos in one bundle adjustment.

The corners are fixed points of known size, so poses and intrinsics are metric and in the frame of
the board. Features that contradict the board are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.poses.board_scale import BoardDetection
from std_toolkit.scanning.board.board_photos import BoardPhotoSettings, PhotoCameras
from std_toolkit.settings import NOT_RECORDED, Settings, limit

_MOST_TRACKS = 15_000
# A corner, the meeting of two fitted edges, is about a fifth as far off as a feature: its square
# counts as that of many.
_CORNER_WEIGHT = 20
# Cameras whose focal lengths differ less have square pixels.
_SQUARE = 0.005


@dataclass(frozen=True, kw_only=True)
class BoardAdjustmentSettings(Settings):
    """Features, corners and photos that the adjustment keeps."""

    largest_error_px: float = limit(4.0, unit="px", source=NOT_RECORDED)
    """a feature that no pose by the board explains within this is not at rest relative to the
    board"""
    fewest_points: int = limit(20, source=NOT_RECORDED)
    """points that a photo without corners needs"""
    false_ratio: float = limit(6.0, source="corners seen through glass or in a mirror")
    """a corner is false if its error exceeds this multiple of the median error"""
    largest_residual: float = limit(
        0.0015, source="rendered photos of one lens have 0.0002 of the longer side"
    )
    """median error of the corners of a photo, in parts of the longer side, that is too large"""
    false_px: float = limit(0.3, unit="px", source=NOT_RECORDED)
    """and this many pixels"""


@dataclass(frozen=True, eq=False)
class PosedPhotos:
    """Photos with poses in the frame of the board, z up.

    Attributes:
        cameras: intrinsics of each group of photos.
        poses: T_world_cam by index of the photo; photos without a pose are missing.
        corners: (M, 3) corners of the board in the world, metres.
        ids: (M,) their ids.
        corner_rms_px: root mean square reprojection error of the corners that are not false.
        feature_rms_px: the same of the features; NaN without features.
        scale_deviation: relative difference of the size of the board that the features imply.
        points: (N, 3) triangulated features.
    """

    cameras: tuple[Camera, ...]
    poses: dict[int, SE3]
    corners: NDArray[np.float64]
    ids: NDArray[np.int64]
    corner_rms_px: float
    feature_rms_px: float
    scale_deviation: float
    points: NDArray[np.float64]


def build_model(
    paths: Sequence[Path],
    poses: dict[int, SE3],
    found: Sequence[BoardDetection],
    uv: dict[int, NDArray[np.float64]],
    pairs: list[tuple[int, int, Any]],
    cameras: PhotoCameras,
) -> Any:
    """pycolmap.Reconstruction of the corners and of the features that the board explains."""
    import pycolmap

    from std_toolkit.poses.colmap import to_colmap_pixels, to_rigid3d
    from std_toolkit.poses.pose_check import join_tracks

    tracks = join_tracks(pairs, uv)
    poses = dict(poses)
    poses.update(_further_poses(tracks, poses, cameras))
    model = pycolmap.Reconstruction()
    for n, camera in enumerate(cameras.cameras):
        model.add_camera_with_trivial_rig(_free_camera(camera, n + 1))
    chosen = _triangulated(tracks, poses, cameras)
    pixels: dict[int, list[Any]] = {i: _CORNER_WEIGHT * list(found[i].uv) for i in poses}
    at: list[tuple[Any, list[Any]]] = [(xyz, []) for xyz, _, _ in chosen]
    for n, (_, frames, seen) in enumerate(chosen):
        for f, p in zip(frames, seen, strict=True):
            at[n][1].append((int(f), len(pixels[int(f)])))
            pixels[int(f)].append(p)
    for i in sorted(poses):
        image = pycolmap.Image(
            name=paths[i].name,
            keypoints=to_colmap_pixels(np.array(pixels[i]).reshape(-1, 2)),
            camera_id=cameras.groups[i] + 1,
            image_id=i + 1,
        )
        model.add_image_with_trivial_frame(image, to_rigid3d(poses[i].inverse()))
    corners: dict[tuple[int, int], tuple[Any, Any]] = {}
    for i in sorted(poses):
        count = len(found[i].ids)
        # An observation has no weight of its own: it is repeated.
        for n in range(_CORNER_WEIGHT * count):
            key = n // count, int(found[i].ids[n % count])
            corners.setdefault(key, (found[i].xyz[n % count], []))[1].append((i, n))
    for xyz, places in [*corners.values(), *at]:
        track = pycolmap.Track()
        for i, n in places:
            track.add_element(i + 1, n)
        model.add_point3D(np.asarray(xyz, np.float64), track, np.zeros(3, np.uint8))
    return model


def _free_camera(camera: Camera, number: int) -> Any:
    """pycolmap.Camera to adjust: with square pixels, one focal length and radial distortion.

    More parameters fit the noise of corners on one plane, and change the size of what stands on it.
    """
    import pycolmap

    from std_toolkit.poses.colmap import to_colmap_camera

    k = camera.opencv_distortion
    if len(camera.distortion) > 4 or abs(camera.fx / camera.fy - 1) > _SQUARE:
        return to_colmap_camera(camera, number, distorted=True)
    plain = to_colmap_camera(camera.without_distortion(), number)
    fx, fy, cx, cy = plain.params
    return pycolmap.Camera(
        camera_id=number, model="RADIAL", width=camera.width, height=camera.height,
        params=[(fx + fy) / 2, cx, cy, *k[:2]], has_prior_focal_length=True,
    )  # fmt: skip


def _triangulated(
    tracks: Any, poses: dict[int, SE3], cameras: PhotoCameras
) -> list[tuple[NDArray[np.float64], Any, Any]]:
    """(point, photos, pixels) of the tracks that the poses explain, longest first."""
    P = {i: T.inverse().matrix()[:3] for i, T in poses.items()}
    found = []
    for a, b in zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True):
        frames = tracks.frame[a:b]
        kept = np.array([f in poses for f in frames])
        if kept.sum() < 2:
            continue
        frames, uv = frames[kept], tracks.uv[a:b][kept]
        # Most tracks are of one camera, whose pixels are unprojected together.
        of = {g: np.flatnonzero([cameras.groups[f] == g for f in frames])
              for g in {cameras.groups[f] for f in frames}}  # fmt: skip
        xy = np.empty((len(uv), 2))
        for g, part in of.items():
            xy[part] = cameras.cameras[g].unproject(uv[part])[:, :2]
        if not np.isfinite(xy).all():
            continue
        rows = np.concatenate(
            [[x * P[f][2] - P[f][0], y * P[f][2] - P[f][1]]
             for f, (x, y) in zip(frames.tolist(), xy, strict=True)]
        )  # fmt: skip
        h = np.linalg.svd(rows)[2][-1]
        if abs(h[3]) < 1e-12:
            continue
        X = h[:3] / h[3]
        local = np.stack([P[f] @ [*X, 1.0] for f in frames.tolist()])
        if (local[:, 2] < 0.02).any():
            continue
        error = np.empty(len(uv))
        for g, part in of.items():
            off = cameras.cameras[g].project(local[part]) - uv[part]
            error[part] = np.linalg.norm(off, axis=1)
        if not (error < BoardAdjustmentSettings.current().largest_error_px).all():
            continue
        found.append((X, frames, uv))
    found.sort(key=lambda t: -len(t[1]))
    return found[:_MOST_TRACKS]


def _further_poses(tracks: Any, poses: dict[int, SE3], cameras: PhotoCameras) -> dict[int, SE3]:
    """Poses of photos without the board, from features that photos with a pose triangulate."""
    limits = BoardAdjustmentSettings.current()
    import pycolmap

    from std_toolkit.poses.colmap import from_rigid3d, to_colmap_camera, to_colmap_pixels

    missing = {int(f) for f in np.unique(tracks.frame)} - set(poses)
    if not missing:
        return {}
    pixels: dict[int, list[Any]] = {i: [] for i in missing}
    points: dict[int, list[Any]] = {i: [] for i in missing}
    for a, b in zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True):
        new = [n for n in range(a, b) if int(tracks.frame[n]) in missing]
        if not new or b - a - len(new) < 2:
            continue
        one = replace(
            tracks, frame=tracks.frame[a:b], uv=tracks.uv[a:b], offsets=np.array([0, b - a])
        )
        for X, _, _ in _triangulated(one, poses, cameras):
            for n in new:
                pixels[int(tracks.frame[n])].append(tracks.uv[n])
                points[int(tracks.frame[n])].append(X)
    found = {}
    for i in missing:
        if len(points[i]) < limits.fewest_points:
            continue
        estimation = pycolmap.AbsolutePoseEstimationOptions()
        estimation.ransac.max_error = 4.0
        estimation.ransac.random_seed = 0
        result = pycolmap.estimate_and_refine_absolute_pose(
            to_colmap_pixels(np.array(pixels[i])), np.array(points[i]),
            to_colmap_camera(cameras.of(i), 1), estimation,
        )  # fmt: skip
        if result is not None and result["num_inliers"] >= max(
            limits.fewest_points, 0.4 * len(points[i])
        ):
            found[i] = from_rigid3d(result["cam_from_world"]).inverse()
    return found


def adjust(
    model: Any, found: Sequence[BoardDetection], groups: Sequence[int] | None = None
) -> PosedPhotos:
    """Adjust poses, intrinsics and features; the corners are fixed and weigh more.

    Args:
        model: of `build_model`.
        found: corners of each photo.
        groups: number of the camera of each photo; None if all have one.

    Raises:
        ToolkitError: the cameras do not explain the corners of some photos.
    """
    import pycolmap

    from std_toolkit.options import Refinement
    from std_toolkit.poses.colmap import from_colmap_camera, from_rigid3d, quiet_colmap
    from std_toolkit.poses.mapping import adjustment_options

    corners = {tuple(np.round(x, 9)) for f in found for x in f.xyz}
    fixed = {i for i in model.point3D_ids() if tuple(np.round(model.point3D(i).xyz, 9)) in corners}
    options = adjustment_options(refine=Refinement.DISTORTION, threads=None)
    options.ceres.loss_function_scale = 1.5
    options.ceres.solver_options.max_num_iterations = 60
    with quiet_colmap():
        # False corners bend the camera, which hides the lesser ones among them.
        for n in range(4):
            config = pycolmap.BundleAdjustmentConfig()
            for i in model.reg_image_ids():
                config.add_image(i)
            for p in fixed:
                if model.exists_point3D(p):
                    config.add_constant_point(p)
            pycolmap.create_default_bundle_adjuster(options, config, model).solve()
            dropped = _drop_false_corners(model, fixed)
            _drop_outliers(model, fixed)
            if n > 0 and not dropped:
                break
        model.update_point_3d_errors()
    count = 1 if groups is None else max(groups) + 1
    try:
        adjusted = tuple(from_colmap_camera(model.camera(n + 1)) for n in range(count))
    except ToolkitError as error:
        raise error.revised(
            problem=f"the board does not determine the intrinsics: {error.problem}",
            hint="give --intrinsics, or photograph the board from two heights with one lens",
        ) from error
    cameras = PhotoCameras(adjusted, tuple(groups or (0,) * len(found)))
    poses = {i - 1: from_rigid3d(model.image(i).cam_from_world()).inverse()
             for i in sorted(model.reg_image_ids())}  # fmt: skip
    of = {
        i: np.linalg.norm(cameras.of(i).project(T.inverse() @ found[i].xyz) - found[i].uv, axis=1)
        for i, T in poses.items() if len(found[i].ids)
    }  # fmt: skip
    names = {i: model.image(i + 1).name for i in of}
    _check_residual(of, names, max(max(c.size) for c in cameras.cameras))
    r = list(of.values())
    errors = np.concatenate(r) if r else np.zeros(1)
    errors = errors[errors <= _largest_error(errors)]
    ids = [p for p in model.point3D_ids() if p not in fixed]
    points = np.array([model.point3D(p).xyz for p in ids]).reshape(-1, 3)
    squares = np.array([model.point3D(p).error for p in ids])
    every, places = np.unique(np.concatenate([f.ids for f in found]), return_index=True)
    return PosedPhotos(
        cameras=cameras.cameras,
        poses=poses,
        corners=np.concatenate([f.xyz for f in found])[places].reshape(-1, 3),
        ids=every,
        corner_rms_px=float(np.sqrt((errors**2).mean())) if r else float("nan"),
        feature_rms_px=float(np.sqrt((squares**2).mean())) if len(squares) else float("nan"),
        scale_deviation=_scale_deviation(poses, found, cameras),
        points=points,
    )


def _check_residual(
    errors: dict[int, NDArray[np.float64]], names: dict[int, str], longest: int
) -> None:
    """Raise an error if the corners of all photos do not fit, with the photos that fit worst."""
    median = {i: float(np.median(e)) for i, e in errors.items()}
    most = BoardAdjustmentSettings.current().largest_residual * longest
    worst = sorted((i for i in median if median[i] > most), key=lambda i: -median[i])
    if len(worst) > 2 and len(worst) > len(median) / 10:
        raise ToolkitError(
            f"one camera does not explain the board in {len(worst)} of {len(median)} photos "
            f"within {most:.1f} px: " + ", ".join(names[i] for i in worst[:8]),
            value=f"{max(median.values()):.1f} px",
            hint="were they taken with another zoom or lens, or stabilised or cropped? Take them "
            "out. Does the sheet lie flat, and does the board file describe it?",
        )


def _drop_false_corners(model: Any, fixed: set[int]) -> int:
    """Remove observations of corners that are much farther off than most; returns their number.

    The corners of a photo of which most are far off stay: there the pose is not found yet.
    """
    import pycolmap

    error: dict[int, NDArray[np.float64]] = {}
    index: dict[int, NDArray[np.int64]] = {}
    for i in model.reg_image_ids():
        image = model.image(i)
        seen = [
            (n, p.xy, p.point3D_id) for n, p in enumerate(image.points2D) if p.point3D_id in fixed
        ]
        if not seen:
            continue
        xyz = np.stack([model.point3D(p).xyz for _, _, p in seen])
        uv = model.camera(image.camera_id).img_from_cam(image.cam_from_world() * xyz)
        error[i] = np.linalg.norm(np.asarray(uv) - np.stack([xy for _, xy, _ in seen]), axis=1)
        index[i] = np.array([n for n, _, _ in seen])
    if not error:
        return 0
    limit = _largest_error(np.concatenate(list(error.values())))
    manager = pycolmap.ObservationManager(model)
    dropped = 0
    for i, e in error.items():
        false = index[i][e > limit]
        if 2 * len(false) > len(e):
            continue
        for n in false.tolist():
            if model.image(i).point2D(n).has_point3D():  # not deleted with another one
                manager.delete_observation(i, n)
        dropped += len(false)
    return dropped


def _largest_error(errors: NDArray[np.float64]) -> float:
    """Error in pixels from which a corner is false, by the errors (N,) of all corners."""
    limits = BoardAdjustmentSettings.current()
    return max(limits.false_px, limits.false_ratio * float(np.median(errors)))


def _drop_outliers(model: Any, fixed: set[int]) -> None:
    import pycolmap

    manager = pycolmap.ObservationManager(model)
    free = set(model.point3D_ids()) - fixed
    manager.filter_points3D_with_large_reprojection_error(2.0, free)
    # A corner that is misread in one photo must not be lost in the others.
    manager.filter_observations_with_negative_depth()


def _scale_deviation(
    poses: dict[int, SE3], found: Sequence[BoardDetection], cameras: PhotoCameras
) -> float:
    """Half the spread of the scale between halves of the photos, relative: its uncertainty."""
    limits = BoardPhotoSettings.current()
    from std_toolkit.poses.known_points import KnownView, scale_from_known_points

    views = [
        KnownView(T_cam_world=poses[i].inverse(), camera=cameras.of(i), ids=found[i].ids,
                  xyz=found[i].xyz, uv=found[i].uv)
        for i in poses if len(found[i].ids) >= limits.fewest_corners
    ]  # fmt: skip
    views = views[:: max(1, len(views) // 12)]
    if len(views) < limits.fewest_photos:
        return float("nan")
    try:
        estimate = scale_from_known_points(views, source="board", note="", threshold_m=0.02)
    except ToolkitError:
        return float("nan")
    return float(np.hypot(estimate.standard_error, estimate.factor - 1))
