"""The judge: the report of the check from the measurements of the frames, without pictures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks import result
from std_toolkit.checks.gates import contour, depth, frames, motion, placement, poses, texture
from std_toolkit.checks.gates.gate import Gate, Measured
from std_toolkit.checks.gates.hypotheses import weigh
from std_toolkit.checks.gates.outcome import Outcome
from std_toolkit.checks.measure import aggregate, contours, residuals, textures
from std_toolkit.checks.measure.alignments import with_alignments
from std_toolkit.checks.measure.displaced_starts import with_displaced_starts
from std_toolkit.checks.measure.frame_evidence import frame_evidence
from std_toolkit.checks.measure.object_motion import with_motions
from std_toolkit.checks.measure.placements import with_placements
from std_toolkit.checks.measure.sensor_depth import common_depth_shift
from std_toolkit.checks.measure.standing import standing_of, with_standing
from std_toolkit.errors import ToolkitError
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene
from std_toolkit.scene.judgement import GRADES
from std_toolkit.scene.model import ScaleEstimate
from std_toolkit.settings import changed

_FAMILIES = (
    *poses.GATES,
    *contour.GATES,
    *depth.GATES,
    *frames.GATES,
    *motion.GATES,
    *texture.GATES,
    *placement.GATES,
)
_added: list[Gate] = []
_SEVERITY: dict[result.Severity, int] = {"high": 0, "medium": 1, "low": 2}


def all_gates() -> tuple[Gate, ...]:
    """The gates of all families and the registered ones, in the order of the report."""
    return _ordered((*_FAMILIES, *_added))


def _ordered(gates: Iterable[Gate]) -> tuple[Gate, ...]:
    """The gates in the order of the report.

    Raises:
        ToolkitError: two gates have one key.
    """
    found: list[Gate] = []
    for gate in gates:
        keys = [g.key for g in found]
        if gate.key in keys:
            raise ToolkitError("two gates have this key", field="key", value=gate.key)
        found.append(gate)
    for gate in [g for g in found if g.after]:
        found.remove(gate)
        above = [k for k, g in enumerate(found) if g.key == gate.after]
        found.insert(above[0] + 1 if above else len(found), gate)
    return tuple(found)


def register_gate(gate: Gate) -> None:
    """Add a gate from outside of this package, for the running process.

    Raises:
        ToolkitError: a gate has this key.
    """
    _ordered((*all_gates(), gate))
    _added.append(gate)


def judge_scene(
    scene: Scene,
    observed: list[residuals.FrameObservation],
    problems: dict[int, str],
    options: CheckOptions,
    *,
    up: NDArray[np.float64],
    compared: Mapping[int, textures.TextureFinding] | None = None,
    sizes: ScaleEstimate | None = None,
    aligned: Mapping[int, result.Value] | None = None,
    only: Collection[int] | None = None,
) -> result.CheckReport:
    """Aggregate the measurements and evaluate the gates; writes nothing.

    Args:
        scene: the scene that was measured.
        observed: the measured frames.
        problems: error line by frame id, of frames that could not be measured.
        options: limits.
        up: (3,) unit vector that points up in the world.
        compared: comparisons of the textures, by object id; see `textures.compare_textures`.
        sizes: scale from the sizes of the objects; see `object_sizes.measure_sizes`.
        aligned: where a lone frame puts the objects, by object id; see `measure_alignments`.
        only: ids of the objects to judge; the motions of the others are not solved, so that their
            rows say nothing of their poses.
    """
    bias = aggregate.common_depth_bias(scene, observed)
    objects = aggregate.check_objects(scene, observed, up=up, depth_bias=bias)
    rows = aggregate.check_frames(scene, observed, problems)
    materials = aggregate.check_materials(scene, observed)
    objects = with_alignments(textures.with_textures(objects, compared or {}), aligned)
    planes = standing_of(scene, objects, up)
    judged = [o for o in objects if only is None or o.object in only]
    moved = with_motions(scene, judged, observed, options, up=planes.up)
    registered = [scene.frame(f.frame) for f in observed if scene.T_world_cam(f.frame) is not None]
    moved = with_displaced_starts(scene, moved, registered, options, up=planes.up)
    solved = {o.object: o for o in moved}
    objects = [solved.get(o.object, o) for o in objects]
    objects = with_placements(scene, objects)
    objects = with_standing(scene, objects, planes)
    summary = _summary(scene, objects, rows, observed, bias)
    summary = msgspec.structs.replace(summary, sizes=sizes)
    report = judge_rows(
        Measured(
            summary=summary,
            objects=objects,
            frames=rows,
            options=options,
            materials=materials,
            poses=scene.poses,
            unreadable=_unreadable_meshes(scene),
            evidence=frame_evidence(scene, observed, options),
            up=planes.up,
        )
    )
    return msgspec.structs.replace(
        report, scene=scene.info.name, missing=_missing(scene, summary, observed)
    )


def judge_rows(measured: Measured) -> result.CheckReport:
    """The report from the tables of the objects and frames: faults, gates, verdicts, warnings.

    Args:
        measured: what was measured, without the faults of frames.
    """
    weighed = {
        o.object: pose
        for o in measured.objects
        if o.is_labelled and (pose := weigh(o, measured.options)) is not None
    }
    faults = frames.find_frame_faults(
        measured.objects, measured.frames, measured.options, measured.evidence, up=measured.up
    )
    measured = replace(
        measured,
        objects=faults.objects,
        frames=faults.frames,
        moved=faults.moved,
        weighed=weighed,
    )
    gates = all_gates()
    objects = [_with_verdict(_with_pose(o, measured), gates, measured) for o in measured.objects]
    found = [(gate, gate.evaluate(measured)) for gate in gates]
    rows = [row for gate, row in found if row.value is not None or not gate.optional]
    outcome = Outcome.of(rows, objects, measured.options)
    return result.CheckReport(
        scene="",
        passed=outcome.passed,
        verdict=outcome.line(),
        summary=measured.summary,
        gates=rows,
        warnings=_find_warnings(gates, rows, measured),
        missing=[],
        objects=objects,
        frames=list(measured.frames),
        materials=list(measured.materials),
        limits={k: float(v) for k, v in asdict(measured.options).items()} | changed(),
    )


def _with_pose(item: result.ObjectCheck, measured: Measured) -> result.ObjectCheck:
    """The object with where all evidence puts it."""
    found = measured.weighed.get(item.object)
    if found is None:
        return item
    mm, deg = found.located.mm, found.located.deg
    return item.with_values(
        [
            result.Value(
                key="within",
                value=round(found.probability, 4),
                source="judge",
                text=found.reason,
            ),
            result.Value(
                key="pose_mm",
                value=round(mm[0], 2),
                std=round(mm[1], 2),
                unit="mm",
                source="judge",
                text=found.cause,
                motion=[round(float(x), 3) for x in found.located.motion],
                covariance=[float(f"{x:.6g}") for x in found.located.covariance.ravel()],
            ),
            result.Value(
                key="pose_deg",
                value=round(deg[0], 2),
                std=round(deg[1], 2),
                unit="deg",
                source="judge",
            ),
        ]
    )


def _with_verdict(
    item: result.ObjectCheck, gates: Sequence[Gate], measured: Measured
) -> result.ObjectCheck:
    """The object with the worst verdict of its gates; "unknown" without any."""
    found = [f for gate in gates if (f := gate.finding(item, measured)) is not None]
    verdict = max((f.verdict for f in found), key=GRADES.index, default="unknown")
    return msgspec.structs.replace(item, gates=found, verdict=verdict)


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
    shifts = aggregate.depth_shifts(observed)
    shift = common_depth_shift(shifts)
    return result.SceneSummary(
        frames=len(rows),
        registered=len(registered),
        looked_at=len(observed),
        reprojection_px=aggregate.rounded(float(np.mean(errors))) if errors else None,
        objects=len(objects),
        labelled=sum(o.is_labelled for o in objects),
        depth_frames=sum(f.depth is not None for f in scene.frames),
        truth_frames=current,
        truth_source="rendered maps" if current else "labels cast here" if cast else "none",
        depth_shift_px=[round(shift.x_px, 2), round(shift.y_px, 2)] if shift else None,
        depth_shift_std_px=aggregate.rounded(shift.std_px) if shift else None,
        depth_shifts=len(shifts),
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


def _unreadable_meshes(scene: Scene) -> dict[int, str]:
    return {
        o.id: problem
        for o in scene.objects.objects
        if scene.T_world_obj(o.id) is not None
        and (problem := contours.mesh_problem(scene, o.model))
    }


def _find_warnings(
    gates: Sequence[Gate], rows: Sequence[result.CheckGate], measured: Measured
) -> list[result.CheckWarning]:
    """All warnings, the most severe first, those on objects before those on the scene.

    Failed gates precede all others.

    Args:
        gates: the gates.
        rows: their rows in the report.
        measured: what they read.
    """
    by_key = {g.key: g for g in gates}
    failed = [by_key[row.key].failure(row) for row in rows if row.status == "fail"]
    names = {item.name for item in measured.objects}
    rest = [w for gate in gates for w in gate.warnings(measured)]
    return failed + sorted(rest, key=lambda w: (_SEVERITY[w.severity], w.about not in names))
