"""The check step: measures, evaluates gates, draws, writes; skipped if nothing changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks import (
    aggregate,
    contours,
    coverage,
    figures,
    overlay,
    report_warnings,
    residuals,
    result,
)
from std_toolkit.checks.gates import evaluate_gates, evaluate_object, scale_share
from std_toolkit.checks.report import PageParts, render_page
from std_toolkit.checks.view3d import Cloud, fused_cloud, scene_figure, sparse_cloud
from std_toolkit.errors import ToolkitError
from std_toolkit.io.atomic import sweep_temporaries, write_bytes_atomic
from std_toolkit.io.documents import document_bytes, read_document
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.log import logger
from std_toolkit.options import CheckOptions
from std_toolkit.rendering.ground_truth import info_path, map_paths
from std_toolkit.scene import Frame, Scene, document

STEP = "check"
FOLDER = "check"
_CLOSEUPS = 4
_DEPTH_PANELS = 3
_DRAWN_HERE = 30


def run_check(
    scene: Scene, options: CheckOptions | None = None, jobs: JobOptions | None = None
) -> result.CheckReport:
    """Check the labels of a scene and write `check/report.html`, `.json`, `.csv`, `frames.csv`.

    A failed gate is reported, not raised. `CheckReport.missing` lists what the scene lacks (poses,
    labels, depth, ground truth).

    Args:
        scene: an open scene.
        options: limits and number of frames.
        jobs: where the frames are processed.

    Returns:
        The report; read from disk if inputs and files did not change since the last check.

    Raises:
        ToolkitError: a document of the scene is damaged, or another process writes to the scene.
    """
    options = options or CheckOptions()
    with scene.lock():
        sweep_temporaries(scene.root)
        frames = spread(scene.registered_frames(), options.max_frames)
        fingerprint = _fingerprint(scene)
        digest = document.digest_of(
            fingerprint, asdict(options), version("plotly"), _file_digests(scene, frames)
        )
        if document.is_fresh(scene.root, STEP, digest):
            logger.info("check: nothing changed, the report is up to date")
            return read_document(scene.root / FOLDER / "report.json", result.CheckReport)
        report, page = _check(scene, frames, fingerprint, options, jobs)
        outputs = {
            "report.html": page.encode(),
            "report.csv": result.objects_csv(report),
            "frames.csv": result.frames_csv(report),
            "report.json": document_bytes(report),
        }
        for name, data in outputs.items():
            write_bytes_atomic(scene.root / FOLDER / name, data)
        document.write_record(
            scene.root,
            STEP,
            digest,
            outputs=[scene.root / FOLDER / name for name in outputs],
            parameters=asdict(options) | {"scene": fingerprint},
        )
    return report


def report_is_current(scene: Scene) -> bool:
    """Whether the last report belongs to the current labels, camera poses and meshes.

    Reads no image. A report whose record was deleted counts as current.
    """
    try:
        record = read_document(document.record_path(scene.root, STEP), document.Record)
    except ToolkitError:
        return True
    return record.parameters.get("scene", "") in ("", _fingerprint(scene))


def report_path(root: Path) -> Path:
    """Path of the HTML report of a scene."""
    return root / FOLDER / "report.html"


def spread(frames: Sequence[Frame], count: int) -> list[Frame]:
    """At most `count` frames, evenly spaced, with the first and the last; 0 means all."""
    if count == 0 or len(frames) <= count:
        return list(frames)
    return [
        frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, count).round().astype(int))
    ]


def _check(
    scene: Scene,
    frames: list[Frame],
    fingerprint: str,
    options: CheckOptions,
    jobs: JobOptions | None,
) -> tuple[result.CheckReport, str]:
    work: dict[str, Any] = {"root": scene.root, "fingerprint": fingerprint, "options": options}
    observed_job = run_jobs(
        partial(residuals.observe_frame, **work), [f.id for f in frames], name="check", options=jobs
    )
    observed = list(observed_job.results.values())
    problems = {int(k): v for k, v in observed_job.failed.items()}
    readable = [f for f in frames if f.id not in problems]

    sparse, fused = sparse_cloud(scene), fused_cloud(scene, readable)
    up = _up(scene, sparse or fused)
    bias = aggregate.common_depth_bias(scene, observed)
    objects = aggregate.check_objects(scene, observed, up=up, depth_bias=bias)
    rows = aggregate.check_frames(scene, observed, problems)
    materials = aggregate.check_materials(scene, observed)
    summary = _summary(scene, objects, rows, observed, bias)
    objects = [evaluate_object(o, scale_share(summary), options) for o in objects]
    gates = evaluate_gates(summary, objects, rows, scene.poses, options)
    gates += _mesh_gate(scene)
    missing = _missing(scene, summary, observed)
    if sparse is None and summary.registered:
        missing.append("The points of the reconstruction (poses/points.ply).")

    orders = _drawing_orders(readable, objects, options)
    drawn = run_jobs(
        partial(overlay.draw_frame, **work),
        orders,
        name="draw",
        key=lambda o: str(o.frame),
        options=_drawing_jobs(jobs, len(orders)),
    )
    drawn.raise_if_failed()
    pictures: list[overlay.FramePictures] = list(drawn.results.values())
    view3d = scene_figure(scene, up, sparse, fused)
    failed = [g for g in gates if g.status == "fail"]
    report = result.CheckReport(
        scene=scene.info.name,
        passed=not failed,
        verdict=_verdict(failed, summary),
        summary=summary,
        gates=gates,
        warnings=report_warnings.find_warnings(summary, gates, objects, rows, materials, options),
        missing=missing,
        objects=objects,
        frames=rows,
        materials=materials,
        limits={k: float(v) for k, v in asdict(options).items()},
    )
    parts = PageParts(view3d, figures.sky_figure(_sky(scene, objects, up), objects), pictures)
    return report, render_page(report, parts, options)


def _summary(
    scene: Scene,
    objects: list[result.ObjectCheck],
    rows: list[result.FrameCheck],
    observed: list[residuals.FrameObservation],
    bias: float | None,
) -> result.SceneSummary:
    registered = [r for r in rows if r.status == "registered"]
    errors = [r.reprojection_px for r in registered if r.reprojection_px is not None]
    current = sum(o.truth == "current" for o in observed)
    cast = any(o.tallies for o in observed)
    return result.SceneSummary(
        frames=len(rows),
        registered=len(registered),
        looked_at=len(observed),
        reprojection_px=aggregate.rounded(float(np.mean(errors))) if errors else None,
        objects=len(objects),
        labelled=sum(o.label in ("propagated", "refined") for o in objects),
        depth_frames=sum(f.depth is not None for f in scene.frames),
        truth_frames=current,
        truth_source="rendered maps" if current else "labels cast here" if cast else "none",
        depth_bias=aggregate.rounded(bias, 5),
        scale=scene.poses.scale if scene.poses else None,
        poses_source=scene.poses.source if scene.poses else "",
    )


def _missing(
    scene: Scene, summary: result.SceneSummary, observed: list[residuals.FrameObservation]
) -> list[str]:
    found = []
    if scene.poses is None:
        found.append("Camera poses: labels cannot be checked without them; run `std-curate poses`.")
    elif summary.registered == 0:
        found.append("Registered frames: no frame has a camera pose, so no label can be checked.")
    if summary.objects == 0:
        found.append("Objects: objects.json lists none.")
    elif summary.labelled == 0:
        found.append("Labels in the world: run `std-curate label`, then `std-curate propagate`.")
    if summary.depth_frames == 0:
        found.append("Sensor depth: no depth residuals and no comparison with ground truth.")
    if observed and summary.labelled and not any(o.truth != "none" for o in observed):
        found.append(
            "Rendered ground truth (`std-curate render`): visibility considers occlusion by "
            "labelled objects only, and depth is compared with the labels."
        )
    if summary.labelled and summary.reprojection_px is None:
        found.append("Reprojection errors: the camera poses have none.")
    if observed and summary.looked_at < summary.registered:
        found.append(
            f"{summary.registered - summary.looked_at} registered frames: "
            f"{summary.looked_at} evenly spaced ones were measured (--max-frames 0 measures all)."
        )
    return found


def _mesh_gate(scene: Scene) -> list[result.CheckGate]:
    problems = {
        o.name: p
        for o in scene.objects.objects
        if scene.T_world_obj(o.id) is not None and (p := contours.mesh_problem(scene, o.model))
    }
    if not problems:
        return []
    return [
        result.CheckGate(
            key="meshes",
            title="labelled objects whose mesh cannot be read",
            value=float(len(problems)),
            limit=0.0,
            rule="at most",
            status="fail",
            detail=", ".join(problems),
            advice="; ".join(problems.values()),
        )
    ]


def _drawing_orders(
    frames: list[Frame], objects: list[result.ObjectCheck], options: CheckOptions
) -> list[overlay.DrawingOrder]:
    """Whole spread frames; close-ups of every object in annotated, worst and spread frames."""
    whole = [f.id for f in spread(frames, max(options.overlay_frames, 1))]
    if options.overlay_frames == 0:
        whole = []
    with_depth = [f for f in frames if f.depth is not None and f.id in whole]
    deep = {f.id for f in spread(with_depth, _DEPTH_PANELS)}
    known = {f.id for f in frames}
    closeups: dict[int, set[int]] = {}
    for item in objects:
        seen = [
            f for f in item.frames if f.visible_fraction >= coverage.SEEN_FRACTION
        ] or item.frames
        if not seen or not whole:
            continue
        chosen = {seen[i].frame for i in _even(len(seen), _CLOSEUPS)}
        measured = [f for f in seen if f.edge_px is not None]
        if measured:
            chosen.add(max(measured, key=lambda f: f.edge_px or 0).frame)
        if item.annotated_frame in known and item.annotated_frame is not None:
            chosen.add(item.annotated_frame)
        for frame in chosen:
            closeups.setdefault(frame, set()).add(item.object)
    return [
        overlay.DrawingOrder(i, i in whole, tuple(sorted(closeups.get(i, ()))), i in deep)
        for i in sorted(known & {*whole, *closeups})
    ]


def _drawing_jobs(jobs: JobOptions | None, count: int) -> JobOptions | None:
    """Draw few images in this process: starting worker processes takes longer."""
    jobs = jobs or JobOptions()
    if jobs.engine == "local" and count <= _DRAWN_HERE:
        return replace(jobs, engine="serial")
    return jobs


def _even(length: int, count: int) -> list[int]:
    return [int(i) for i in np.unique(np.linspace(0, length - 1, count).round())]


def _sky(
    scene: Scene, objects: list[result.ObjectCheck], up: NDArray[np.float64]
) -> dict[int, tuple[NDArray[np.float64], NDArray[np.float64], list[result.ObjectFrameCheck]]]:
    views = {}
    for item in objects:
        seen = [f for f in item.frames if f.visible_fraction >= coverage.SEEN_FRACTION]
        found = aggregate.view_directions(scene, item.object, [f.frame for f in seen], up)
        if found is not None:
            views[item.object] = (*found, seen)
    return views


def _up(scene: Scene, cloud: Cloud | None) -> NDArray[np.float64]:
    poses = [T for f in scene.registered_frames() if (T := scene.T_world_cam(f.id)) is not None]
    return coverage.scene_up(poses, None if cloud is None else cloud.xyz.astype(np.float64))


def _verdict(failed: list[result.CheckGate], summary: result.SceneSummary) -> str:
    if failed:
        count = f"{len(failed)} gate{'s' if len(failed) > 1 else ''}"
        return f"FAIL: {count}: {', '.join(g.key for g in failed)}"
    if summary.labelled:
        return "PASS: labels usable"
    return "PASS: camera poses usable; there are no labels to check"


def _fingerprint(scene: Scene) -> str:
    """Digest of the documents and meshes, on which the work on every frame depends."""
    meshes = {m.id: _digest_or_none(scene.mesh_path(m)) for m in scene.objects.models}
    return document.digest_of(
        scene.info, scene.frame_table, scene.objects, scene.poses, scene.labels, meshes
    )


def _file_digests(scene: Scene, frames: list[Frame]) -> dict[str, Any]:
    files = [scene.root / "poses" / "points.ply"]
    for frame in frames:
        files.append(scene.color_path(frame))
        if frame.depth is not None:
            files.append(scene.root / frame.depth)
        if info_path(scene.root, frame.id).is_file():
            maps = map_paths(scene.root, frame.id)
            files += [info_path(scene.root, frame.id), maps["mask"], maps["depth"]]
    return {p.relative_to(scene.root).as_posix(): _digest_or_none(p) for p in files}


def _digest_or_none(path: Path) -> str | None:
    return document.digest_file(path) if path.is_file() else None
