"""The judgement of each label, from the report of the check, and its way into labels.json."""

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.measure.textures import TextureFinding
from std_toolkit.checks.result import CheckReport, GateFinding, ObjectCheck, Value
from std_toolkit.checks.shapes import size_sentence
from std_toolkit.io.documents import utc_text
from std_toolkit.options import CheckOptions
from std_toolkit.scene.judgement import Evidence, Judgement, Source
from std_toolkit.scene.label_verdicts import judgement_inputs, judgement_limits
from std_toolkit.scene.model import Label, Labels, pose_from_list
from std_toolkit.scene.scene import Scene

# What a failure of a gate says of its cause.
_CAUSES = {
    "moved": "moved",
    "texture": "turn",
    "size": "size",
    **dict.fromkeys(("motion", "rotation", "shift", "edges", "depth"), "label"),
}


def store_judgements(scene: Scene, report: CheckReport, options: CheckOptions) -> None:
    """Write the judgements of a report into labels.json, if they are new.

    The report belongs to the labels of the scene and to the options, and the caller holds the lock
    of the scene.
    """
    limits = judgement_limits(options.label_limits())
    inputs = judgement_inputs(scene, limits)
    rows = {item.object: item for item in report.objects}
    now = utc_text()
    labels = []
    for label in scene.labels.labels:
        item = rows.get(label.object)
        judgement: Judgement | msgspec.UnsetType = msgspec.UNSET
        if item is not None and label.T_world_obj is not None:
            judgement = judgement_of(item, report, label, inputs[label.object], limits, now)
        labels.append(msgspec.structs.replace(label, judgement=_kept(label, judgement)))
    if labels != scene.labels.labels:
        scene.save_labels(Labels(labels=labels))


def judgement_of(
    item: ObjectCheck,
    report: CheckReport,
    label: Label,
    inputs: str,
    limits: Mapping[str, float],
    time: str,
    texture: TextureFinding | None = None,
) -> Judgement:
    """The judgement of one label.

    Args:
        item: its row in the report.
        report: the report.
        label: its label, with a pose in the world.
        inputs: digest of what was measured; see `judgement_inputs`.
        limits: see `judgement_limits`.
        time: when it was measured, UTC, ISO 8601.
        texture: what its texture says, for the pose of a turn that fits better.
    """
    assert label.T_world_obj is not None
    pose = item.entry("pose_mm")
    covariance = _covariance(pose)
    probability = item.value("within")
    grade, reason = item.verdict, reason_of(item, report)
    if probability is None and grade in ("fits", "doubtful"):
        grade, reason = (
            "unknown",
            "too few frames determine its pose"
            + (f"; {reason}" if item.verdict == "doubtful" else ""),
        )
    failed = [f.gate for f in item.gates if f.verdict not in ("fits", "unknown")]
    return Judgement(
        grade=grade,
        probability=probability,
        cause=next((_CAUSES[key] for key in failed if key in _CAUSES), item.text("pose_mm")),
        reason=reason,
        T_obj=label.T_world_obj,
        T_rival=_rival(label.T_world_obj, texture),
        deviation_mm=_weakest(covariance, slice(0, 3)),
        deviation_deg=_weakest(covariance, slice(3, 6)),
        inputs=inputs,
        limits=dict(limits),
        time=time,
        evidence=_evidence(item),
    )


def reason_of(item: ObjectCheck, report: CheckReport) -> str:
    """The verdict of an object in one sentence: the findings that gave it."""
    size = size_sentence(item)
    if item.verdict == "fits":
        fits = item.text("within") or "the images agree with the label"
        return f"{fits}; {size}" if size else fits
    parts: list[str] = []
    unmeasured: list[str] = []
    for finding in item.gates:
        if finding.verdict != item.verdict:
            continue
        if finding.detail and (finding.verdict == "unknown" or finding.gate in _IN_WORDS):
            parts.append(finding.detail)
        elif finding.gate in ("motion", "rotation", "seen") and item.text("within"):
            parts = [item.text("within"), *[p for p in parts if p != item.text("within")]]
        else:
            said, known = _gate_in_words(finding, report)
            if not (finding.gate == "size" and size):
                # A value within its limit is no reason to know nothing.
                is_reason = known and finding.verdict != "unknown"
                (parts if is_reason else unmeasured).append(said)
    parts += [size] if size else []
    return "; ".join(parts or unmeasured) or "nothing was measured"


