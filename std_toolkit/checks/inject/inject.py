"""Smallest faults that the gates of the check catch in a scene (`std-curate check --inject`).

Each kind of fault has a ladder of sizes. The smallest size that the gates catch is found by
bisection on the ladder, for all objects and kinds at once, so that every round is one job. A frame
is measured again only where the fault changes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.detectability import Detectability, FaultRow, FaultTrial
from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.inject.faults import (
    KINDS,
    Fault,
    FaultKind,
    FaultyScene,
    apply_fault,
    has_no_effect,
)
from std_toolkit.checks.measure.contours import LabelCaster, object_centre
from std_toolkit.checks.measure.coverage import spread
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame, open_for_work
from std_toolkit.checks.result import CheckGate, CheckReport
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene

# Starting worker processes takes longer than measuring this many frames.
_SERIAL_BELOW = 12


@dataclass(frozen=True)
class FaultItem:
    """A job item: one frame measured with a fault."""

    fault: Fault
    frame: int


@dataclass(frozen=True)
class _Outcome:
    """The gates with one fault in one direction."""

    caught_by: tuple[str, ...]
    gates: dict[str, CheckGate]


@dataclass
class _Search:
    """Bisection of one kind of fault on its ladder.

    Attributes:
        fault: the fault with size 0.
        frames: ids of the frames that it changes.
        low, high: indices of the largest size known as missed and the smallest known as caught.
        outcomes: by size.
    """

    kind: FaultKind
    fault: Fault
    name: str
    frames: list[int]
    note: str = ""
    low: int = -1
    high: int = 0
    outcomes: dict[float, list[_Outcome]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.high = len(self.kind.sizes)

    @property
    def is_done(self) -> bool:
        return bool(self.note) or self.high - self.low <= 1

    @property
    def middle(self) -> int:
        return (self.low + self.high) // 2

    def next_faults(self) -> list[Fault]:
        size = self.kind.sizes[self.middle]
        return [replace(self.fault, size=sign * size) for sign in self.kind.signs]

    def record(self, outcomes: list[_Outcome]) -> None:
        self.outcomes[self.kind.sizes[self.middle]] = outcomes
        if all(o.caught_by for o in outcomes):
            self.high = self.middle
        else:
            self.low = self.middle


def inject_faults(
    scene: Scene,
    observed: Sequence[FrameObservation],
    fingerprint: str,
    options: CheckOptions,
    jobs: JobOptions | None,
    *,
    up: NDArray[np.float64],
    kinds: Sequence[FaultKind] = KINDS,
) -> Detectability:
    """Put faults of growing size into the scene in memory and evaluate the gates.

    A fault is caught if a gate fails that passes without it, or if the verdict of its object
    turns bad. Faults with two directions must be caught in both.

    Args:
        scene: an open scene; none of its files changes.
        observed: the frames measured without a fault, of which `inject_frames` are used.
        fingerprint: digest of the documents, see `open_for_work`.
        options: limits of the gates, number of objects and of frames.
        jobs: where the frames are measured.
        up: (3,) unit vector that points up in the world.
        kinds: faults to inject.

    Raises:
        ToolkitError: a file of a frame is missing or damaged.
    """
    base = spread(observed, options.inject_frames)
    plain = judge_scene(scene, base, {}, options, up=up)
    labelled = [o for o in scene.objects.objects if any(o.id in f.objects for f in base)]
    chosen = spread(labelled, options.inject_objects)
    camera_frame = _camera_frame(base)
    searches = [
        *_object_searches(scene, base, [o.id for o in chosen], kinds, up),
        *_scene_searches(base, camera_frame, kinds),
    ]
    measure = partial(observe_with_fault, root=scene.root, fingerprint=fingerprint, options=options)
    pending = [s for s in searches if not s.is_done]
    turn = 0
    while pending:
        turn += 1
        items = [FaultItem(f, i) for s in pending for f in s.next_faults() for i in s.frames]
        job = run_jobs(
            measure,
            items,
            name=f"inject {turn}",
            key=_item_key,
            options=replace(jobs or JobOptions(), engine="serial")
            if len(items) < _SERIAL_BELOW and (jobs is None or jobs.engine == "local")
            else jobs,
        )
        job.raise_if_failed()
        for search in pending:
            outcomes = []
            for fault in search.next_faults():
                measured = [job.results[_item_key(FaultItem(fault, i))] for i in search.frames]
                report = _judge(scene, fault, base, measured, options, up)
                outcomes.append(_compare(plain, report, fault))
            search.record(outcomes)
        pending = [s for s in pending if not s.is_done]
    return Detectability(
        frames=[o.frame for o in base],
        camera_frame=camera_frame,
        left_out=[o.name for o in labelled if o not in chosen],
        passed=plain.passed,
        rows=[_row(s, plain) for s in searches],
    )


def observe_with_fault(
    item: FaultItem, *, root: Path, fingerprint: str, options: CheckOptions
) -> FrameObservation:
    """Measure one frame with a fault: its object, or all objects for a fault of the scene."""
    scene, caster = _open_with_fault(root, fingerprint, item.fault)
    only = [item.fault.object] if item.fault.object else None
    return measure_frame(scene, caster, scene.frame(item.frame), options, only=only)


@lru_cache(maxsize=2)
def _open_with_fault(root: Path, fingerprint: str, fault: Fault) -> tuple[FaultyScene, LabelCaster]:
    scene, caster = open_for_work(root, fingerprint)
    faulty = apply_fault(scene, fault)
    return faulty, LabelCaster.of_scene(faulty) if fault.object else caster


def _object_searches(
    scene: Scene,
    base: Sequence[FrameObservation],
    object_ids: Sequence[int],
    kinds: Sequence[FaultKind],
    up: NDArray[np.float64],
) -> list[_Search]:
    searches = []
    for object_id in object_ids:
        frames = [o.frame for o in base if object_id in o.objects]
        positions = [T.t for i in frames if (T := scene.T_world_cam(i)) is not None]
        along = object_centre(scene, object_id) - np.mean(positions, axis=0)
        along /= max(float(np.linalg.norm(along)), 1e-9)
        for kind in kinds:
            if kind.of_scene:
                continue
            fault = Fault(
                kind.name,
                0.0,
                object_id,
                up=(float(up[0]), float(up[1]), float(up[2])),
                along=(float(along[0]), float(along[1]), float(along[2])),
            )
            changed, note = frames, ""
            if kind.name == "moved":
                changed = frames[(len(frames) + 1) // 2 :]
                note = "" if changed else "visible in one frame only"
            if has_no_effect(scene, kind, fault):
                note = "symmetric about this axis"
            name = scene.objects.object(object_id).name
            searches.append(_Search(kind, fault, name, changed, note))
    return searches


def _scene_searches(
    base: Sequence[FrameObservation], camera_frame: int | None, kinds: Sequence[FaultKind]
) -> list[_Search]:
    searches = []
    for kind in (k for k in kinds if k.of_scene):
        note = "" if camera_frame is not None else "no object is visible"
        frames = [] if camera_frame is None else [camera_frame]
        if kind.name == "alignment":
            frames = [o.frame for o in base if o.has_depth]
            note = "" if frames else "no sensor depth"
        fault = Fault(kind.name, 0.0, frame=camera_frame if kind.name == "camera" else None)
        searches.append(_Search(kind, fault, "(scene)", frames, note))
    return searches


def _judge(
    scene: Scene,
    fault: Fault,
    base: Sequence[FrameObservation],
    measured: Sequence[FrameObservation],
    options: CheckOptions,
    up: NDArray[np.float64],
) -> CheckReport:
    """The report with the measurements of a fault in place of those without it."""
    again = {m.frame: m for m in measured}
    observed = [_merged(o, again[o.frame], fault) if o.frame in again else o for o in base]
    # The label of an object that moved is right in the other frames.
    altered = scene if fault.name == "moved" else apply_fault(scene, fault)
    return judge_scene(altered, observed, {}, options, up=up)


def _merged(base: FrameObservation, again: FrameObservation, fault: Fault) -> FrameObservation:
    """The frame with the fault; other objects than the fault's keep their measurements."""
    if not fault.object:
        return again
    others = {i: o for i, o in base.objects.items() if i != fault.object}
    tallies = {i: t for i, t in base.tallies.items() if i != fault.object}
    return replace(
        base,
        objects=dict(sorted((others | again.objects).items())),
        tallies=dict(sorted((tallies | again.tallies).items())),
    )


