"""Mapping of the keyframes with COLMAP: verified matching, mapping, bundle adjustment."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import Camera
from std_toolkit.jobs.memory import return_free_memory
from std_toolkit.log import logger
from std_toolkit.options import Mapper, PoseOptions, Refinement
from std_toolkit.poses.colmap import (
    quiet_colmap,
    to_colmap_camera,
    to_colmap_pixels,
)
from std_toolkit.poses.features import Features
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# From this number of images the conjugate gradient method is faster than a factorisation.
_DIRECT_IMAGES = 150
# Pairs that are matched at a time; COLMAP's default is 1225. Neighbours share their images.
_BLOCK_PAIRS = 100


@dataclass(frozen=True, kw_only=True)
class MappingSettings(Settings):
    """Points that a reconstruction keeps."""

    largest_error_px: float = limit(4.0, unit="px", source="those on moving people are far above")
    """points with a larger reprojection error are removed"""
    wide_angle_deg: float = limit(1.5, unit="deg", source=NOT_RECORDED)
    """points seen under a smaller angle are removed"""
    fewest_wide_points: int = limit(80, source=NOT_RECORDED)
    """an image with fewer wide-angle points also keeps its other points"""
    short_sweep_share: float = limit(0.3, source=NOT_RECORDED)
    """wide-angle limit on a short sweep, as a fraction of the angle that a quarter of the
    points reach"""

    many_images: int = limit(150, source="275 keyframes: mapping took 901 s, then 151 s")
    """from this number of images on, the growing model is adjusted less often"""


@dataclass(frozen=True, kw_only=True)
class MappingImage:
    """One keyframe to map.

    Attributes:
        image_id: COLMAP image id, at least 1.
        name: unique name.
        camera: camera key.
        features: reads the features of the image; those of all images would take much memory.
    """

    image_id: int
    name: str
    camera: str
    features: Callable[[], Features]


@dataclass(frozen=True)
class Mapping:
    """Result of `map_keyframes`.

    Attributes:
        model: largest pycolmap.Reconstruction.
        camera_ids: COLMAP camera id by camera key.
        other_sizes: number of images in each smaller model, in descending order.
    """

    model: Any
    camera_ids: dict[str, int]
    other_sizes: list[int] = field(default_factory=list)


def map_keyframes(
    images: Sequence[MappingImage],
    pairs: Sequence[tuple[int, int]],
    cameras: dict[str, Camera],
    work: Path,
    *,
    options: PoseOptions,
) -> Mapping:
    """Match the pairs of keyframes, verify the matches geometrically and map.

    Args:
        images: the keyframes in recording order.
        pairs: indices into `images`.
        cameras: intrinsics by camera key.
        work: empty folder for the database; the caller removes it.
        options: options of the pose step.

    Raises:
        ToolkitError: no two keyframes fit together.
    """
    database, camera_ids = match_keyframes(images, pairs, cameras, work, options=options)
    ranked = map_database(database, work, options=options)
    if not ranked:
        raise ToolkitError(
            "structure from motion found no two keyframes that fit together",
            hint="record with more overlap, more texture in view and less motion blur",
        )
    others = [m.num_reg_images() for m in ranked[-2::-1]]
    if others:
        logger.warning(
            "the keyframes are split into %d models; the largest has %d images, the others %s",
            len(ranked),
            ranked[-1].num_reg_images(),
            others,
        )
    return Mapping(ranked[-1], camera_ids, others)


def match_keyframes(
    images: Sequence[MappingImage],
    pairs: Sequence[tuple[int, int]],
    cameras: dict[str, Camera],
    work: Path,
    *,
    options: PoseOptions,
) -> tuple[Path, dict[str, int]]:
    """Match the pairs of keyframes and verify the matches; arguments as of `map_keyframes`.

    Returns:
        The database in `work`, and the COLMAP camera id by camera key.
    """
    camera_ids = {key: i for i, key in enumerate(sorted(cameras), start=1)}
    distorted = options.refine is Refinement.DISTORTION
    database = work / "database.db"
    with quiet_colmap():
        pycolmap.set_random_seed(options.seed)
        _write_database(database, images, cameras, camera_ids, distorted=distorted)
        _match(database, images, pairs, work, threads=_threads(options), seed=options.seed)
    return_free_memory()
    return database, camera_ids


def map_database(database: Path, work: Path, *, options: PoseOptions) -> list[Any]:
    """Map the verified matches of a database.

    Args:
        database: database of `match_keyframes`.
        work: folder for the models, which must not have any yet.
        options: options of the pose step.

    Returns:
        The models of two or more images; the largest is the last.
    """
    with quiet_colmap():
        pycolmap.set_random_seed(options.seed)
        models = _map(database, work, options, _threads(options))
    return_free_memory()
    ranked = sorted(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()))
    return [m for m in ranked if m.num_reg_images() >= 2]


def _threads(options: PoseOptions) -> int:
    return -1 if options.threads is None else options.threads


def adjust(
    model: Any, *, refine: Refinement, threads: int | None, min_angle_deg: float | None = None
) -> None:
    """Run bundle adjustment of the model twice and remove bad observations after each run.

    Args:
        model: pycolmap.Reconstruction; changed in place.
        refine: intrinsics to refine.
        threads: number of solver threads; None: all cores.
        min_angle_deg: keep only points with at least this triangulation angle, see
            `keep_wide_points`.
    """
    limits = MappingSettings.current()
    options = adjustment_options(refine=refine, threads=threads)
    with quiet_colmap():
        if min_angle_deg is not None:
            keep_wide_points(model, min_angle_deg=min_angle_deg)
        for _ in range(2):
            pycolmap.bundle_adjustment(model, options)
            manager = pycolmap.ObservationManager(model)
            manager.filter_all_points3D(limits.largest_error_px, limits.wide_angle_deg)
            return_free_memory()
        model.update_point_3d_errors()


def adjustment_options(*, refine: Refinement, threads: int | None) -> Any:
    """Return the pycolmap.BundleAdjustmentOptions of `adjust`."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = refine is not Refinement.NONE
    options.refine_principal_point = refine in (Refinement.INTRINSICS, Refinement.DISTORTION)
    options.refine_extra_params = refine is Refinement.DISTORTION
    options.print_summary = False
    # The Huber loss is least squares for good observations and limits the effect of outliers.
    options.ceres.loss_function_type = pycolmap.LossFunctionType.HUBER
    options.ceres.loss_function_scale = 3.0
    options.ceres.use_gpu = False
    # A direct solver takes memory with the square and time with the cube of the number of images.
    options.ceres.max_num_images_direct_sparse_cpu_solver = _DIRECT_IMAGES
    options.ceres.solver_options.max_num_iterations = 200
    options.ceres.solver_options.function_tolerance = 1e-9
    options.ceres.solver_options.num_threads = -1 if threads is None else threads
    return options


