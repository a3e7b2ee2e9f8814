"""What a gate of the check is, and how the verdict of a label follows from its gates.

A gate measures one number of the scene (`SceneGate`) or of every object (`ObjectGate`), compares it
with a limit of `CheckOptions`, and says how to fix a failure. Its row in the report, its entry in
`check/report.json`, its warnings and its part of the verdicts come from this one object. The
verdict of an object is the worst verdict of its gates.

To add a gate, write it into the tuple `GATES` of its family (`poses`, `contour`, `depth`, `frames`,
`motion`, `texture`), and its limit as a field of `CheckOptions`. The command line, the report, the
table, the warnings and the verdicts then have it:

    ObjectGate(
        key="scatter",
        title="scatter of the depth residual, worst object",
        unit="mm",
        limit=lambda options: options.max_scatter_mm,
        measure=lambda item, measured: Reading(item.value("depth_mad_mm")),
        advice="inspect the depth panels",
    )

`measure` reads the values of the object, or `measured`; it returns None where nothing was measured.
A gate that lives outside of this package is added by `judge.register_gate`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.hypotheses import Weighed
from std_toolkit.checks.measure.frame_evidence import FrameEvidence
from std_toolkit.checks.result import (
    CheckGate,
    CheckWarning,
    FrameCheck,
    GateFinding,
    MaterialDepth,
    ObjectCheck,
    SceneSummary,
    Verdict,
)
from std_toolkit.errors import listed
from std_toolkit.options import CheckOptions
from std_toolkit.scene import CameraPoses

# Verdicts that fail a scene.
REFUSED: tuple[Verdict, ...] = ("doubtful", "wrong")


@dataclass(frozen=True)
class Moved:
    """An object that moved during the recording.

    Attributes:
        object, name: of the object.
        between: pairs of frame ids between which it moved: into and out of the frames in which
            the label does not fit.
        frames: ids of these frames.
        mm: displacement across the view.
        or_camera: whether the poses of the camera in these frames may be wrong instead.
    """

    object: int
    name: str
    between: tuple[tuple[int, int], ...]
    frames: tuple[int, ...]
    mm: float
    or_camera: bool


@dataclass(frozen=True, eq=False)
class Measured:
    """What the gates read.

    Attributes:
        summary, objects, frames, materials: tables of the report.
        options: limits.
        poses: the camera poses; None without any.
        evidence: frames that contradict the others.
        moved: objects that moved.
        unreadable: why the mesh of a labelled object cannot be read, by object id.
        weighed: verdict on the pose of an object by its id, where anything says where it is.
        up: (3,) normal of the plane on which objects stand, in the world.
    """

    summary: SceneSummary
    objects: Sequence[ObjectCheck]
    frames: Sequence[FrameCheck]
    options: CheckOptions
    materials: Sequence[MaterialDepth] = ()
    poses: CameraPoses | None = None
    evidence: FrameEvidence = field(default_factory=FrameEvidence)
    moved: Sequence[Moved] = ()
    unreadable: Mapping[int, str] = field(default_factory=dict)
    weighed: Mapping[int, Weighed] = field(default_factory=dict)
    up: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    @property
    def labelled(self) -> list[ObjectCheck]:
        """The objects with a label in the world."""
        return [o for o in self.objects if o.is_labelled]

    @property
    def has_contours(self) -> bool:
        """Whether the contour of any label was measured in any frame."""
        return any(f.edge_px is not None for o in self.objects for f in o.frames)


@dataclass(frozen=True)
class Reading:
    """A measured number in the unit of its gate.

    Attributes:
        value: as it counts; None where only the reason is known why there is none.
        deviation: its standard deviation; None if unknown.
        detail: where it comes from; for an object, what is said beside its name.
        advice: replaces that of the gate if not empty.
        excuse: why it counts less than what was measured, or "".
        verdict: on the object; None: by the limit of the gate.
    """

    value: float | None
    deviation: float | None = None
    detail: str = ""
    advice: str = ""
    excuse: str = ""
    verdict: Verdict | None = None


@dataclass(frozen=True, kw_only=True)
class Gate:
    """What all gates have.

    Attributes:
        key: stable name, such as "edges".
        title: what is measured, in words.
        limit: limit in the unit of the gate, a field of the options; None is 0.
        unit: "", "px", "mm", "deg" or "%".
        rule: "at least" or "at most" the limit.
        sigmas: deviations of the value by which it must exceed the limit to fail.
        advice: how to fix a failure.
        warn: warnings besides that of a failure.
        names: whether the detail begins with the names of what fails.
        after: key of the gate below which its row stands; "" for the order of the families.
        optional: whether the row is left out if nothing was measured.
        scope: "scene" if a failure fails the scene, "label" if it counts by the verdicts.
    """

    key: str
    title: str | Callable[[CheckOptions], str]
    limit: Callable[[CheckOptions], float] | None = None
    unit: str = ""
    rule: Literal["at least", "at most"] = "at most"
    sigmas: float = 0.0
    advice: str
    warn: Callable[[Measured], Iterable[CheckWarning]] | None = None
    names: bool = False
    after: str = ""
    optional: bool = False
    scope: Literal["scene", "label"] = "scene"

    def evaluate(self, measured: Measured) -> CheckGate:
        """The row of the report."""
        raise NotImplementedError

    def limit_of(self, options: CheckOptions) -> float:
        """The limit under these options."""
        return 0.0 if self.limit is None else self.limit(options)

    def meets(self, reading: Reading, options: CheckOptions) -> bool:
        """Whether a value is within the limit; a missing one is."""
        if reading.verdict is not None:
            return reading.verdict not in REFUSED
        if reading.value is None:
            return True
        limit = self.limit_of(options)
        # Compare the rounded value that is shown, so that "3.00 px, limit 3 px" never fails.
        value = round(reading.value, 3)
        if self.rule == "at least":
            return value >= limit - 1e-9
        return value <= limit + self.sigmas * (reading.deviation or 0.0) + 1e-9

    def finding(self, item: ObjectCheck, measured: Measured) -> GateFinding | None:
        """What the gate says of one object; None if that depends on the other gates."""
        del item, measured
        return None

    def warnings(self, measured: Measured) -> list[CheckWarning]:
        """The warnings besides that of a failure."""
        return [] if self.warn is None else list(self.warn(measured))

    def failure(self, row: CheckGate) -> CheckWarning:
        """The warning that a failed row of this gate gives."""
        named = self.names and row.detail
        return CheckWarning(
            severity="high",
            gate=self.key,
            about=row.detail.split(";")[0] if named else self.key,
            problem=f"{row.title}: {row.value:.4g} {row.unit}".rstrip()
            + f", must be {row.rule} {row.limit:g} {row.unit}".rstrip(),
            advice=row.advice,
        )

    def row(self, reading: Reading | None, options: CheckOptions, accepted: str = "") -> CheckGate:
        """The row of the report for a number; one that is accepted does not fail."""
        reading = reading or Reading(None)
        status: Literal["pass", "fail", "open"] = "open"
        detail = reading.detail
        if reading.value is not None:
            status = "pass" if self.meets(reading, options) else "fail"
        if accepted and status == "fail":
            status, detail = "pass", f"{detail}; {accepted}"
        return CheckGate(
            key=self.key,
            title=self.title if isinstance(self.title, str) else self.title(options),
            scope=self.scope,
            value=None if reading.value is None else round(reading.value, 3),
            deviation=reading.deviation,
            limit=round(self.limit_of(options), 4),
            rule=self.rule,
            unit=self.unit,
            status=status,
            detail=detail,
            advice=reading.advice or self.advice,
        )


@dataclass(frozen=True, kw_only=True)
class SceneGate(Gate):
    """A gate on one number of the scene.

    Attributes:
        measure: the number; None if it was not measured.
    """

    measure: Callable[[Measured], Reading | None]

    def evaluate(self, measured: Measured) -> CheckGate:
        return self.row(self.measure(measured), measured.options)


def accepts(verdict: Verdict, options: CheckOptions) -> str:
    """Why a label with this verdict does not fail the check, or ""."""
    if verdict == "unknown" and not options.strict:
        return "unknown; fails with --strict"
    if verdict == "doubtful" and options.allow_doubtful:
        return "allowed by --allow-doubtful"
    return ""


def no_exemption(item: ObjectCheck, measured: Measured) -> str:
    """The exemption of gates that all objects can fail."""
    del item, measured
    return ""


def unlabelled(item: ObjectCheck, measured: Measured) -> str:
    """Reason for the exemption of an object without a propagated label."""
    del measured
    return "" if item.is_labelled else "it has no label in the world"


def unseen(item: ObjectCheck, measured: Measured) -> str:
    """Reason for the exemption of an object that no frame shows well enough."""
    no_label = unlabelled(item, measured)
    return no_label or ("" if item.frames_seen else "no frame shows enough of it")


Readings = Sequence[tuple[ObjectCheck, Reading]]


def object_names(found: Readings, measured: Measured) -> str:
    """The names of the first objects."""
    del measured
    return listed([item.name for item, _ in found])


def all_names(found: Readings, measured: Measured) -> str:
    """The names of all objects."""
    del measured
    return listed([item.name for item, _ in found], len(found))


@dataclass(frozen=True, kw_only=True)
class ObjectGate(Gate):
    """A gate on a number of every object; that of the scene is the worst of them.

    Attributes:
        measure: the number of an object; None if it was not measured.
        counts: whether the number of the scene is how many objects are beyond the limit.
        exempt: why an object cannot fail the gate, or ""; beyond the limit it is "unknown".
        verdict: that of an object beyond the limit.
        unmeasured: verdict of an object without a number; None: it depends on the other gates.
        warn_from: value in the unit of the gate from which an object within the limit gets a
            warning; None: `warn` says it.
        detail: of the row, from the objects that fail, or from the worst one.
    """

    measure: Callable[[ObjectCheck, Measured], Reading | None]
    counts: bool = False
    exempt: Callable[[ObjectCheck, Measured], str] = unseen
    verdict: Verdict = "wrong"
    unmeasured: Verdict | None = None
    warn_from: float | None = None
    detail: Callable[[Readings, Measured], str] = object_names
    names: bool = True
    scope: Literal["scene", "label"] = "label"

    def evaluate(self, measured: Measured) -> CheckGate:
        options = measured.options
        known = [
            (item, reading)
            for item in measured.objects
            if (reading := self.measure(item, measured)) is not None and reading.value is not None
        ]
        counted = [(i, r) for i, r in known if not self.exempt(i, measured)]
        reading = Reading(None)
        if self.counts and known:
            found = [(i, r) for i, r in counted if not self.meets(r, options)]
            advice = "; ".join(r.advice for _, r in found if r.advice)
            reading = Reading(len(found), None, self.detail(found, measured), advice)
        elif counted and not self.counts:
            sign = -1 if self.rule == "at least" else 1
            item, worst = max(
                counted,
                key=lambda pair: (not self.meets(pair[1], options), sign * (pair[1].value or 0.0)),
            )
            detail = self.detail([(item, worst)], measured)
            reading = replace(worst, detail=detail)
        verdict = reading.verdict or self.verdict
        accepted = "" if self.scope == "scene" else accepts(verdict, options)
        return self.row(reading, options, accepted)

    def finding(self, item: ObjectCheck, measured: Measured) -> GateFinding | None:
        reading = self.measure(item, measured)
        if reading is None or reading.value is None:
            if self.unmeasured is None:
                return None
            return GateFinding(gate=self.key, verdict=self.unmeasured)
        exempt = self.exempt(item, measured)
        beyond: Verdict = "unknown" if exempt else self.verdict
        return GateFinding(
            gate=self.key,
            value=round(reading.value, 3),
            verdict=reading.verdict
            or ("fits" if self.meets(reading, measured.options) else beyond),
            exempt=exempt or reading.excuse,
            detail=reading.detail,
        )

    def warnings(self, measured: Measured) -> list[CheckWarning]:
        found = []
        for item in measured.objects if self.warn_from is not None else ():
            row = self.finding(item, measured)
            if row is None or row.value is None or row.verdict != "fits":
                continue
            if not row.exempt and self.is_noted(row.value):
                title = self.row(None, measured.options).title
                found.append(
                    CheckWarning(
                        severity="medium",
                        about=item.name,
                        problem=f"{title}: {row.value:.4g} {self.unit}".rstrip(),
                        advice=self.advice,
                    )
                )
        return [*found, *super().warnings(measured)]

    def is_noted(self, value: float | None) -> bool:
        """Whether a value is one from which the gate warns."""
        if value is None or self.warn_from is None:
            return False
        return value <= self.warn_from if self.rule == "at least" else value >= self.warn_from
