"""What follows from gates and verdicts: whether the check passes, and the line that says why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from std_toolkit.checks.gates.gate import accepts
from std_toolkit.checks.result import CheckGate, ObjectCheck
from std_toolkit.errors import listed
from std_toolkit.options import CheckOptions
from std_toolkit.scene.judgement import GRADES, Grade

# From the worst verdict on, without the best.
_BAD = GRADES[:0:-1]


@dataclass(frozen=True)
class Outcome:
    """Result of a check.

    A scene fails by a gate of its own (camera poses, scale, depth, files), and by a label that is
    wrong, doubtful (unless `allow_doubtful`) or, if `strict`, unknown.

    Attributes:
        failed_gates: keys of the gates of the scene that failed.
        failed_labels: names of the objects that fail the scene, by verdict.
        others: names of further objects that do not fit, by verdict.
        labelled: number of objects with a label in the world.
    """

    failed_gates: tuple[str, ...]
    failed_labels: dict[Grade, list[str]]
    others: dict[Grade, list[str]]
    labelled: int

    @staticmethod
    def of(
        rows: Sequence[CheckGate], objects: Sequence[ObjectCheck], options: CheckOptions
    ) -> Outcome:
        """The result of gates and verdicts."""
        failed: dict[Grade, list[str]] = {}
        others: dict[Grade, list[str]] = {}
        for grade in _BAD:
            names = [o.name for o in objects if o.verdict == grade]
            if names:
                (others if accepts(grade, options) else failed)[grade] = names
        return Outcome(
            tuple(r.key for r in rows if r.scope == "scene" and r.status == "fail"),
            failed,
            others,
            sum(o.is_labelled for o in objects),
        )

    @property
    def passed(self) -> bool:
        """Whether the exit status is 0."""
        return not (self.failed_gates or self.failed_labels)

    def line(self) -> str:
        """One line, such as "FAIL: gate camera; wrong: mug_1, box_2"."""
        if not self.passed:
            count = len(self.failed_gates)
            parts = [f"gate{'s' if count > 1 else ''} {', '.join(self.failed_gates)}"]
            return f"FAIL: {'; '.join(parts[: bool(count)] + _words(self.failed_labels))}"
        if not self.labelled:
            return "PASS: camera poses usable; there are no labels to check"
        if self.others:
            return f"PASS: no label is known to be wrong; {'; '.join(_words(self.others))}"
        return "PASS: labels usable"


def _words(names: dict[Grade, list[str]]) -> list[str]:
    return [f"{grade}: {listed(found)}" for grade, found in names.items()]