def keep_wide_points(model: Any, *, min_angle_deg: float) -> None:
    """Remove points with a small triangulation angle, except where an image needs them.

    The camera circles the tabletop, so points there have wide angles. Points with small angles are
    the background: people walk there, and at its distance the error of the lens model exceeds the
    parallax. On a real recording with an unmodelled distortion, removing them made the camera
    positions 10 % more accurate. On a short sweep all angles are small, and the background has
    much smaller ones than the rest.

    Args:
        model: pycolmap.Reconstruction; changed in place.
        min_angle_deg: lower limit of the largest angle between two rays to a point; reduced to
            `short_sweep_share` of the angle that a quarter of the points reach, if that is less.
    """
    limits = MappingSettings.current()
    min_angle_deg = min(min_angle_deg, limits.short_sweep_share * _wide_angle(model))
    trial = pycolmap.Reconstruction(model)
    every = set(trial.point3D_ids())
    pycolmap.ObservationManager(trial).filter_points3D_with_small_triangulation_angle(
        min_angle_deg, every
    )
    needed: set[int] = set()
    for image_id in model.reg_image_ids():
        if trial.image(image_id).num_points3D < limits.fewest_wide_points:
            image = model.image(image_id)
            needed.update(
                image.points2D[i].point3D_id for i in image.get_observation_point2D_idxs()
            )
    pycolmap.ObservationManager(model).filter_points3D_with_small_triangulation_angle(
        min_angle_deg, every - needed
    )


