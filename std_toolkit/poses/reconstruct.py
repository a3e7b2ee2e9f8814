"""Reconstruction of all frames in an unknown unit. The result is cached."""

import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from std_toolkit.errors import ToolkitError
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.io.documents import digest_file, digest_of, read_document, write_document
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.memory import return_free_memory
from std_toolkit.log import logger
from std_toolkit.options import PoseOptions
from std_toolkit.poses import register
from std_toolkit.poses.colmap import (
    Reconstructed,
    Reconstruction,
    add_image,
    from_colmap_camera,
    image_id_of,
    quiet_colmap,
)
from std_toolkit.poses.features import (
    FeatureJob,
    choose_keyframes,
    choose_pairs,
    describe_image,
    extract_features,
    feature_path,
    load_features,
    measure_frames,
    train_vocabulary,
)
from std_toolkit.poses.mapping import MappingImage, adjust, map_keyframes, unregister_unseen
from std_toolkit.poses.small_sets import map_small_set, rank_model
from std_toolkit.scene import Frame, Scene
from std_toolkit.settings import changed

# Options that change the model; the other options affect only scale and gates.
MODEL_OPTIONS = (
    "keyframe_motion",
    "max_keyframe_gap",
    "max_features",
    "fine_keyframes",
    "overlap",
    "loops",
    "small_set",
    "mapper",
    "refine",
    "min_angle_deg",
    "min_points",
    "seed",
    "threads",
)


def model_digest(scene: Scene, digests: dict[int, str], options: PoseOptions) -> str:
    """Return the digest of everything that determines the model.

    Args:
        scene: the recording.
        digests: digest of the colour image by frame id.
        options: options of the step.
    """
    frames = [[f.id, f.name, f.color, f.camera, digests[f.id]] for f in scene.frames]
    chosen = {name: getattr(options, name) for name in MODEL_OPTIONS}
    return digest_of("model", frames, scene.info.cameras, chosen, changed("poses."))


def image_digests(scene: Scene) -> dict[int, str]:
    """Return the digest of the colour image of every frame, by frame id.

    Raises:
        ToolkitError: an image is missing.
    """
    paths = {f.id: scene.color_path(f) for f in scene.frames}
    for path in paths.values():
        if not path.is_file():
            raise ToolkitError("image file not found", path=path)
    return {frame: digest_file(path) for frame, path in paths.items()}


def reconstruct(
    scene: Scene, cache: Path, work: Path, *, options: PoseOptions, jobs: JobOptions
) -> Reconstructed:
    """Reconstruct all frames, or read the model from the cache if nothing changed.

    Args:
        scene: the recording.
        cache: folder that keeps features and the last model between runs.
        work: empty folder for intermediate files, on the same disk as `cache`.
        options: options of the step.
        jobs: where the work runs.

    Raises:
        ToolkitError: images cannot be read, or no model can be built from them.
    """
    if len(scene.frames) < 3:
        raise ToolkitError(
            "structure from motion needs at least 3 frames",
            path=scene.root / "frames.json",
            value=len(scene.frames),
        )
    digests = image_digests(scene)
    key = model_digest(scene, digests, options)
    stored = cache / f"model-{key}"
    if not (stored / "about.json").is_file():
        model, about = _build(scene, digests, cache / "features", work, options, jobs)
        fresh = work / "finished"
        (fresh / "sparse").mkdir(parents=True)
        model.write(fresh / "sparse")
        write_document(fresh / "about.json", about)
        for old in cache.glob("model-*"):
            # about.json marks a model as complete; remove it first, in case of an interruption.
            (old / "about.json").unlink(missing_ok=True)
            shutil.rmtree(old)
        fresh.replace(stored)
    else:
        logger.info("camera poses: using the model of the last run (inputs unchanged)")
    with quiet_colmap():
        check_colmap_model(stored / "sparse")
        model = pycolmap.Reconstruction(stored / "sparse")
    return Reconstructed(model, read_document(stored / "about.json", Reconstruction))


