"""Contents of a scene, what is missing, and the next command."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from std_toolkit.errors import listed
from std_toolkit.html.table import Cell, Column, Row, Table
from std_toolkit.scene.check_flags import (
    read_check_flags,
    report_is_current,
    scene_fingerprint,
)
from std_toolkit.scene.label_verdicts import UNCHECKED, LabelVerdict, image_sizes, label_verdicts
from std_toolkit.scene.scene import Scene

# "restore" files, "fix" causes of failed gates, "label" and "look" at labels are for people, the
# others are commands; "" is a scene that is complete.
Step = Literal["restore", "poses", "label", "propagate", "render", "check", "fix", "look", ""]
# A recording of a phone may have a camera for each image.
_MOST_CAMERAS = 8


@dataclass(frozen=True)
class SceneSummary:
    """Counts of the contents of a scene.

    Attributes:
        cameras: one line per camera.
        frames_with_depth, frames_with_color: number of `frames` whose file exists.
        missing_files: scene-relative paths of frames and meshes that do not exist.
        scale: sentence on the unit of the poses; None without poses.
        registered: frames with a camera pose; None without poses.
        failed_gates: names of the gates of the camera poses that failed.
        labelled, propagated, refined: object names.
        ground_truth: frames whose ground truth is complete and up to date.
        stale_ground_truth: frames whose ground truth is older than labels or camera poses.
        report: whether the check report exists.
        stale_report: whether it belongs to other labels, camera poses or meshes.
        check_passed: whether the check passed; None without a current report.
        check_gates: sentences on the gates of the scene that the check failed.
        verdicts: one per labelled object.
        reference: kinds of maps from the import.
        next_step: what is missing, see `Step`.
        next_command: what to run next, or None if the scene is complete.
    """

    root: Path
    name: str
    source: str
    cameras: list[str]
    frames: int
    frames_with_color: int
    frames_with_depth: int
    missing_files: list[str]
    depth_scale: float | None
    depth_correction: float
    registered: int | None
    scale: str | None
    failed_gates: list[str]
    objects: list[str]
    labelled: list[str]
    propagated: list[str]
    refined: list[str]
    ground_truth: int
    stale_ground_truth: int
    report: bool
    stale_report: bool
    check_passed: bool | None
    check_gates: list[str]
    verdicts: list[LabelVerdict]
    reference: list[str]
    next_step: Step = ""
    next_command: str | None = None

    def lines(self) -> list[str]:
        """The summary as text, one fact per line."""
        have_depth = f"{self.frames_with_depth} with sensor depth"
        if self.frames_with_depth and self.depth_correction != 1:
            have_depth += f" (corrected by {self.depth_correction:g})"
        rows = [
            ("scene", f"{self.name} ({self.source or 'unknown source'})"),
            *(("camera", line) for line in self.cameras[:_MOST_CAMERAS]),
            *(("camera", f"... {n} more") for n in [len(self.cameras) - _MOST_CAMERAS] if n > 0),
            ("frames", f"{self.frames}, {have_depth}"),
            ("poses", self._poses()),
            ("scale", self.scale or "none"),
            ("objects", ", ".join(self.objects) or "none"),
            ("labels", self._labels()),
            ("ground truth", self._ground_truth()),
            ("check", self._report()),
            *(("FAIL", gate) for gate in self.check_gates),
            *(("verdict", verdict.line()) for verdict in self.verdicts if self.report),
        ]
        if self.reference:
            rows.append(("reference", f"from the import: {', '.join(self.reference)}"))
        if self.missing_files:
            rows.append(("MISSING", listed(self.missing_files, 3)))
        rows.append(("next", self.next_command or f"complete; {self._export()}"))
        return [f"{key:<13} {value}" for key, value in rows]

    def _poses(self) -> str:
        if self.registered is None:
            return "none"
        gates = f"; FAILED gates: {', '.join(self.failed_gates)}" if self.failed_gates else ""
        return f"{self.registered} of {self.frames} frames registered{gates}"

    def _ground_truth(self) -> str:
        text = f"{self.ground_truth} of {self.frames} frames"
        if self.stale_ground_truth:
            text += f"; OUTDATED in {self.stale_ground_truth}: labels or poses changed"
        return text

    def _report(self) -> str:
        if self.stale_report:
            return "report OUTDATED: labels, poses or meshes changed"
        if self.check_passed is None:
            return "no report"
        return f"report written, {'passed' if self.check_passed else 'FAILED'}"

    def _export(self) -> str:
        unknown = [v.name for v in self.verdicts if v.grade == "unknown"]
        about = f"; nothing is known of the labels of {', '.join(unknown)}" if unknown else ""
        return f"export with `std-curate export`{about}"

    def _labels(self) -> str:
        if not self.objects:
            return "none"
        text = f"{len(self.labelled)} of {len(self.objects)} objects labelled"
        if self.labelled:
            text += f", {len(self.propagated)} propagated, {len(self.refined)} refined"
        without = [o for o in self.objects if o not in self.labelled]
        return text + (f"; without label: {', '.join(without)}" if without else "")


def summarise(scene: Scene) -> SceneSummary:
    """Summarise the documents and files of a scene; reads no pixels.

    Raises:
        ToolkitError: a document breaks its schema.
    """
    poses, labels = scene.poses, scene.labels
    sizes = image_sizes(scene)
    colors = [f.color for f in scene.frames]
    missing = [name for name in colors if sizes[name] < 0]
    with_color = len(colors) - len(missing)
    missing += [f.depth for f in scene.frames if f.depth and sizes[f.depth] < 0]
    missing += [m.mesh for m in scene.objects.models if not (scene.root / m.mesh).is_file()]
    names = {o.id: o.name for o in scene.objects.objects}
    reference = scene.root / "reference"
    report = (scene.root / "check" / "report.html").is_file()
    current, stale = _ground_truth_counts(scene)
    fingerprint = scene_fingerprint(scene) if report else ""
    flags = read_check_flags(scene, fingerprint) if report else None
    found = SceneSummary(
        root=scene.root,
        name=scene.info.name,
        source=scene.info.source,
        cameras=[_camera_line(key, scene) for key in sorted(scene.info.cameras)],
        frames=len(scene.frames),
        frames_with_color=with_color,
        frames_with_depth=sum(f.depth is not None for f in scene.frames),
        missing_files=missing,
        depth_scale=scene.info.depth_scale,
        depth_correction=scene.info.depth_correction,
        registered=None if poses is None else len(scene.registered_frames()),
        scale=_scale_line(scene),
        failed_gates=[] if poses is None else [g.name for g in poses.gates if not g.passed],
        objects=[o.name for o in scene.objects.objects],
        labelled=[names[x.object] for x in labels.labels],
        propagated=[names[x.object] for x in labels.labels if x.T_world_obj is not None],
        refined=[names[x.object] for x in labels.labels if x.refined],
        ground_truth=current,
        stale_ground_truth=stale,
        report=report,
        stale_report=report and not report_is_current(scene, fingerprint),
        check_passed=None if flags is None else flags.passed,
        check_gates=[] if flags is None else [str(gate) for gate in flags.gates],
        verdicts=label_verdicts(scene, sizes),
        reference=sorted(p.name for p in reference.iterdir()) if reference.is_dir() else [],
    )
    step, command = _next(found)
    return replace(found, next_step=step, next_command=command)


@dataclass(frozen=True)
class FrameSummary:
    """One frame of a scene.

    Attributes:
        id, name: as in frames.json.
        color, depth: paths of its images, relative to the scene folder; depth may be None.
        registered: whether it has a camera pose.
        labelled: names of the objects with a pose in this frame.
        annotated: names of the objects whose pose was set in this frame.
    """

    id: int
    name: str
    color: str
    depth: str | None
    registered: bool
    labelled: list[str]
    annotated: list[str]


def list_frames(scene: Scene) -> list[FrameSummary]:
    """One row per frame, in recording order; reads no pixels."""
    names = {o.id: o.name for o in scene.objects.objects}
    rows = []
    for frame in scene.frames:
        annotated = [
            names[x.object]
            for x in scene.labels.labels
            if x.frame == frame.id or str(frame.id) in x.views
        ]
        registered = scene.T_world_cam(frame.id) is not None
        everywhere = [
            names[x.object] for x in scene.labels.labels if registered and x.T_world_obj is not None
        ]
        labelled = [n for n in names.values() if n in annotated or n in everywhere]
        rows.append(
            FrameSummary(
                frame.id, frame.name, frame.color, frame.depth, registered, labelled, annotated
            )
        )
    return rows


def frame_table(rows: Sequence[FrameSummary]) -> Table:
    """The frames as a table: id, name, file, registered, number of labels, annotated objects."""
    columns = [
        Column(heading="id"),
        *(Column(heading=h, numeric=False) for h in ("name", "file", "registered")),
        Column(heading="labelled"),
        Column(heading="annotated", numeric=False),
    ]
    return Table(
        columns=columns,
        rows=[
            Row(
                [
                    Cell(text=str(row.id)),
                    Cell(text=row.name),
                    Cell(text=row.color),
                    Cell(text="yes" if row.registered else "no"),
                    Cell(text=str(len(row.labelled))),
                    Cell(text=", ".join(row.annotated)),
                ]
            )
            for row in rows
        ],
    )


def _next(found: SceneSummary) -> tuple[Step, str | None]:
    scene = shlex.quote(str(found.root))
    if found.missing_files:
        what = f"restore the missing files or import again: {found.missing_files[0]}"
        return "restore", what
    if found.registered is None:
        alone = f" (not needed to render only the annotated frames: std-curate render {scene})"
        return "poses", f"std-curate poses {scene}{alone if found.labelled else ''}"
    if found.failed_gates:
        return "fix", f"fix the causes of the failed gates, then std-curate poses {scene}"
    if not found.objects or len(found.labelled) < len(found.objects):
        return "label", f"std-curate label {scene} ..."
    if len(found.propagated) < len(found.labelled):
        return "propagate", f"std-curate propagate {scene} --refine"
    if found.stale_ground_truth or found.ground_truth < (found.registered or 0):
        return "render", f"std-curate render {scene}"
    if found.check_passed is None or any(v.reason == UNCHECKED for v in found.verdicts):
        return "check", f"std-curate check {scene}"
    report = "(check/report.html)"
    if found.check_gates:
        then = f"fix the causes of the failed gates {report}, then std-curate run {scene}"
        return "fix", then
    bad = [v for v in found.verdicts if v.grade in ("wrong", "doubtful")]
    if not found.check_passed or any(v.grade == "wrong" for v in bad):
        names = f"the labels of {', '.join(v.name for v in bad)}" if bad else "the labels"
        then = f"look at {names} {report} and correct them, then std-curate run {scene}"
        return "look", then
    return "", None


def _camera_line(key: str, scene: Scene) -> str:
    poses = scene.poses
    refined = poses is not None and key in poses.cameras
    camera = (poses.cameras if poses is not None and refined else scene.info.cameras)[key]
    bent = f", distortion {' '.join(f'{d:.4g}' for d in camera.distortion)}"
    return (
        f"{key}: {camera.width}x{camera.height}, fx {camera.fx:.2f} fy {camera.fy:.2f} "
        f"cx {camera.cx:.2f} cy {camera.cy:.2f}{bent if any(camera.distortion) else ''}"
        f"{' (refined)' if refined else ''}"
    )


def _scale_line(scene: Scene) -> str | None:
    poses = scene.poses
    if poses is None:
        return None
    if poses.scale is None:
        return "metric, as imported"
    if poses.scale.unit != "metre":
        return "UNKNOWN: the poses are not in metres"
    used = poses.scale.fused or [poses.scale.chosen]
    text = f"metres from {', '.join(used)}, +- {poses.scale.applied_sigma:.2%}"
    factors = [e.factor for e in poses.scale.estimates]
    if len(factors) > 1:
        text += f", {len(factors)} sources within {max(factors) / min(factors) - 1:.2%}"
    elif poses.scale.chosen == "depth":
        text += " alone (good to 1-2 %)"
    return text


def _ground_truth_counts(scene: Scene) -> tuple[int, int]:
    """Frames with current and with outdated ground truth."""
    if not (scene.root / "gt").is_dir():
        return 0, 0
    from std_toolkit.rendering.ground_truth import rendered_frames
    from std_toolkit.rendering.placements import current_truths

    frames = rendered_frames(scene)
    current = current_truths(scene, frames)
    return current, len(frames) - current
