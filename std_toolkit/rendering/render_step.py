"""`std-curate render`: ground truth for every labelled frame."""

from collections.abc import Sequence
from functools import partial
from typing import Literal

from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries
from std_toolkit.io.documents import digest_file, digest_files, digest_of
from std_toolkit.jobs import JobOptions, JobReport, run_jobs
from std_toolkit.log import logger
from std_toolkit.options import RenderOptions
from std_toolkit.rendering import choose, frame, ground_truth, occluders, placements
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.scene.scene import Scene


def render_ground_truth(
    scene: Scene,
    options: RenderOptions | None = None,
    *,
    frames: Sequence[int] | None = None,
    jobs: JobOptions | None = None,
) -> JobReport[Literal["done", "kept"]]:
    """Render z-depth, mask, NOCS, normals and visible fractions of every labelled frame.

    Finished frames whose inputs did not change are kept. Ground truth of frames that are no longer
    labelled is removed. The caller holds the lock of the scene.

    Args:
        scene: scene with labels, and with camera poses if the labels were propagated.
        options: options of the step.
        frames: render only these frame ids, and remove nothing.
        jobs: where the work runs.

    Returns:
        "done" or "kept" by frame id, and the frames that failed. A failure does not stop the run.

    Raises:
        ToolkitError: no frame is labelled, a mesh cannot be read, or an option does not apply.
    """
    options = options or RenderOptions()
    labelled = placements.labelled_frames(scene)
    if frames is not None:
        strangers = sorted(set(frames) - set(labelled))
        if strangers:
            raise ToolkitError("frames without a labelled object", path=scene.root, value=strangers)
    wanted = labelled if frames is None else sorted(set(frames))
    cameras = {scene.camera(scene.frame(f)) for f in wanted}
    policy = resolve_policy(scene, options.policy)
    models = sorted(
        {
            scene.objects.object(o).model
            for f in wanted
            for o in placements.frame_placements(scene, f)
        }
    )
    for model in models:
        scene.mesh(model)  # fail once for a bad mesh, not once per frame
    sweep_temporaries(scene.root / ground_truth.FOLDER)
    if frames is None:
        _remove_stale(scene, set(labelled), policy)
    meshes = tuple((m, digest_file(scene.mesh_path(scene.objects.model(m)))) for m in models)
    renderer = choose.choose_renderer(options.renderer, cameras=cameras)
    same_machine = jobs is None or jobs.engine != "ray"
    job = frame.FrameJob(
        root=str(scene.root),
        state=_state(scene, meshes),
        renderer=renderer,
        policy=policy,
        delta_m=options.delta_m,
        smooth_normals=options.smooth_normals,
        occluder=occluders.fuse_occluders(scene, options.fusion) if policy == "fused" else None,
        gl=choose.find_gl()[0] if renderer == "pyrender" and same_machine else None,
    )
    return run_jobs(
        partial(frame.render_frame, job=job, force=options.force),
        wanted,
        name="render",
        options=jobs,
    )


def _state(scene: Scene, meshes: tuple[tuple[str, str], ...]) -> str:
    """Digest of the parts of a scene that a worker keeps in memory."""
    names = ("scene.json", "frames.json", "objects.json", "poses.json", "labels.json")
    return digest_of(digest_files(scene.root, [scene.root / name for name in names]), meshes)


def _remove_stale(scene: Scene, labelled: set[int], policy: ground_truth.Policy) -> None:
    """Remove ground truth of frames that are no longer labelled, so that it is not exported."""
    stale = [
        int(p.stem)
        for p in sorted((scene.root / ground_truth.FOLDER / "info").glob("*.json"))
        if p.stem.isdigit() and int(p.stem) not in labelled
    ]
    for frame_id in stale:
        ground_truth.info_path(scene.root, frame_id).unlink(missing_ok=True)
        for path in ground_truth.map_paths(scene.root, frame_id).values():
            path.unlink(missing_ok=True)
    if stale:
        logger.warning("removed ground truth of %d frames that lost their labels", len(stale))
    if policy != "fused":
        (scene.root / occluders.OCCLUDER_FILE).unlink(missing_ok=True)


FEWEST_FRAMES_TO_FUSE = 8


def resolve_policy(
    scene: Scene, wished: Literal["auto"] | ground_truth.Policy
) -> ground_truth.Policy:
    """Return the policy to use; `auto` selects the best one that the data of the scene allow.

    `auto` is `fused` with sensor depth in at least 8 registered frames, `sensor` with fewer if no
    labelled object is transparent or specular, and otherwise `models`.

    Raises:
        ToolkitError: the policy needs sensor depth or camera poses that the scene lacks.
    """
    with_depth = [f for f in scene.frames if f.depth is not None]
    registered = [f for f in with_depth if scene.T_world_cam(f.id) is not None]
    if wished == "auto":
        materials = {scene.objects.object(x.object).material for x in scene.labels.labels}
        if len(registered) >= FEWEST_FRAMES_TO_FUSE:
            return "fused"
        return "sensor" if with_depth and materials <= {*DIFFUSE_MATERIALS} else "models"
    if wished == "sensor" and not with_depth:
        raise ToolkitError(
            "policy sensor needs sensor depth, and this scene has none",
            path=scene.root,
            field="policy",
            hint="use --policy models",
        )
    if wished == "fused" and not registered:
        raise ToolkitError(
            "policy fused needs sensor depth in frames with camera poses",
            path=scene.root,
            field="policy",
            hint="use --policy models or sensor",
        )
    return wished