def _wide_angle(model: Any) -> float:
    """Triangulation angle in degrees that a quarter of the points reach."""
    centres = {i: model.image(i).projection_center() for i in model.reg_image_ids()}
    ids = sorted(model.point3D_ids())
    widest = []
    for point_id in ids[:: max(1, len(ids) // 1000)]:
        point = model.point3D(point_id)
        rays = np.array([centres[e.image_id] for e in point.track.elements]) - point.xyz
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        widest.append(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
    return float(np.percentile(widest, 75)) if widest else 0.0


def _write_database(
    path: Path,
    images: Sequence[MappingImage],
    cameras: dict[str, Camera],
    camera_ids: dict[str, int],
    *,
    distorted: bool,
) -> None:
    with pycolmap.Database.open(path) as database:
        for key in sorted(cameras):
            camera = to_colmap_camera(cameras[key], camera_ids[key], distorted=distorted)
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera_ids[key])
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for image in images:
            camera_id = camera_ids[image.camera]
            entry = pycolmap.Image(name=image.name, camera_id=camera_id, image_id=image.image_id)
            frame = pycolmap.Frame(frame_id=image.image_id, rig_id=camera_id)
            frame.add_data_id(entry.data_id)
            database.write_frame(frame, use_frame_id=True)
            entry.frame_id = image.image_id
            database.write_image(entry, use_image_id=True)
            found = image.features()
            keypoints = found.keypoints.copy()
            keypoints[:, :2] = to_colmap_pixels(keypoints[:, :2])
            database.write_keypoints(image.image_id, keypoints)
            database.write_descriptors(
                image.image_id,
                pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, found.descriptors),
            )


def _match(
    database: Path,
    images: Sequence[MappingImage],
    pairs: Sequence[tuple[int, int]],
    work: Path,
    *,
    threads: int,
    seed: int,
) -> None:
    listed = work / "pairs.txt"
    listed.write_text("".join(f"{images[i].name} {images[j].name}\n" for i, j in pairs))
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = threads
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    # COLMAP keeps the descriptors and search trees of as many images as a block has pairs.
    pairing.block_size = _BLOCK_PAIRS
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    # This filter would remove spots on the lens but not walking people, who are never stationary
    # in the images of a moving camera.
    verification.filter_stationary_matches = False
    pycolmap.match_image_pairs(
        database, matching, pairing, verification, device=pycolmap.Device.cpu
    )


def _map(database: Path, work: Path, options: PoseOptions, threads: int) -> dict[int, Any]:
    output = work / "models"
    output.mkdir()
    if options.mapper is Mapper.GLOBAL:
        return _map_globally(database, work, output, options, threads)
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.num_threads = threads
    pipeline.random_seed = options.seed
    # The given intrinsics stay fixed while the model is small; they are refined once the whole
    # path constrains them. Distortion is the exception: without it, points would be rejected.
    distortion = options.refine is Refinement.DISTORTION
    pipeline.ba_refine_focal_length = False
    pipeline.ba_refine_principal_point = False
    pipeline.ba_refine_extra_params = distortion
    pipeline.mapper.abs_pose_refine_focal_length = False
    pipeline.mapper.abs_pose_refine_extra_params = distortion
    pipeline.min_model_size = 3
    pipeline.extract_colors = False
    with pycolmap.Database.open(database) as opened:
        if opened.num_images() >= MappingSettings.current().many_images:
            _adjust_less(pipeline)
    return dict(pycolmap.incremental_mapping(database, work, output, pipeline))


def _adjust_less(pipeline: Any) -> None:
    """Adjust the growing model less often and less closely; `adjust` does it well at the end.

    By default COLMAP adjusts it whenever it has grown by a tenth, up to five times, until nothing
    changes: for 275 images that takes six times as long.
    """
    pipeline.ba_global_frames_ratio = pipeline.ba_global_points_ratio = 1.5
    pipeline.ba_global_max_refinements = 2
    pipeline.ba_global_max_num_iterations = pipeline.ba_local_max_num_iterations = 15
    pipeline.ba_global_function_tolerance = 1e-5
    pipeline.ba_local_function_tolerance = 1e-6


def _map_globally(
    database: Path, work: Path, output: Path, options: PoseOptions, threads: int
) -> dict[int, Any]:
    pipeline = pycolmap.GlobalPipelineOptions()
    pipeline.num_threads = threads
    pipeline.random_seed = options.seed
    pipeline.mapper.num_threads = threads
    pipeline.mapper.random_seed = options.seed
    pipeline.mapper.global_positioning.use_gpu = False
    adjustment = pipeline.mapper.bundle_adjustment
    adjustment.refine_focal_length = False
    adjustment.refine_extra_params = options.refine is Refinement.DISTORTION
    adjustment.ceres.use_gpu = False
    return dict(pycolmap.global_mapping(database, work, output, pipeline))


def unregister_unseen(model: Any, *, min_points: int) -> None:
    """Deregister images that have too few points after the bundle adjustment."""
    for number in list(model.reg_image_ids()):
        image = model.image(number)
        if image.num_points3D < min_points:
            model.deregister_frame(image.frame_id)
