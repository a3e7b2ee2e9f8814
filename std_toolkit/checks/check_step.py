"""The check step: measures, evaluates gates, draws, writes; skipped if nothing changed."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks import result
from std_toolkit.checks.gates.judge import all_gates, judge_scene
from std_toolkit.checks.inject.inject import inject_faults
from std_toolkit.checks.judgements import store_judgements
from std_toolkit.checks.measure import coverage, object_sizes, residuals
from std_toolkit.checks.measure.array_file import ArrayFile
from std_toolkit.checks.measure.coverage import spread
from std_toolkit.checks.measure.textures import compare_textures
from std_toolkit.checks.page import figures, overlay
from std_toolkit.checks.page.report import PageParts, render_page
from std_toolkit.checks.page.shape_figure import shape_blocks
from std_toolkit.checks.page.view3d import Cloud, fused_cloud, scene_figure, sparse_cloud
from std_toolkit.checks.shapes import find_shapes, with_shapes
from std_toolkit.io.atomic import sweep_temporaries, write_bytes_atomic
from std_toolkit.io.documents import digest_files, document_bytes, read_document
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.jobs.artefact import Artefact
from std_toolkit.options import CheckOptions
from std_toolkit.rendering.ground_truth import info_path, map_paths
from std_toolkit.scene import Frame, Scene
from std_toolkit.scene.check_flags import SCENE_INPUT, scene_fingerprint

STEP = "check"
FOLDER = "check"
_CLOSEUPS = 4
_DEPTH_PANELS = 3
_DRAWN_HERE = 30
# Columns of report.csv: fields of the object, and parts of its values.
_FIELDS = (
    "object", "name", "model", "category", "material", "label", "annotated_frame", "frames_seen",
)  # fmt: skip
_AXES = ("motion_x_mm", "motion_y_mm", "motion_z_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")
_COLUMNS: dict[str, tuple[str, str | int]] = {
    **{key: (key, "value") for key in (
        "visible_fraction", "edge_px", "edge_p90_px", "edge_tail_px", "edge_support",
        "edge_chance_px", "depth_mm", "depth_mad_mm", "depth_unscaled_mm", "distance_m",
        "shift_px", "shift_share", "shift_spread_px",
    )},
    **{f"offset_{axis}_mm": ("offset_mm", i) for i, axis in enumerate("xyz")},
    "offset_norm_mm": ("offset_mm", "value"),
    "drift_px": ("drift_px", "value"),
    "drift_mm": ("drift_mm", "value"),
    "drift_frames": ("drift_px", "frames"),
    "motion_mm": ("motion_mm", "value"),
    "motion_std_mm": ("motion_mm", "std"),
    "motion_deg": ("motion_deg", "value"),
    "motion_std_deg": ("motion_deg", "std"),
    **{column: ("motion_mm", i) for i, column in enumerate(_AXES)},
    "size_error": ("size_error", "value"),
    "size_std": ("size_error", "std"),
    "confirmed": ("confirmed", "text"),
    "confirmed_share": ("confirmed", "value"),
    "label_std_mm": ("label_std_mm", "value"),
    "label_std_deg": ("label_std_deg", "value"),
    "weak_direction": ("label_std_mm", "text"),
    **{key: (key, "value") for key in (
        "azimuth_span_deg", "elevation_min_deg", "elevation_max_deg", "parallax_deg",
        "largest_step_deg", "completeness", "raw_median_mm", "raw_mae_mm", "raw_rmse_mm",
    )},
    "texture_verdict": ("texture", "text"),
    "texture_score": ("texture", "value"),
    "texture_rival_score": ("texture_rival", "value"),
    "texture_frames": ("texture", "frames"),
    "texture_text": ("texture_rival", "text"),
}  # fmt: skip
_TRUTH = {"yes": True, "no": False}


def run_check(
    scene: Scene, options: CheckOptions | None = None, jobs: JobOptions | None = None
) -> result.CheckReport:
    """Check the labels of a scene and write `check/report.html`, `.json`, `.csv`, `frames.csv`.

    The judgement of each label is stored with it in labels.json. A failed gate is reported, not
    raised. `CheckReport.missing` lists what the scene lacks (poses, labels, depth, ground truth).

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
        fingerprint = scene_fingerprint(scene)
        inputs = {
            SCENE_INPUT: fingerprint,
            "gates": " ".join(gate.key for gate in all_gates()),
            "version of plotly": version("plotly"),
        }
        artefact = Artefact(
            scene.root,
            STEP,
            inputs | _files(scene, frames),
            asdict(options),
            limits=("checks.", "labels."),
        )
        if artefact.is_kept():
            report = read_document(scene.root / FOLDER / "report.json", result.CheckReport)
            store_judgements(scene, report, options)
            return report
        with ArrayFile(scene.root / ".std") as arrays:
            report, page = _check(scene, frames, fingerprint, options, jobs, arrays)
        outputs = {
            "report.html": page.encode(),
            "report.csv": objects_csv(report),
            "frames.csv": frames_csv(report),
            "report.json": document_bytes(report),
        }
        for name, data in outputs.items():
            write_bytes_atomic(scene.root / FOLDER / name, data)
        artefact.write([scene.root / FOLDER / name for name in outputs])
        store_judgements(scene, report, options)
    return report


