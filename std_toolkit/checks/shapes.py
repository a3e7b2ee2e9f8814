"""Objects that differ from their meshes: where, by how much, and which faults that hides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.gate import REFUSED
from std_toolkit.checks.gates.hypotheses import weigh
from std_toolkit.checks.gates.motion import size_error
from std_toolkit.checks.measure.contours import mesh_problem
from std_toolkit.checks.measure.object_motion import ConfirmationSettings
from std_toolkit.checks.measure.shape_map import ShapeMap, map_shape
from std_toolkit.checks.result import CheckReport, CheckWarning, ObjectCheck, Value
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Frame, Scene

# Faults that are tried, in mm and degrees, and the halvings of that range: 0.25 mm.
_LARGEST, _HALVINGS = 64.0, 8


@dataclass(frozen=True, eq=False)
class ShapeFinding:
    """What is known of an object that differs from its mesh.

    Attributes:
        map: where and by how much; None if too little of its contour is seen.
        size, size_std: relative size minus 1, if significant, and its standard deviation.
        fault_mm, fault_deg: smallest translation and rotation of its label that the judge would
            still refuse; None if it would refuse none, or if nothing says where the object is.
    """

    map: ShapeMap | None
    size: float = 0.0
    size_std: float = 0.0
    fault_mm: float | None = None
    fault_deg: float | None = None


def find_shapes(
    scene: Scene, report: CheckReport, frames: Sequence[Frame], options: CheckOptions
) -> dict[int, ShapeFinding]:
    """Measure the objects that the judge says have another shape or size than their meshes.

    Args:
        scene: the scene that was judged.
        report: what the judge said.
        frames: registered frames whose images can be read.
        options: limits.

    Returns:
        Findings by object id.
    """
    found = {}
    for item in report.objects:
        size = significant_size(item)
        if not item.is_labelled or not (size or item.text("pose_mm") == "shape"):
            continue
        if mesh_problem(scene, item.model) is not None:
            continue
        pose = item.entry("pose_mm")
        motion = np.zeros(6) if pose is None else np.asarray(pose.motion)
        fault_mm, fault_deg = smallest_faults(item, options)
        found[item.object] = ShapeFinding(
            map_shape(scene, item.object, motion, frames, options),
            size,
            item.std("size_error") or 0.0,
            fault_mm,
            fault_deg,
        )
    return found


def significant_size(item: ObjectCheck) -> float:
    """Relative size of the object minus 1, if it differs noticeably from its mesh; otherwise 0."""
    size = size_error(item)
    return size if abs(size) >= ConfirmationSettings.current().noted_size else 0.0


def size_sentence(item: ObjectCheck) -> str:
    """The size of the object, such as "it is 2.0 % (± 0.4) larger than its mesh"; "" if equal."""
    size = significant_size(item)
    if not size:
        return ""
    word = "larger" if size > 0 else "smaller"
    percent, std = 100 * abs(size), 100 * (item.std("size_error") or 0)
    return f"it is {percent:.1f} % (± {std:.1f}) {word} than its mesh"


def smallest_faults(item: ObjectCheck, options: CheckOptions) -> tuple[float | None, float | None]:
    """Smallest translation (mm) and rotation (deg) of a label that the judge would refuse.

    The evidence on the object stays as it is, and its label moves along the direction in which
    the evidence is weakest. None where nothing up to 64 mm or degrees is refused.
    """
    pose = item.entry("pose_mm")
    if pose is None or pose.covariance is None:
        return None, None
    covariance = np.reshape(pose.covariance, (6, 6))
    found: list[float | None] = []
    for part in (slice(3), slice(3, 6)):
        block = covariance[part, part]
        values, axes = np.linalg.eigh((block + block.T) / 2)
        direction = np.zeros(6)
        direction[part] = axes[:, -1]
        found.append(_smallest(item, direction, options) if values[-1] > 0 else None)
    return found[0], found[1]


def _smallest(item: ObjectCheck, direction: Array, options: CheckOptions) -> float | None:
    low, high = 0.0, _LARGEST
    if not _is_refused(item, high * direction, options):
        return None
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if _is_refused(item, middle * direction, options):
            high = middle
        else:
            low = middle
    return high


def _is_refused(item: ObjectCheck, fault: Array, options: CheckOptions) -> bool:
    """Whether a label that is off by a motion, in both directions, would be refused."""
    for sign in (1, -1):
        moved = [_off(value, sign * fault) for value in item.values]
        weighed = weigh(msgspec.structs.replace(item, values=moved), options)
        if weighed is None or weighed.verdict not in REFUSED:
            return False
    return True


def _off(value: Value, fault: Array) -> Value:
    # Every source that says where the object is, with its covariance.
    if value.motion is None or value.covariance is None or value.source == "judge":
        return value
    motion = np.asarray(value.motion) + fault
    return msgspec.structs.replace(
        value, value=float(np.linalg.norm(motion[:3])), motion=motion.tolist()
    )


def with_shapes(report: CheckReport, found: Mapping[int, ShapeFinding]) -> CheckReport:
    """The report with the values of these objects, and a warning on each."""
    objects, warnings = [], []
    for item in report.objects:
        finding = found.get(item.object)
        if finding is None:
            objects.append(item)
            continue
        objects.append(item.with_values(_values(finding)))
        warnings.append(_warning(item, finding))
    first = sum(w.severity == "high" or bool(w.gate) for w in report.warnings)
    merged = [*report.warnings[:first], *warnings, *report.warnings[first:]]
    return msgspec.structs.replace(report, objects=objects, warnings=merged)


def _values(found: ShapeFinding) -> list[Value]:
    values = []
    if found.map is not None:
        values.append(
            Value(
                key="shape_mm",
                value=round(found.map.largest_mm, 2),
                unit="mm",
                source="contour",
                frames=found.map.frames,
                text=found.map.where,
            )
        )
    mm, deg = found.fault_mm, found.fault_deg
    if mm is not None:
        values.append(Value(key="smallest_fault_mm", value=round(mm, 2), unit="mm", source="judge"))
    if deg is not None:
        values.append(
            Value(key="smallest_fault_deg", value=round(deg, 2), unit="deg", source="judge")
        )
    return values


def _warning(item: ObjectCheck, found: ShapeFinding) -> CheckWarning:
    said = [_differences(item, found)]
    if found.fault_mm is not None and found.fault_deg is not None:
        said.append(
            f"a label less than {found.fault_mm:.1f} mm or {found.fault_deg:.1f} deg off would not "
            "be told"
        )
    advice = "scan this object (`std-scan`)"
    if found.size:
        advice = f"scale its mesh by {1 + found.size:.3f} if its scale is wrong, or {advice}"
    return CheckWarning(
        severity="medium",
        about=item.name,
        problem="; ".join(said),
        advice=advice,
    )


def _differences(item: ObjectCheck, found: ShapeFinding) -> str:
    """Size and shape in one sentence."""
    size = size_sentence(item)
    if found.map is None:
        return size or "it has another shape than its mesh"
    if size and (found.size > 0) == (found.map.largest_mm > 0):
        return f"{size}, by up to {abs(found.map.largest_mm):.1f} mm {found.map.where}"
    return f"{size}; {found.map.sentence()}" if size else found.map.sentence()
