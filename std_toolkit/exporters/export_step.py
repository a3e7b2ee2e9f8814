"""The export step: writes a scene in one layout, frame by frame, completely or not at all."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import msgspec

from std_toolkit import __version__
from std_toolkit.errors import ToolkitError
from std_toolkit.exporters.exporter import (
    Exporter,
    FrameRow,
    Target,
    faulty_objects,
    get_exporter,
    left_out_objects,
)
from std_toolkit.exporters.frame_maps import check_fresh, color_camera
from std_toolkit.exporters.label_quality import label_quality, refuse_wrong
from std_toolkit.exporters.staging import (
    Progress,
    drop_strangers,
    file_digests,
    progress_path,
    staging_area,
    state_of,
)
from std_toolkit.io.documents import digest_files, digest_of, write_document
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.log import logger
from std_toolkit.options import ExportOptions
from std_toolkit.rendering.ground_truth import info_path, read_frame_truth, rendered_frames
from std_toolkit.scene import model
from std_toolkit.scene.check_flags import CheckFlags, read_check_flags
from std_toolkit.scene.scene import Scene
from std_toolkit.scene.sidecar import (
    SIDECAR_NAME,
    ExportedModel,
    LeftOut,
    Sidecar,
    Visibility,
)

_SERIAL_BELOW = 16


def export_scene(
    scene: Scene,
    format_name: str,
    out: Path | str,
    *,
    options: ExportOptions | None = None,
    jobs: JobOptions | None = None,
) -> Sidecar:
    """Export every frame with complete ground truth.

    Args:
        format_name: name of the exporter.
        out: folder of the export, created when all files are written. An existing identical
            export is kept; an interrupted one is resumed.
        options: see `ExportOptions`.
        jobs: where the frames are written.

    Returns:
        The sidecar, which describes what was exported.

    Raises:
        ToolkitError: there is no ground truth or it is outdated, a label is wrong, the layout
            cannot represent the scene, a frame failed, or `out` has other content.
    """
    options = options or ExportOptions()
    out = Path(out)
    exporter = get_exporter(format_name, options.settings)
    documents = _documents_digest(scene)
    target, frames, digest = _begun(scene, exporter, format_name, out, options, documents)
    if state_of(out, digest) == "same":
        logger.info("%s: this export already exists", out)
        from std_toolkit.io.documents import read_document

        return read_document(out / SIDECAR_NAME, Sidecar)
    if jobs is None and len(target.frames) < _SERIAL_BELOW:
        jobs = JobOptions(engine="serial")
    with staging_area(out, overwrite=options.overwrite) as staging:
        staged = replace(target, root=staging)
        models, mesh_files = exporter.write_models(staged)
        job = partial(
            _export_frame,
            root=str(scene.root),
            documents=documents,
            staging=str(staging),
            format_name=format_name,
            options=options,
        )
        items = [(f, replace(made, root=staging)) for f, made in frames.items()]
        report = run_jobs(
            job, items, name=f"export {format_name}", key=lambda x: str(x[0]), options=jobs
        )
        report.raise_if_failed()
        rows = list(report.results.values())
        written = exporter.finish(staged, rows, models)
        others = [*mesh_files, *written]
        return _close(exporter, staged, format_name, digest, rows, models, others)


def export_digest(scene: Scene, format_name: str, out: Path, options: ExportOptions) -> str:
    """Digest of everything that determines an export, as its sidecar has it; nothing is written.

    Raises:
        ToolkitError: see `export_scene`.
    """
    exporter = get_exporter(format_name, options.settings)
    return _begun(scene, exporter, format_name, out, options, _documents_digest(scene))[2]


def _begun(
    scene: Scene,
    exporter: Exporter,
    format_name: str,
    out: Path,
    options: ExportOptions,
    documents: str,
) -> tuple[Target, dict[int, Artefact], str]:
    """Contents of an export, its frames by id, and its digest."""
    if out.resolve().is_relative_to(scene.root.resolve()):
        raise ToolkitError("an export cannot be inside its scene", path=out, field="--out")
    target = plan(scene, out, options)
    refuse_wrong(target)
    exporter.check(target)
    frames = {f.id: _frame_artefact(target, f, format_name, documents) for f in target.frames}
    return target, frames, _export_digest(target, format_name, frames)


def plan(scene: Scene, root: Path, options: ExportOptions) -> Target:
    """Frames, objects and models of an export.

    Raises:
        ToolkitError: no ground truth, or it is older than the labels; or no label fits and `only`
            asks for those that do.
    """
    rendered = set(rendered_frames(scene))
    frames = tuple(f for f in scene.frames if f.id in rendered)
    if not frames:
        raise ToolkitError(
            "nothing to export: no frame has ground truth",
            path=scene.root,
            hint="run `std-curate render` first",
        )
    flags = read_check_flags(scene)
    dropped = _dropped(scene, frames, flags) if options.drop_bad_frames else {}
    frames = tuple(f for f in frames if f.id not in dropped)
    if not frames:
        raise ToolkitError(
            "nothing to export: the check found a fault in every frame",
            path=scene.root / "check" / "report.json",
            field="--drop-bad-frames",
            hint="fix what the report names, or export without the option",
        )
    quality = label_quality(scene, flags)
    without: dict[int, str] = {}
    if options.only == "fits":
        bad = [x for x in quality.labels if x.grade != "fits"]
        without = {x.object: f"{x.grade}: {x.reason}" for x in bad}
    seen: set[int] = set()
    for frame in frames:
        truth = read_frame_truth(scene, frame.id)
        check_fresh(scene, truth)
        faulty = faulty_objects(frame.id, flags, options)
        seen.update({row.object for row in truth.objects} - {*without, *faulty})
    if not seen:
        raise ToolkitError(
            "nothing to export: no object is left",
            path=scene.root,
            field="--only" if without else "--drop-bad-frames",
            hint="run `std-curate check` and fix the labels that it names, or export without the "
            "option",
        )
    used = {scene.objects.object(i).model for i in seen}
    models = tuple(m.id for m in scene.objects.models if m.id in used)
    return Target(
        scene,
        root,
        options,
        frames,
        tuple(sorted(seen)),
        models,
        flags=flags,
        dropped=dropped,
        quality=quality,
        without=without,
    )


def _dropped(
    scene: Scene, frames: Sequence[model.Frame], flags: CheckFlags | None
) -> dict[int, str]:
    """The frames with a fault of their own, and the fault.

    Raises:
        ToolkitError: there is no report of the check, or it is outdated.
    """
    if flags is None:
        raise ToolkitError(
            "there is no current report of the check",
            path=scene.root,
            field="--drop-bad-frames",
            hint="run `std-curate check` first",
        )
    return {f.id: f"check: {why}" for f in frames if (why := flags.frames.get(f.id))}


def _export_frame(
    item: tuple[int, Artefact],
    *,
    root: str,
    documents: str,
    staging: str,
    format_name: str,
    options: ExportOptions,
) -> FrameRow:
    frame_id, artefact = item
    target = _staged_target(root, documents, staging, options)
    path = progress_path(target.root, frame_id)
    if (progress := artefact.find(path, Progress)) is not None:
        return progress.row
    exporter = get_exporter(format_name, options.settings)
    row = exporter.write_frame(target, target.scene.frame(frame_id))
    made = artefact.record(target.root / name for name in row.outputs)
    write_document(path, Progress(**msgspec.structs.asdict(made), row=row))
    return row


@lru_cache(maxsize=2)
def _staged_target(
    root: str,
    documents: str,  # noqa: ARG001 - part of the cache's key
    staging: str,
    options: ExportOptions,
) -> Target:
    return plan(Scene.open(root), Path(staging), options)


def _close(
    exporter: Exporter,
    target: Target,
    format_name: str,
    digest: str,
    rows: list[FrameRow],
    models: list[ExportedModel],
    others: list[str],
) -> Sidecar:
    staging = target.root
    drop_strangers(staging, _expected(staging, target, rows, others))
    scene = target.scene
    exported = {f.id for f in target.frames}
    color = {f.camera: color_camera(scene, f) for f in target.frames}
    labels = {key: exporter.label_camera(target, camera) for key, camera in color.items()}
    policies = {
        (r.truth.policy, r.truth.delta_m, r.truth.renderer): Visibility(
            policy=r.truth.policy, delta_m=r.truth.delta_m, renderer=r.truth.renderer
        )
        for r in rows
    }
    sidecar = Sidecar(
        layout=format_name,
        folder=exporter.folder(target),
        version=__version__,
        digest=digest,
        scene=_scene_info(scene, {k: model.CameraModel.of(c) for k, c in sorted(color.items())}),
        label_cameras={k: model.CameraModel.of(c) for k, c in sorted(labels.items())},
        frames=[r.frame for r in rows],
        left_out=[
            LeftOut(id=f.id, name=f.name, reason=target.dropped.get(f.id, "no ground truth"))
            for f in scene.frames
            if f.id not in exported
        ],
        models=models,
        objects=_objects(target),
        labels=_labels(target, rows),
        poses=_poses(scene, exported),
        visibility=list(policies.values()),
        quaternion=exporter.quaternion(target),
        left_out_objects=left_out_objects(scene, target.without),
        quality=target.quality,
        files=file_digests(staging),
    )
    write_document(staging / SIDECAR_NAME, sidecar)
    return sidecar


def _expected(staging: Path, target: Target, rows: list[FrameRow], others: list[str]) -> set[str]:
    """Files that belong to the export, and the records of its progress."""
    files = {name for row in rows for name in row.outputs} | set(others)
    records = [progress_path(staging, f.id) for f in target.frames]
    return files | {p.relative_to(staging).as_posix() for p in records if p.is_file()}


def _scene_info(scene: Scene, cameras: dict[str, model.CameraModel]) -> model.SceneInfo:
    info = scene.info
    return model.SceneInfo(
        name=info.name,
        cameras=cameras,
        depth_scale=info.depth_scale,
        depth_correction=info.depth_correction,
        source=info.source,
    )


def _objects(target: Target) -> model.ObjectTable:
    table = target.scene.objects
    return model.ObjectTable(
        models=[m for m in table.models if m.id in target.model_ids],
        objects=[o for o in table.objects if o.id in target.object_ids],
    )


def _labels(target: Target, rows: list[FrameRow]) -> model.Labels:
    """The labels of the exported objects, given in exported frames only.

    A label whose annotated frame is not exported moves to another annotated view or, without one,
    to the first exported frame with a pose of the object.
    """
    poses = {r.frame.id: {o.object: o.T_cam_obj for o in r.frame.objects} for r in rows}
    kept = []
    for label in target.scene.labels.labels:
        if label.object not in target.object_ids:
            continue
        views = {key: T for key, T in label.views.items() if int(key) in poses}
        frame, T_cam_obj = label.frame, label.T_cam_obj
        if frame not in poses:
            shown = (f for f, objects in poses.items() if label.object in objects)
            frame = min(map(int, views)) if views else next(shown)
            T_cam_obj = views.pop(str(frame), poses[frame][label.object])
        # `Sidecar.quality` says what is known of the label now.
        kept.append(
            msgspec.structs.replace(
                label, frame=frame, T_cam_obj=T_cam_obj, views=views, judgement=msgspec.UNSET
            )
        )
    return model.Labels(labels=kept)


def _poses(scene: Scene, exported: set[int]) -> model.CameraPoses | None:
    poses = scene.poses
    if poses is None:
        return None
    return model.CameraPoses(
        frames=[p for p in poses.frames if p.frame in exported],
        scale=poses.scale,
        gates=poses.gates,
        source=poses.source,
        notes=poses.notes,
    )


def _documents_digest(scene: Scene) -> str:
    names = ("scene.json", "frames.json", "objects.json", "poses.json")
    files = digest_files(scene.root, [scene.root / name for name in names])
    return digest_of(files, scene.labels.without_judgements())


def _frame_artefact(
    target: Target, frame: model.Frame, format_name: str, documents: str
) -> Artefact:
    scene, flags = target.scene, target.flags
    files = [info_path(scene.root, frame.id), scene.color_path(frame)]
    files += [] if frame.depth is None else [scene.root / frame.depth]
    faults = None
    if flags is not None:
        objects = [[i, why] for (of, i), why in flags.objects.items() if of == frame.id]
        faults = [flags.frames.get(frame.id, ""), objects]
    inputs = digest_files(scene.root, files)
    left_out = sorted(target.left_out(frame.id))
    inputs |= {"documents": documents, "faults": digest_of(faults, left_out)}
    used = {"objects": target.object_ids, "models": target.model_ids}
    options = _options(target, format_name) | used
    return Artefact(target.root, f"exported frame {frame.id}", inputs, options)


def _export_digest(target: Target, format_name: str, frames: dict[int, Artefact]) -> str:
    scene = target.scene
    meshes = [scene.mesh_path(scene.objects.model(m)) for m in target.model_ids]
    return digest_of(
        _options(target, format_name),
        [frame.digest for frame in frames.values()],
        digest_files(scene.root, meshes),
        sorted(target.dropped.items()),
        sorted(target.without.items()),
        target.quality,
    )


def _options(target: Target, format_name: str) -> dict[str, object]:
    names = ("label_size", "scene_number", "split", "quaternion", "scene_name", "model_ids")
    given = {name: getattr(target.options, name) for name in names}
    return {"format": format_name, **given, "settings": sorted(target.options.settings)}
