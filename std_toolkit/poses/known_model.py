"""Reconstruction at known camera poses: check, triangulation, refinement with fixed scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pycolmap

from std_toolkit import errors, log
from std_toolkit.errors import listed
from std_toolkit.geometry import SE3, Camera, depth_maps, rotation_angle
from std_toolkit.jobs import JobOptions
from std_toolkit.options import PoseOptions
from std_toolkit.poses import features, mapping, reconstruct, register
from std_toolkit.poses.colmap import (
    Reconstructed,
    Reconstruction,
    from_rigid3d,
    image_id_of,
    observations,
    quiet_colmap,
    to_colmap_camera,
    to_rigid3d,
)
from std_toolkit.poses.frame_check import (
    FrameFeatures,
    FrameVerdicts,
    add_frames,
    count_explained,
    judge_keyframes,
)
from std_toolkit.poses.known_cameras import KnownPoses
from std_toolkit.poses.pose_check import check_poses, join_tracks, refuse_shifted
from std_toolkit.poses.scale_sources import DepthScale, ScaleContext, resolve_scale
from std_toolkit.poses.small_sets import verified_matches
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.model import Gate, ScaleReport
from std_toolkit.settings import Settings, limit

# All pairs of so few images are matched; of more, neighbours and similar ones.
_ALL_PAIRS = 24
# Deviation of given positions in a refinement, over the distance that a reprojection error of the
# median, and at least of a feature's own error, stands for.
_PRIOR_FACTOR = 3.0
_SMALLEST_ERROR_PX = 0.5


@dataclass(frozen=True, kw_only=True)
class KnownPosesSettings(Settings):
    """What known camera poses and sensor depth may disagree by."""

    depth_factors: tuple[float, float] = limit(
        (0.8, 1.25),
        source="sensor depth is a few per cent off at most; another unit is off by 10 or more",
    )
    """range of the factor between sensor depth and known camera poses; beyond it the unit is
    wrong"""
    fewest_features: int = limit(16, source="a vocabulary has a word for eight descriptors")
    """features of all keyframes without which not even unchecked poses are kept"""


def reconstruct_known(
    scene: Scene,
    known: KnownPoses,
    cache: Path,
    work: Path,
    *,
    options: PoseOptions,
    jobs: JobOptions,
) -> tuple[Reconstructed, list[str]]:
    """Check the known poses against the images and triangulate the points that they explain.

    Args:
        scene: the recording.
        known: the poses.
        cache: folder that keeps features between runs.
        work: empty folder for intermediate files.
        options: options of the step.
        jobs: where the work runs.

    Returns:
        The model of the frames with a pose, in the world of the given poses, and notes.

    Raises:
        ToolkitError: images cannot be read, or the poses do not explain them.
    """
    frames = [f for f in scene.frames if f.id in known.row]
    if len(frames) < 2:
        raise errors.ToolkitError(
            "fewer than two images have a pose", path=known.filed.path, value=len(frames)
        )
    cameras = {f.camera: scene.info.cameras[f.camera].camera() for f in frames}
    lens = {f.id: cameras[f.camera] for f in frames}
    chosen = list(range(len(frames)))
    if len(frames) > _ALL_PAIRS:
        chosen = features.choose_keyframes(
            features.measure_frames([scene.color_path(f) for f in frames]),
            motion=options.keyframe_motion,
            max_gap=options.max_keyframe_gap,
        )
    names = _extract(scene, frames, cache / "features", options, jobs)
    keyframes = [frames[i] for i in chosen]
    loaded = {f.id: features.load_features(cache / "features", names[f.id]) for f in keyframes}
    vocabulary, vectors = _describe(loaded, options)
    pairs = _pairs([vectors[f.id] for f in keyframes], options)
    log.logger.info("known camera poses: checking %d, %d image pairs", len(keyframes), len(pairs))
    images = [
        mapping.MappingImage(
            image_id=image_id_of(f), name=f.color, camera=f.camera,
            features=partial(features.load_features, cache / "features", names[f.id]),
        )
        for f in keyframes
    ]  # fmt: skip
    database, camera_ids = mapping.match_keyframes(images, pairs, cameras, work, options=options)
    tracks = join_tracks(
        [(a - 1, b - 1, m) for a, b, m in verified_matches(database)],
        {f.id: loaded[f.id].uv for f in keyframes},
    )
    verdict = check_poses(known, tracks, lens)
    poses, px = known.poses(), known.options.cameras_max_px
    suspects, verdicts = set[int](), FrameVerdicts()
    if verdict.fits and len(keyframes) > 2:
        given = {f.id: poses[f.id] for f in keyframes}
        explained, px = count_explained(tracks, given, lens, px=px)
        suspects, verdicts = judge_keyframes(explained)
    kept = [(i, f) for i, f in zip(chosen, keyframes, strict=True) if f.id not in suspects]
    if len(kept) < 2:
        raise errors.ToolkitError(
            f"other poses explain more features of {len(suspects)} of {len(keyframes)} images",
            path=known.filed.path,
            hint="check intrinsics and order, or keep the poses with --cameras-unchecked",
        )
    held = {f.id: poses[f.id] for _, f in kept}
    model = _triangulate(database, work, keyframes, held, cameras, camera_ids, options)
    _check_distance(model, known)
    number = image_id_of
    index = register.build_index(
        model,
        [(number(f), names[f.id], i) for i, f in kept],
        {number(f): vectors[f.id] for f in keyframes},
        vocabulary,
    )
    index.save(work / "index.npz")
    add_frames(
        model,
        [(i, f) for i, f in enumerate(frames) if f.id not in held],
        poses,
        lens,
        camera_ids,
        FrameFeatures(names=names, folder=cache / "features", index=work / "index.npz"),
        verdicts,
        px=px,
        keep_wrong=known.options.cameras_unchecked,
        options=options,
        jobs=jobs,
    )
    if verdicts.wrong and verdict.median_px is not None and not known.options.cameras_unchecked:
        refuse_shifted(known, tracks, lens, verdict.median_px)
    file_names = {f.id: f.color.rsplit("/")[-1] for f in frames}
    notes = [known.note(), *verdict.notes, *verdicts.notes(file_names)]
    if known.options.cameras_use == "refine":
        used = {f: T for f, T in poses.items() if model.exists_image(f + 1)}
        notes.append(_refine(model, used, verdict.median_px or 0.0, options))
    about = Reconstruction(keyframes=[f.id for f in keyframes], camera_ids=camera_ids)
    return Reconstructed(model, about), notes


def known_scale(
    known: KnownPoses, context: ScaleContext, options: PoseOptions
) -> tuple[float, ScaleReport]:
    """Return the metres per unit of the given poses, and the scale report.

    Metric poses are compared with sensor depth, which shows a wrong unit but no small error.

    Raises:
        ToolkitError: sensor depth tells another unit, or `resolve_scale` fails.
    """
    if not known.metric:
        return resolve_scale(
            context,
            scale=options.scale,
            max_disagreement=options.max_disagreement,
            max_sigma=options.max_disagreement_sigma,
        )
    report = ScaleReport(unit="metre", chosen="given")
    source = DepthScale()
    if not source.available(context):
        return 1.0, report
    try:
        estimate = source.estimate(context)
    except errors.ToolkitError as error:
        log.logger.warning("sensor depth cannot check the unit of the poses: %s", error)
        return 1.0, report
    low, high = KnownPosesSettings.current().depth_factors
    if not low < estimate.factor < high:
        raise errors.ToolkitError(
            f"sensor depth is {estimate.factor:.4g} times the distance by these poses",
            path=known.filed.path,
            hint=_unit_hint(known, estimate.factor),
        )
    return 1.0, msgspec.structs.replace(report, estimates=[estimate])


def known_gates(gates: list[Gate], known: KnownPoses, frames: Sequence[Frame]) -> list[Gate]:
    """Replace the advice of gates that fail because the file lacks poses."""
    lost = [f.name for f in frames if f.id not in known.row]
    advice = {
        "keyframes_registered": "correct the poses of the frames in the notes",
        "frames_registered": f"{known.filed.path.name} has no pose for {listed(lost, 4)}"
        if lost
        else "correct the poses of the frames in the notes",
        "mean_reprojection_px": "the poses are off by more than the images allow: try "
        "--cameras-use refine, or calibrate the camera again",
    }
    return [
        msgspec.structs.replace(g, advice=advice[g.name])
        if not g.passed and g.name in advice
        else g
        for g in gates
    ]


def _extract(
    scene: Scene, frames: Sequence[Frame], folder: Path, options: PoseOptions, jobs: JobOptions
) -> dict[int, str]:
    digests = reconstruct.image_digests(scene)
    fine = options.fine_keyframes
    names = {f.id: reconstruct.feature_name(f, digests[f.id], fine, options) for f in frames}
    features.extract_features(
        [
            features.FeatureJob(names[f.id], scene.color_path(f), scene.camera(f).size, fine)
            for f in frames
        ],
        folder,
        max_features=options.max_features,
        options=jobs,
    )
    return names


def _describe(loaded: dict[int, Any], options: PoseOptions) -> tuple[Any, dict[int, Any]]:
    every = [x.descriptors for x in loaded.values()]
    count = sum(map(len, every))
    fewest = KnownPosesSettings.current().fewest_features
    if count < (fewest if options.known.cameras_unchecked else 100):
        raise errors.ToolkitError(
            "the images have almost no features, so the poses cannot be checked",
            hint="put textured objects into view (a printed cloth is enough), focus, add light; or "
            "keep the poses with --cameras-unchecked",
        )
    vocabulary = features.train_vocabulary(every, seed=options.seed)
    return vocabulary, {
        f: features.describe_image(x.descriptors, vocabulary) for f, x in loaded.items()
    }


def _pairs(vectors: Sequence[Any], options: PoseOptions) -> list[tuple[int, int]]:
    if len(vectors) <= _ALL_PAIRS:
        return list(combinations(range(len(vectors)), 2))
    return features.choose_pairs(vectors, overlap=options.overlap, loops=options.loops)


def _triangulate(
    database: Path,
    work: Path,
    keyframes: Sequence[Frame],
    poses: dict[int, SE3],
    cameras: dict[str, Camera],
    camera_ids: dict[str, int],
    options: PoseOptions,
) -> Any:
    model = pycolmap.Reconstruction()
    for key, number in camera_ids.items():
        model.add_camera_with_trivial_rig(to_colmap_camera(cameras[key], number))
    for frame in keyframes:
        if frame.id not in poses:
            continue
        image = pycolmap.Image(
            name=frame.color,
            camera_id=camera_ids[frame.camera],
            image_id=image_id_of(frame),
        )
        model.add_image_with_trivial_frame(image, to_rigid3d(poses[frame.id].inverse()))
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.random_seed = options.seed
    pipeline.num_threads = -1 if options.threads is None else options.threads
    pipeline.extract_colors = False
    pipeline.triangulation.ignore_two_view_tracks = False
    output = work / "triangulated"
    output.mkdir()
    with quiet_colmap():
        pycolmap.set_random_seed(options.seed)
        return pycolmap.triangulate_points(model, database, work, output, options=pipeline)


def _check_distance(model: Any, known: KnownPoses) -> None:
    """Check that the points lie at a distance that a camera in front of a table or room sees."""
    if not known.metric:
        return
    depths = [observations(model, i).points_cam[:, 2] for i in model.reg_image_ids()]
    every = np.concatenate(depths) if depths else np.zeros(0)
    if len(every) == 0:
        return
    median = float(np.median(every))
    if not depth_maps.SMALLEST_MEDIAN_DEPTH_M <= median <= depth_maps.LARGEST_MEDIAN_DEPTH_M:
        raise errors.ToolkitError(
            f"by these poses the objects are {median:.4g} m from the camera",
            path=known.filed.path,
            hint=_unit_hint(known, 0.5 / median),
        )


def _unit_hint(known: KnownPoses, factor: float) -> str:
    """Name the unit whose size is nearest to `factor` times the present one."""
    sizes = {"m": 1.0, "cm": 0.01, "mm": 0.001}
    wanted = sizes[known.convention.unit] * factor
    unit = min(sizes, key=lambda u: abs(np.log(sizes[u] / wanted)))
    if unit == known.convention.unit:
        return "check the unit: --cameras-unit"
    return f"use --cameras-unit {unit}"


def _refine(model: Any, poses: dict[int, SE3], median_px: float, options: PoseOptions) -> str:
    """Refine the model in place and move it back to scale and frame of the given poses.

    Positions are held to the given ones with the deviation that the reprojection error stands
    for, so that directions that the images do not determine stay as given. An image with too few
    points keeps its pose.
    """
    limits = mapping.MappingSettings.current()
    images = {f: model.image(f + 1) for f in poses}
    depths = [observations(model, i).points_cam[:, 2] for i in model.reg_image_ids()]
    distance = float(np.median(np.concatenate(depths)))
    focal = float(np.mean([c.mean_focal_length() for c in model.cameras.values()]))
    sigma = _PRIOR_FACTOR * max(median_px, _SMALLEST_ERROR_PX) / focal * distance
    settings = mapping.adjustment_options(refine=options.refine, threads=options.threads)
    with quiet_colmap():
        for _ in range(2):
            config = pycolmap.BundleAdjustmentConfig()
            priors = []
            for f, image in images.items():
                if image.num_points3D < options.min_points:
                    continue
                config.add_image(image.image_id)
                priors.append(
                    pycolmap.PosePrior(
                        corr_data_id=image.data_id,
                        position=poses[f].t,
                        position_covariance=np.eye(3) * sigma**2,
                        coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
                    )
                )
            if len(priors) < 3:
                raise errors.ToolkitError(
                    f"too few features match to refine poses: {len(priors)} images have enough",
                    hint="use --cameras-use keep",
                )
            pycolmap.create_pose_prior_bundle_adjuster(
                settings, pycolmap.PosePriorBundleAdjustmentOptions(), config, priors, model
            ).solve()
            manager = pycolmap.ObservationManager(model)
            manager.filter_all_points3D(
                limits.largest_error_px,
                limits.wide_angle_deg,
            )
        model.update_point_3d_errors()
    ours = {f: from_rigid3d(x.cam_from_world()).inverse() for f, x in images.items()}
    scale, T = align_poses(list(ours.values()), list(poses.values()))
    model.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(T.R), T.t))
    moved = [
        SE3(T.R @ a.R, scale * (T.R @ a.t) + T.t).inverse() @ poses[f] for f, a in ours.items()
    ]
    shift = float(np.median([np.linalg.norm(m.t) for m in moved]))
    turn = float(np.degrees(np.median([rotation_angle(m.R) for m in moved])))
    return f"refined: the poses moved by {1000 * shift:.2f} mm and {turn:.3f} deg (medians)"


def align_poses(source: Sequence[SE3], target: Sequence[SE3]) -> tuple[float, SE3]:
    """Return the similarity (scale, rotation and translation) from source to target poses.

    The rotation follows from the orientations: positions may lie on a straight line.

    Args:
        source: N >= 2 poses T_a_cam.
        target: poses T_b_cam of the same cameras.
    """
    total = sum((b.R @ a.R.T for a, b in zip(source, target, strict=True)), np.zeros((3, 3)))
    U, _, Vt = np.linalg.svd(total)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p = np.array([a.t for a in source]) @ R.T
    q = np.array([b.t for b in target])
    p_centred, q_centred = p - p.mean(axis=0), q - q.mean(axis=0)
    size = float((p_centred**2).sum())
    scale = float((p_centred * q_centred).sum()) / size if size > 0 else 1.0
    return scale, SE3(R, q.mean(axis=0) - scale * p.mean(axis=0))
