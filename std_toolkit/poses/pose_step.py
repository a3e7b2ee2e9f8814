"""The camera-pose step: reconstruction, metric scale, quality gates, publication."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import digest_file, digest_files, digest_of
from std_toolkit.jobs import JobOptions
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.options import PoseOptions, Refinement
from std_toolkit.poses.known_cameras import KnownPoses
from std_toolkit.poses.pose_gates import matches_gate, pose_gates
from std_toolkit.scene import CameraPoses, Frame, FramePose, Labels, Scene
from std_toolkit.scene.model import ScaleReport, without_derived

STEP = "poses"


def estimate_poses(
    scene: Scene, options: PoseOptions | None = None, *, jobs: JobOptions | None = None
) -> CameraPoses:
    """Recover the camera poses of a scene and save them.

    Writes `poses.json`, `poses/sparse` (COLMAP model) and `poses/points.ply`, all in metres and in
    the world frame, which is the camera of the first registered frame. Does nothing if neither
    the inputs nor the options changed since the last run. Poses that fail a gate are saved too;
    the caller checks `CameraPoses.gates`.

    Args:
        scene: the recording.
        options: options of the step.
        jobs: where the work over frames runs; `options.threads` overrides its number of workers.

    Returns:
        The saved poses.

    Raises:
        ToolkitError: images cannot be read, no model was found, or the scale sources contradict
            each other. Nothing is saved then.
    """
    from std_toolkit.poses.publish import work_folder
    from std_toolkit.poses.scale_sources import check_source_name

    options = options or PoseOptions()
    jobs = _width(jobs or JobOptions(), options)
    check_source_name(options.scale)
    board = board_file(scene, options)
    known = _known_poses(scene, options)
    with scene.lock():
        artefact = _artefact(scene, options, board, known)
        if artefact.is_kept() and scene.poses is not None:
            return scene.poses
        with work_folder(scene.root) as work:
            poses, outputs = _run(scene, options, jobs, board, known, work)
        artefact.write(outputs)
    return poses


def board_file(scene: Scene, options: PoseOptions) -> Path | None:
    """Return the board file to use: `options.board`, or else `board.json` of the scene, if any."""
    if options.board is not None:
        return options.board
    own = scene.root / "board.json"
    return own if own.is_file() else None


def _run(
    scene: Scene,
    options: PoseOptions,
    jobs: JobOptions,
    board: Path | None,
    known: KnownPoses | None,
    work: Path,
) -> tuple[CameraPoses, list[Path]]:
    from std_toolkit.poses.colmap import adjusted_cameras, place_in_world, quiet_colmap, scale_world
    from std_toolkit.poses.known_model import known_gates, known_scale, reconstruct_known
    from std_toolkit.poses.lens_check import lens_gate, lens_shifts
    from std_toolkit.poses.publish import publish_model
    from std_toolkit.poses.reconstruct import reconstruct
    from std_toolkit.poses.scale_sources import ScaleContext, resolve_scale

    cache = scene.root / ".std" / "poses"
    cache.mkdir(parents=True, exist_ok=True)
    notes: list[str] = []
    if known is None:
        done = reconstruct(scene, cache, work, options=options, jobs=jobs)
    else:
        done, notes = reconstruct_known(scene, known, cache, work, options=options, jobs=jobs)
    image_ids = done.image_ids(scene.frames)
    context = ScaleContext(scene, done.model, image_ids, done.cameras(), board, jobs)
    if known is None:
        factor, report = resolve_scale(
            context,
            scale=options.scale,
            max_disagreement=options.max_disagreement,
            max_sigma=options.max_disagreement_sigma,
        )
        place_in_world(done.model, scale=factor, first_image=next(iter(image_ids.values())))
    else:
        factor, report = known_scale(known, context, options)
        scale_world(done.model, factor)
    frames, distance = _frame_poses(scene.frames, done.model, image_ids)
    if done.about.other_sizes:
        notes.append(
            f"the keyframes are split into {1 + len(done.about.other_sizes)} models; the largest "
            f"was kept, the others have {done.about.other_sizes} keyframes"
        )
    refined = {} if options.refine is Refinement.NONE else adjusted_cameras(scene, done)
    poses = CameraPoses(
        frames=frames,
        cameras=refined,
        scale=report,
        gates=pose_gates(
            frames,
            scene.frames,
            keyframes=done.about.keyframes,
            median_distance=distance,
            scale=_judged(report, options),
            options=options,
        ),
        source="sfm" if known is None else f"import:{known.filed.kind}",
        notes=notes,
    )
    lens = lens_gate(lens_shifts(done.model, image_ids.values(), done.about.camera_ids))
    if lens is not None:
        poses = msgspec.structs.replace(poses, gates=[*poses.gates, lens])
    if done.about.explained is not None:
        explained = matches_gate(done.about.explained)
        poses = msgspec.structs.replace(poses, gates=[*poses.gates, explained])
    if known is not None:
        gates = known_gates(poses.gates, known, scene.frames)
        poses = msgspec.structs.replace(poses, gates=gates)
    with quiet_colmap():
        done.model.extract_colors_for_all_images(scene.root)
    outputs = publish_model(scene.root, done.model, work)
    _forget_world_poses(scene)
    scene.save_poses(poses)
    return poses, [scene.root / "poses.json", *outputs]


def _known_poses(scene: Scene, options: PoseOptions) -> KnownPoses | None:
    """Poses from the file of known cameras, if the options name one."""
    if options.known.cameras is None:
        if options.known.hand_eye is not None:
            raise ToolkitError("--hand-eye needs --cameras, the poses of the flange")
        return None
    from std_toolkit.poses.known_cameras import read_known_poses

    known = read_known_poses(options.known, scene.frames)
    models = {lens.model for lens in known.filed.lenses if lens is not None}
    if models != {"opencv"} and models and not scene.info.recorded_lenses:
        logger.warning(
            "%s states a %s lens, which the images of the scene are taken not to have; "
            "`std-curate import --cameras` undistorts images",
            known.filed.path,
            ", ".join(sorted(models)),
        )
    return known


def _forget_world_poses(scene: Scene) -> None:
    """Remove poses in the old world from the labels; their annotations have to be propagated."""
    if any(x.T_world_obj is not None for x in scene.labels.labels):
        scene.save_labels(Labels(labels=[without_derived(x) for x in scene.labels.labels]))


def _judged(report: ScaleReport, options: PoseOptions) -> ScaleReport:
    """Drop the other sources if the user named one: they are logged but no gate tests them."""
    if options.scale == "auto":
        return report
    return ScaleReport(unit=report.unit, chosen=report.chosen)


def _frame_poses(
    frames: list[Frame], model: Any, image_ids: dict[int, int]
) -> tuple[list[FramePose], float]:
    from std_toolkit.poses.colmap import observations, pose_covariance

    poses, depths = [], []
    for frame in frames:
        if frame.id not in image_ids:
            poses.append(FramePose(frame=frame.id, status="unregistered"))
            continue
        seen = observations(model, image_ids[frame.id])
        errors = np.linalg.norm(seen.residuals, axis=1)
        covariance = pose_covariance(seen)
        depths.append(seen.points_cam[:, 2])
        T_world_cam: SE3 = seen.T_cam_world.inverse()
        poses.append(
            FramePose(
                frame=frame.id,
                status="registered",
                T_world_cam=T_world_cam.flat(),
                reprojection_px=float(errors.mean()) if len(errors) else None,
                points=len(errors),
                covariance=None if covariance is None else covariance.ravel().tolist(),
            )
        )
    every = np.concatenate(depths) if depths else np.zeros(0)
    return poses, float(np.median(every)) if len(every) else 0.0


def _width(jobs: JobOptions, options: PoseOptions) -> JobOptions:
    if options.threads is None:
        return jobs
    engine = "serial" if options.threads == 1 else jobs.engine
    return JobOptions(
        engine=engine,
        workers=options.threads,
        ray_address=jobs.ray_address,
        progress=jobs.progress,
    )


def _artefact(
    scene: Scene, options: PoseOptions, board: Path | None, known: KnownPoses | None
) -> Artefact:
    """Everything that poses.json depends on."""
    from std_toolkit.poses.reconstruct import MODEL_OPTIONS, image_digests

    if board is not None and not board.is_file():
        raise ToolkitError("board file not found", path=board)
    has_scale = options.scale != "none"
    depths = [scene.root / f.depth for f in scene.frames if f.depth is not None and has_scale]
    for path in depths:
        if not path.is_file():
            raise ToolkitError("depth image not found", path=path)
    # Only objects annotated in several frames determine the scale. T_world_obj is left out because
    # it follows from the poses.
    annotated = [
        [
            [x.object, x.frame, x.T_cam_obj, x.views],
            [scene.objects.object(x.object), scene.objects.model_of(x.object)],
        ]
        for x in scene.labels.labels
        if x.views and has_scale
    ]
    meshes = [scene.mesh_path(m) for m in scene.objects.models if annotated]
    digests = image_digests(scene)
    images = [[f.id, f.name, f.color, f.camera, digests[f.id]] for f in scene.frames]
    inputs = {
        "images": digest_of(images),
        "cameras": digest_of(scene.info.cameras),
        "depth": digest_of(
            list(digest_files(scene.root, depths).values()),
            [scene.info.depth_scale, scene.info.depth_correction],
        ),
        "board": "" if board is None else digest_file(board),
        "annotations": digest_of(annotated, digest_files(scene.root, meshes)),
        "known poses": "" if known is None else known.digest(),
    }
    values = {
        k: v
        for k, v in vars(options).items()
        if k in (*MODEL_OPTIONS, "scale") or k.startswith(("min_", "max_"))
    }
    return Artefact(scene.root, STEP, inputs, values, limits=("poses.", "labels."))