def _build(
    scene: Scene,
    digests: dict[int, str],
    features: Path,
    work: Path,
    options: PoseOptions,
    jobs: JobOptions,
) -> tuple[Any, Reconstruction]:
    """Map the keyframes and register the rest; match all pairs if a small set leaves images out.

    The better model has more registered images, then the lower reprojection error.
    """
    total = len(scene.frames)
    first: tuple[Any, Reconstruction] | None = None
    failure: ToolkitError | None = None
    try:
        first = _build_sequentially(scene, digests, features, work, options, jobs)
    except ToolkitError as error:
        if total > options.small_set:
            raise
        failure = error
    if first is not None and (total > options.small_set or first[0].num_reg_images() == total):
        return first
    found = first[0].num_reg_images() if first is not None else 0
    logger.info("camera poses: %d of %d images; matching all pairs", found, total)
    second = _build_exhaustively(scene, digests, features, work, options, jobs)
    results = [x for x in (first, second) if x is not None]
    if not results:
        assert failure is not None
        raise failure
    return max(results, key=lambda x: rank_model(x[0]))


def _build_exhaustively(
    scene: Scene,
    digests: dict[int, str],
    features: Path,
    work: Path,
    options: PoseOptions,
    jobs: JobOptions,
) -> tuple[Any, Reconstruction] | None:
    frames = scene.frames
    cameras = {f.camera: scene.info.cameras[f.camera].camera() for f in frames}

    def images(faint: bool) -> list[MappingImage]:
        names = {f.id: feature_name(f, digests[f.id], True, options, faint=faint) for f in frames}
        wanted = [
            FeatureJob(names[f.id], scene.color_path(f), cameras[f.camera].size, True, faint)
            for f in frames
        ]
        extract_features(wanted, features, max_features=options.max_features, options=jobs)
        return [
            MappingImage(
                image_id=image_id_of(f),
                name=f.color,
                camera=f.camera,
                features=partial(load_features, features, names[f.id]),
            )
            for f in frames
        ]

    found = map_small_set(images, cameras, work, options=options)
    if found is None:
        return None
    about = Reconstruction(
        keyframes=[f.id for f in frames],
        camera_ids=found.mapping.camera_ids,
        other_sizes=found.mapping.other_sizes,
        explained=found.explained,
    )
    return found.mapping.model, about


