"""Warnings of the report, ranked by severity, each with advice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from std_toolkit.checks.gates.gate import Gate, Measured
from std_toolkit.checks.measure.coverage import NARROW_DEG
from std_toolkit.checks.result import CheckGate, CheckWarning, ObjectCheck, Severity

_ORDER: dict[Severity, int] = {"high": 0, "medium": 1, "low": 2}
_LOW_VISIBILITY = 0.5
_LARGE_STEP_DEG = 30.0


def find_warnings(
    gates: Sequence[Gate], rows: Sequence[CheckGate], measured: Measured
) -> list[CheckWarning]:
    """All warnings, the most severe first; failed gates precede all others.

    Args:
        gates: the gates.
        rows: their rows in the report.
        measured: what they read.
    """
    by_key = {g.key: g for g in gates}
    failed = [by_key[row.key].failure(row) for row in rows if row.status == "fail"]
    rest = [w for item in measured.labelled for w in _views(item)]
    rest += [w for gate in gates for w in gate.warnings(measured)]
    return failed + sorted(rest, key=lambda w: _ORDER[w.severity])


def _views(item: ObjectCheck) -> Iterable[CheckWarning]:
    """What the views of an object lack."""

    def warning(severity: Severity, problem: str, advice: str) -> CheckWarning:
        return CheckWarning(severity=severity, about=item.name, problem=problem, advice=advice)

    if item.frames_seen == 0:
        yield warning("high", "is not visible in any measured frame", "check its label and mesh")
        return
    parallax, step = item.value("parallax_deg"), item.value("largest_step_deg") or 0
    visible = item.value("visible_fraction")
    if parallax is not None and parallax < NARROW_DEG:
        yield warning(
            "medium",
            f"was seen over only {parallax:.0f} degrees: its depth is weakly determined",
            "record a wider sweep around it",
        )
    if step > _LARGE_STEP_DEG:
        yield warning(
            "low",
            f"its views have a gap of {step:.0f} degrees",
            "record the missing directions if you need them",
        )
    if visible is not None and visible < _LOW_VISIBILITY:
        yield warning(
            "low",
            f"is half occluded in most frames (visible {100 * visible:.0f} %)",
            "rearrange the objects if it must be visible in this scene",
        )