def _compare(plain: CheckReport, report: CheckReport, fault: Fault) -> _Outcome:
    failed = {g.key for g in plain.failed_gates()}
    caught = [g.key for g in report.failed_gates() if g.key not in failed]
    bad = {o.object for o in plain.objects if o.verdict == "wrong"}
    new = {o.object for o in report.objects if o.verdict == "wrong"} - bad
    if not caught and (new & {fault.object} if fault.object else new):
        caught = ["verdict"]
    return _Outcome(tuple(caught), {g.key: g for g in report.gates})


def _row(search: _Search, plain: CheckReport) -> FaultRow:
    without = _Outcome((), {g.key: g for g in plain.gates})
    outcomes = {0.0: [without], **dict(sorted(search.outcomes.items()))}
    keys = [
        key
        for key, gate in without.gates.items()
        if gate.limit > 0
        and any(
            key in o.gates and o.gates[key].value != gate.value
            for several in outcomes.values()
            for o in several
        )
    ]
    trials = [
        FaultTrial(
            size=size,
            caught=bool(size) and all(o.caught_by for o in several),
            gates=list(dict.fromkeys(k for o in several for k in o.caught_by)),
            ratio=_ratio(several, keys),
        )
        for size, several in outcomes.items()
    ]
    caught = next((t for t in trials if t.caught), None)
    missed = [t.size for t in trials if not t.caught]
    return FaultRow(
        object=search.fault.object or None,
        name=search.name,
        fault=search.kind.name,
        unit=search.kind.unit,
        caught_from=caught.size if caught else None,
        missed_to=max(missed),
        gates=caught.gates if caught else [],
        note=search.note,
        trials=[] if search.note else trials,
    )


def _ratio(outcomes: Sequence[_Outcome], keys: Sequence[str]) -> float | None:
    """Largest value over limit among some gates, in the direction in which it is smaller."""
    found = []
    for outcome in outcomes:
        ratios = []
        for gate in (outcome.gates[k] for k in keys if k in outcome.gates):
            if gate.value is None:
                continue
            if gate.rule == "at most":
                ratios.append(gate.value / gate.limit)
            else:
                ratios.append(gate.limit / max(gate.value, 1e-9))
        if ratios:
            found.append(max(ratios))
    return round(min(found), 4) if found else None


def _camera_frame(base: Sequence[FrameObservation]) -> int | None:
    """The frame in the middle of those that show most objects."""
    most = max((len(o.objects) for o in base), default=0)
    full = [o.frame for o in base if len(o.objects) == most]
    return full[len(full) // 2] if most else None


def _item_key(item: FaultItem) -> str:
    fault = item.fault
    return f"{fault.name} {fault.size:g} object {fault.object} frame {item.frame}"
