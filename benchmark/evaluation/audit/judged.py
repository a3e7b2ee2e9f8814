"""The judge on a group of frames, and its report as rows of the audit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from benchmark.data.labelled import LabelledSet
from benchmark.evaluation.audit.audit_scene import AuditScene, MovedScene
from benchmark.evaluation.audit.pictures import picture_of
from benchmark.evaluation.audit.record import AuditedLabel, Disagreement, Size, plain
from benchmark.evaluation.audit.rigid import Group
from std_toolkit.arrays import Array
from std_toolkit.checks.gates.gate import REFUSED
from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.gates.located import SHIFT, TURN, Located, located_by
from std_toolkit.checks.gates.placement import PlacementSettings
from std_toolkit.checks.judgements import reason_of
from std_toolkit.checks.measure.alignments import measure_alignments
from std_toolkit.checks.measure.contours import LabelCaster, object_centre
from std_toolkit.checks.measure.coverage import scene_up
from std_toolkit.checks.measure.motion import MotionSettings
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame
from std_toolkit.checks.measure.textures import compare_textures
from std_toolkit.checks.result import CheckReport, ObjectCheck
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import so3_exp, so3_log
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.document import safe_name

# Quantile 0.95 of chi square with one, two and three degrees of freedom.
_CHI2 = {1: 3.841, 2: 5.991, 3: 7.815}
_DIRECTIONS = 4000


@dataclass(frozen=True)
class JudgedGroup:
    """What the judge says of a group.

    Attributes:
        labels: its labels.
        disagreements: frames that do not agree with them.
        problems: frames that could not be read.
        without_depth: frames without a sensor's depth.
        pictures: of labels that are doubtful or wrong, JPEG files by name.
    """

    labels: list[AuditedLabel]
    disagreements: list[Disagreement]
    problems: list[str]
    without_depth: int
    pictures: dict[str, bytes]

    @staticmethod
    def joined(found: Sequence[JudgedGroup]) -> JudgedGroup:
        """What is said of several groups."""
        return JudgedGroup(
            [x for g in found for x in g.labels],
            [x for g in found for x in g.disagreements],
            [x for g in found for x in g.problems],
            sum(g.without_depth for g in found),
            {n: data for g in found for n, data in g.pictures.items()},
        )


@dataclass(frozen=True, eq=False)
class Judged:
    """The judge's report on a group.

    Attributes:
        scene: the frames as the judge reads them.
        report: its report.
        located: where the evidence puts the objects that it says something of, by object id.
    """

    scene: AuditScene
    report: CheckReport
    located: Mapping[int, Located]


def judge_group(name: str, group: Group, source: LabelledSet, options: CheckOptions) -> Judged:
    """Judge the labels of a group with the judge of `std-curate check`.

    What the judge measures is linear in the motion of a label. A label that it refuses is therefore
    measured a second time where the first measurement puts the object.

    Args:
        name: of the scene.
        group: the frames.
        source: of their images.
        options: limits.

    Raises:
        ToolkitError: a mesh is damaged.
    """
    scene = AuditScene(name, group, source)
    up = scene_up(list(group.T_world_cam.values()), None)
    if not all(f.has_images for f in group.frames):
        return Judged(scene, judge_scene(scene, [], {}, options, up=up), {})
    report = _report(scene, options, up)
    located = {
        o.object: at for o in report.objects if (at := located_by(o.entry("pose_mm"))) is not None
    }
    refused = {
        o.object: located[o.object]
        for o in report.objects
        if o.verdict in REFUSED and o.object in located
    }
    if refused and group.cameras != "none":
        moved = MovedScene.of(scene, refused)
        again = _report(moved, options, up, only=list(refused))
        for item in again.objects:
            after = located_by(item.entry("pose_mm"))
            if item.object in refused and after is not None:
                located[item.object] = _both(refused[item.object], after)
    return Judged(scene, report, located)


def _report(
    scene: Scene, options: CheckOptions, up: Array, only: Sequence[int] | None = None
) -> CheckReport:
    caster = LabelCaster.of_scene(scene)
    observed: list[FrameObservation] = []
    problems: dict[int, str] = {}
    for frame in scene.frames:
        try:
            observed.append(measure_frame(scene, caster, frame, options, only=only))
        except ToolkitError as error:
            problems[frame.id] = str(error)
    readable = [f for f in scene.frames if f.id not in problems]
    compared = compare_textures(scene, readable, only=only)
    aligned = {}
    if len(readable) == 1 < MotionSettings.current().fewest_frames:
        aligned = measure_alignments(scene, readable[0])
    return judge_scene(
        scene, observed, problems, options, up=up, compared=compared, aligned=aligned, only=only
    )


def _both(first: Located, second: Located) -> Located:
    """The motion that two motions in turn are; the first one itself if the second undoes it."""
    if np.linalg.norm(second.motion[SHIFT]) > np.linalg.norm(first.motion[SHIFT]) + 1 and (
        np.linalg.norm(second.motion[TURN]) > np.linalg.norm(first.motion[TURN]) + 1
    ):
        return first
    turn = so3_exp(np.deg2rad(second.motion[TURN])) @ so3_exp(np.deg2rad(first.motion[TURN]))
    shift = first.motion[SHIFT] + second.motion[SHIFT]
    return Located(np.concatenate([shift, np.rad2deg(so3_log(turn))]), second.covariance)


def audited(
    name: str, group: Group, source: LabelledSet, options: CheckOptions, *, whole: bool = False
) -> JudgedGroup:
    """Judge a group; see `judge_group`.

    Args:
        whole: whether it has all frames of the scene that were read.
    """
    judged = judge_group(name, group, source, options)
    report, scene = judged.report, judged.scene
    name = plain(name)
    alone = group.cameras == "none"
    keys = {k: f.key.name for k, f in enumerate(group.frames)}
    shown = "" if whole else keys[0] if alone else f"{keys[0]} to {keys[len(keys) - 1]}"
    labels = [_audited(item, judged, name, shown, alone=alone) for item in report.objects]
    found = _disagreements(report, scene, group, name, keys, options)
    if alone:
        found += [
            Disagreement(scene=name, frame=keys[0], object=row.object, what=row.reason)
            for row in labels
            if row.verdict in REFUSED
        ]
    problems = [f"{keys[f.frame]}: {f.problem}" for f in report.frames if f.problem]
    without = len(report.frames) - sum(f.depth_valid is not None for f in report.frames)
    pictures = {}
    if all(f.has_images for f in group.frames):
        for k, (item, row) in enumerate(zip(report.objects, labels, strict=True)):
            if row.verdict in REFUSED:
                data = picture_of(scene, item, judged.located.get(item.object))
                if data is not None:
                    file = safe_name(f"{name}_{keys[0]}_{row.object}") + ".jpg"
                    pictures[file] = data
                    labels[k] = msgspec.structs.replace(row, picture=file)
    return JudgedGroup(labels, found, problems, without, pictures)


def _audited(
    item: ObjectCheck, judged: Judged, name: str, frame: str, *, alone: bool
) -> AuditedLabel:
    scene, report = judged.scene, judged.report
    at = judged.located.get(item.object)
    sizes: dict[str, object] = {}
    if at is not None:
        view = _view(scene, item)
        across = np.linalg.svd(view[None])[2][1:]
        mm, deg = at.motion[SHIFT], at.motion[TURN]
        of_mm, of_deg = at.covariance[SHIFT, SHIFT], at.covariance[TURN, TURN]
        sizes = {
            "error_mm": size_of(mm, of_mm),
            "error_deg": size_of(deg, of_deg),
            "across_mm": size_of(across @ mm, across @ of_mm @ across.T),
            "along_mm": round(float(view @ mm), 2),
            "along_std_mm": round(float(np.sqrt(max(float(view @ of_mm @ view), 0.0))), 2),
            "weakest_mm": round(at.mm[1], 2),
            "weakest_deg": round(at.deg[1], 2),
        }
    overlap = item.entry("overlap_mm")
    grade, reason = item.verdict, reason_of(item, report)
    if at is None and not item.frames_seen:
        reason = "no image shows it"
    elif at is None and grade == "fits":
        # Distances in pixels that are small show no size of an error.
        grade, reason = "unknown", "its images do not determine its pose"
    if overlap is not None and overlap.value is not None:
        reason += f"; reaches {overlap.value:.1f} mm into {overlap.text}"
    return AuditedLabel(
        scene=name,
        frame=frame,
        object=plain(scene.names[item.object]),
        model=plain(item.model),
        material=item.material,
        frames=item.frames_seen,
        depth_mm=item.value("depth_mm"),
        edge_px=item.value("edge_px"),
        overlap_mm=None if overlap is None else overlap.value,
        overlap_with="" if overlap is None else overlap.text,
        verdict=grade,
        reason=reason,
        source="" if at is None else "one frame" if alone else "several frames",
        **sizes,  # type: ignore[arg-type]
    )


def size_of(vector: Array, covariance: Array) -> Size:
    """The length of a vector with its bounds within the 95 % region of the vector.

    Args:
        vector: (N,) of one to three numbers.
        covariance: (N, N) of it; directions without variance are known to be 0.
    """
    values, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    values = np.maximum(values, 0.0)
    known = values > 1e-9 * max(float(values.max()), 1e-12)
    chi2 = _CHI2[max(int(known.sum()), 1)]
    radii = np.sqrt(chi2 * values)
    along = axes.T @ vector
    length = float(np.linalg.norm(vector))
    inside = float(((along[known] / np.maximum(radii[known], 1e-12)) ** 2).sum()) <= 1
    around = along + _sphere(len(vector)) * radii
    reached = np.linalg.norm(around, axis=1)
    low = 0.0 if inside else float(reached.min())
    return Size(value=round(length, 2), low=round(low, 2), high=round(float(reached.max()), 2))


def _sphere(dimensions: int) -> Array:
    """Unit vectors (M, N), the same ones each time."""
    drawn = np.random.default_rng(0).normal(size=(_DIRECTIONS, dimensions))
    drawn = np.concatenate([drawn, np.eye(dimensions), -np.eye(dimensions)])
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def _view(scene: AuditScene, item: ObjectCheck) -> Array:
    """(3,) mean direction from the cameras to an object."""
    centre = object_centre(scene, item.object)
    seen = [f.frame for f in item.frames] or [f.id for f in scene.frames]
    rays = [centre - T.t for i in seen if (T := scene.T_world_cam(i)) is not None]
    middle = np.mean([r / max(float(np.linalg.norm(r)), 1e-9) for r in rays], axis=0)
    return np.asarray(middle / max(float(np.linalg.norm(middle)), 1e-9))


def _disagreements(
    report: CheckReport,
    scene: AuditScene,
    group: Group,
    name: str,
    keys: Mapping[int, str],
    options: CheckOptions,
) -> list[Disagreement]:
    found = [
        Disagreement(scene=name, frame=keys[f.frame], object="", what=f.fault)
        for f in report.frames
        if f.fault
    ]
    for item in report.objects:
        found += [
            Disagreement(
                scene=name,
                frame=keys[f.frame],
                object=plain(scene.names[item.object]),
                what=f.fault,
            )
            for f in item.frames
            if f.fault
        ]
        overlap = item.entry("overlap_mm")
        if overlap is not None and (overlap.value or 0) >= PlacementSettings.current().noted_mm:
            what = f"reaches {overlap.value:.1f} mm into {overlap.text}"
            frame = keys[0] if group.cameras == "none" else ""
            label = plain(scene.names[item.object])
            found.append(Disagreement(scene=name, frame=frame, object=label, what=what))
    by_index = {f.index: f.key.name for f in group.frames}
    for (index, thing), (mm, deg) in group.off.items():
        if mm > options.max_motion_mm or deg > options.max_motion_deg:
            what = f"{mm:.1f} mm and {deg:.1f} deg from its other frames: it is off, or was moved"
            found.append(
                Disagreement(scene=name, frame=by_index[index], object=plain(thing), what=what)
            )
    return found