def report_path(root: Path) -> Path:
    """Path of the HTML report of a scene."""
    return root / FOLDER / "report.html"


def _check(
    scene: Scene,
    frames: list[Frame],
    fingerprint: str,
    options: CheckOptions,
    jobs: JobOptions | None,
    arrays: ArrayFile,
) -> tuple[result.CheckReport, str]:
    work: dict[str, Any] = {"root": scene.root, "fingerprint": fingerprint, "options": options}
    observed_job = run_jobs(
        partial(residuals.observe_frame, **work),
        [f.id for f in frames],
        name="check",
        options=jobs,
        keep=lambda seen: seen.filed(arrays),
    )
    observed = list(observed_job.results.values())
    problems = {int(k): v for k, v in observed_job.failed.items()}
    readable = [f for f in frames if f.id not in problems]

    sparse, fused = sparse_cloud(scene), fused_cloud(scene, readable)
    up = _up(scene, sparse or fused)
    compared = compare_textures(scene, readable)
    sizes = object_sizes.measure_sizes(scene)
    report = judge_scene(scene, observed, problems, options, up=up, compared=compared, sizes=sizes)
    if sparse is None and report.summary.registered:
        report.missing.append("The points of the reconstruction (poses/points.ply).")

    shapes = find_shapes(scene, report, readable, options)
    report = with_shapes(report, shapes)
    if options.inject:
        found = inject_faults(scene, observed, fingerprint, options, jobs, up=up)
        report = msgspec.structs.replace(report, detectability=found)
    orders = _drawing_orders(readable, report.objects, options)
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
    sky = figures.sky_figure(_sky(scene, report.objects, up), report.objects)
    parts = PageParts(view3d, sky, pictures, shape_blocks(report.objects, shapes))
    return report, render_page(report, parts)


def _drawing_orders(
    frames: list[Frame], objects: list[result.ObjectCheck], options: CheckOptions
) -> list[overlay.DrawingOrder]:
    """Whole spread frames; close-ups of every object in annotated, worst and spread frames."""
    limits = coverage.CoverageSettings.current()
    whole = [f.id for f in spread(frames, max(options.overlay_frames, 1))]
    if options.overlay_frames == 0:
        whole = []
    with_depth = [f for f in frames if f.depth is not None and f.id in whole]
    deep = {f.id for f in spread(with_depth, _DEPTH_PANELS)}
    known = {f.id for f in frames}
    closeups: dict[int, set[int]] = {}
    for item in objects:
        seen = [f for f in item.frames if f.visible_fraction >= limits.seen_fraction] or item.frames
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
    limits = coverage.CoverageSettings.current()
    views = {}
    for item in objects:
        seen = [f for f in item.frames if f.visible_fraction >= limits.seen_fraction]
        found = coverage.view_directions(scene, item.object, [f.frame for f in seen], up)
        if found is not None:
            views[item.object] = (*found, seen)
    return views


def _up(scene: Scene, cloud: Cloud | None) -> NDArray[np.float64]:
    poses = [T for f in scene.registered_frames() if (T := scene.T_world_cam(f.id)) is not None]
    return coverage.scene_up(poses, None if cloud is None else cloud.xyz.astype(np.float64))


def _files(scene: Scene, frames: list[Frame]) -> dict[str, str]:
    """Digests of the files of the frames by path."""
    files = [scene.root / "poses" / "points.ply"]
    for frame in frames:
        files.append(scene.color_path(frame))
        if frame.depth is not None:
            files.append(scene.root / frame.depth)
        if info_path(scene.root, frame.id).is_file():
            maps = map_paths(scene.root, frame.id)
            files += [info_path(scene.root, frame.id), maps["mask"], maps["depth"]]
    return digest_files(scene.root, files)


def objects_csv(report: result.CheckReport) -> bytes:
    """One row per object; motions become one column per number.

    Values without a column of their own are the last columns.
    """
    known = {key for key, _ in _COLUMNS.values()}
    others = list(
        dict.fromkeys(v.key for o in report.objects for v in o.values if v.key not in known)
    )
    return _csv(
        [_object_row(item, others) for item in report.objects],
        [*_FIELDS, *_COLUMNS, "verdict", *others],
    )


def _object_row(item: result.ObjectCheck, others: Sequence[str]) -> dict[str, Any]:
    row: dict[str, Any] = {name: getattr(item, name) for name in (*_FIELDS, "verdict")}
    for column, (key, part) in _COLUMNS.items():
        entry = item.entry(key)
        if isinstance(part, int):
            row[column] = None if entry is None or entry.motion is None else entry.motion[part]
        elif entry is not None:
            row[column] = getattr(entry, part)
        elif part == "frames":
            row[column] = 0
    row["confirmed"] = _TRUTH.get(row.get("confirmed", ""))
    return row | {key: item.value(key) for key in others}


def frames_csv(report: result.CheckReport) -> bytes:
    """One row per frame of the recording."""

    rows = [msgspec.to_builtins(frame) for frame in report.frames]
    return _csv(rows, [f.name for f in msgspec.structs.fields(result.FrameCheck)])


def _csv(rows: Sequence[dict[str, Any]], columns: list[str]) -> bytes:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    for row in rows:
        values = (row.get(name) for name in columns)
        table.writerow("" if v is None or v != v else v for v in values)  # NaN is empty too
    return text.getvalue().encode()