# What these gates find is a sentence, and their value a count.
_IN_WORDS = ("texture", "seen", "overlap")
# What the others say of a single object, where their title speaks of all.
_OF_ONE = {
    "moved": "it moved during the recording",
    "symmetry": "its mesh has not the symmetry that is declared",
    "meshes": "its mesh cannot be read",
}


def _gate_in_words(finding: GateFinding, report: CheckReport) -> tuple[str, bool]:
    """What a gate says of an object, and whether it was measured."""
    row = report.gate(finding.gate)
    title = _OF_ONE.get(finding.gate) or row.title.split(", worst ")[0]
    unit = f" {row.unit}" if row.unit else ""
    if finding.value is None:
        return f"not measured: {title}", False
    if not row.limit:
        return title, True
    return f"{title}: {finding.value:.4g}{unit}, must be {row.rule} {row.limit:g}{unit}", True


def _rival(T_world_obj: list[float], texture: TextureFinding | None) -> list[float] | None:
    found = None if texture is None else texture.comparison
    if found is None or found.turn is None:
        return None
    if found.verdict != "turned" and not (found.verdict == "undecided" and found.rival_leads):
        return None
    return (pose_from_list(T_world_obj) @ found.turn).flat()


def _kept(label: Label, judgement: Judgement | msgspec.UnsetType) -> Judgement | msgspec.UnsetType:
    """The judgement of the label if it says the same, with its time."""
    before = label.judgement
    if isinstance(before, msgspec.UnsetType) or isinstance(judgement, msgspec.UnsetType):
        return judgement
    same = msgspec.structs.replace(judgement, time=before.time) == before
    return before if same else judgement


def _covariance(motion: Value | None) -> NDArray[np.float64] | None:
    if motion is None or motion.motion is None or motion.covariance is None:
        return None
    return np.reshape(np.asarray(motion.covariance, dtype=np.float64), (6, 6))


def _weakest(covariance: NDArray[np.float64] | None, part: slice) -> float | None:
    """Standard deviation along the weakest direction of translation or rotation."""
    if covariance is None:
        return None
    largest = float(np.linalg.eigvalsh(covariance[part, part])[-1])
    return round(float(np.sqrt(max(largest, 0.0))), 3)


def _evidence(item: ObjectCheck) -> list[Evidence]:
    found = []
    sources: dict[str, tuple[Source, str]] = {
        "motion_mm": ("contour", item.text("support")),
        "texture_mm": ("texture", ""),
        "surface_mm": ("depth", _residual(item)),
        "standing_mm": ("support", item.text("standing_mm")),
    }
    for key, (source, text) in sources.items():
        motion = item.entry(key)
        if motion is not None and motion.motion is not None:
            found.append(
                Evidence(
                    source=source,
                    motion_mm=motion.motion[:3],
                    turn_deg=motion.motion[3:],
                    covariance=motion.covariance,
                    frames=motion.frames,
                    text=text,
                )
            )
    texture, turn = item.entry("texture"), item.text("texture_rival")
    if texture is not None:
        text = f"{texture.text}: {turn}" if turn else texture.text
        found.append(Evidence(source="texture", frames=texture.frames, text=text))
    depth = item.entry("depth_mm")
    if depth is not None and depth.value is not None and item.entry("surface_mm") is None:
        found.append(Evidence(source="depth", frames=depth.frames, text=_residual(item)))
    return found


def _residual(item: ObjectCheck) -> str:
    depth = item.value("depth_mm")
    return "" if depth is None else f"the label is {depth:+.1f} mm behind the measured surface"