def _build_sequentially(
    scene: Scene,
    digests: dict[int, str],
    features: Path,
    work: Path,
    options: PoseOptions,
    jobs: JobOptions,
) -> tuple[Any, Reconstruction]:
    frames = scene.frames
    cameras = {f.camera: scene.info.cameras[f.camera].camera() for f in frames}
    measures = measure_frames([scene.color_path(f) for f in frames])
    chosen = choose_keyframes(
        measures, motion=options.keyframe_motion, max_gap=options.max_keyframe_gap
    )
    is_key = set(chosen)
    logger.info("camera poses: %d keyframes of %d frames", len(chosen), len(frames))
    names = {
        f.id: feature_name(f, digests[f.id], i in is_key and options.fine_keyframes, options)
        for i, f in enumerate(frames)
    }
    wanted = [
        FeatureJob(
            names[f.id],
            scene.color_path(f),
            cameras[f.camera].size,
            i in is_key and options.fine_keyframes,
        )
        for i, f in enumerate(frames)
    ]
    extract_features(wanted, features, max_features=options.max_features, options=jobs)
    _forget_others(features, set(names.values()))

    keyframes = [frames[i] for i in chosen]
    loaded = {f.id: load_features(features, names[f.id]) for f in keyframes}
    _check_texture(loaded, keyframes, options)
    vocabulary = train_vocabulary([x.descriptors for x in loaded.values()], seed=options.seed)
    vectors = {f.id: describe_image(loaded[f.id].descriptors, vocabulary) for f in keyframes}
    pairs = choose_pairs(
        [vectors[f.id] for f in keyframes], overlap=options.overlap, loops=options.loops
    )
    del loaded
    logger.info("camera poses: mapping keyframes, %d image pairs", len(pairs))
    mapping = map_keyframes(
        [
            MappingImage(
                image_id=image_id_of(f),
                name=f.color,
                camera=f.camera,
                features=partial(load_features, features, names[f.id]),
            )
            for f in keyframes
        ],
        pairs,
        cameras,
        work,
        options=options,
    )
    model = mapping.model
    adjust(model, refine=options.refine, threads=options.threads)
    intrinsics = {
        key: from_colmap_camera(model.camera(i))
        for key, i in mapping.camera_ids.items()
        if model.exists_camera(i)
    }
    index = register.build_index(
        model,
        [(image_id_of(f), names[f.id], i) for i, f in zip(chosen, keyframes, strict=True)],
        {image_id_of(f): vectors[f.id] for f in keyframes},
        vocabulary,
    )
    index.save(work / "index.npz")
    registered = {image_id_of(f): f for f in keyframes if _has_pose(model, f)}
    rest = {
        order: f
        for order, f in enumerate(frames)
        if image_id_of(f) not in registered and f.camera in intrinsics
    }
    logger.info("camera poses: registering %d further frames", len(rest))
    report = register.register_frames(
        [
            register.RegistrationJob(names[f.id], order, intrinsics[f.camera])
            for order, f in rest.items()
        ],
        work / "index.npz",
        features,
        min_points=options.min_points,
        seed=options.seed,
        options=jobs,
    )
    report.raise_if_failed()
    for frame in rest.values():
        found: register.Registration | None = report.results[names[frame.id]]
        if found is None:
            continue
        _check_absent(model, frame)
        add_image(
            model,
            image_id=image_id_of(frame),
            name=frame.color,
            camera_id=mapping.camera_ids[frame.camera],
            T_cam_world=found.T_cam_world,
            uv=load_features(features, names[frame.id]).uv[found.keypoint],
            point_ids=found.point_ids,
        )
    del index, vectors, report
    return_free_memory()
    adjust(
        model,
        refine=options.refine,
        threads=options.threads,
        min_angle_deg=options.min_angle_deg,
    )
    unregister_unseen(model, min_points=options.min_points)
    about = Reconstruction(
        keyframes=[f.id for f in keyframes],
        camera_ids=mapping.camera_ids,
        other_sizes=mapping.other_sizes,
    )
    return model, about


def _has_pose(model: Any, frame: Frame) -> bool:
    number = image_id_of(frame)
    return bool(model.exists_image(number) and model.image(number).has_pose)


def _check_absent(model: Any, frame: Frame) -> None:
    """Check that a frame without a pose is not in the model; it would be added twice."""
    if model.exists_image(image_id_of(frame)):
        raise ToolkitError("image is in the model without a pose", value=frame.color)


def feature_name(
    frame: Frame, digest: str, fine: bool, options: PoseOptions, *, faint: bool = False
) -> str:
    """Return the name of the feature file of a frame."""
    key = digest_of("faint sift" if faint else "sift", digest, fine, options.max_features)
    return f"{frame.name}-{key[:16]}"


def _forget_others(folder: Path, names: set[str]) -> None:
    wanted = {feature_path(folder, name).name for name in names}
    for path in folder.glob("*.npz"):
        if path.name not in wanted:
            path.unlink()


def _check_texture(
    loaded: dict[int, Any], keyframes: Sequence[Frame], options: PoseOptions
) -> None:
    counts = np.array([len(loaded[f.id].keypoints) for f in keyframes])
    if np.median(counts) < 3 * options.min_points:
        raise ToolkitError(
            f"the images have almost no features (median {np.median(counts):.0f} per keyframe)",
            hint="put textured objects into view (a printed cloth is enough), focus, add light",
        )
