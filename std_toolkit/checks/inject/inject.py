"""Smallest faults that the judge of the check catches in a scene (`std-curate check --inject`).

Each kind of fault has a ladder of sizes. The smallest size that is caught is found by bisection on
the ladder, for all objects and kinds at once, so that every round is one job. A frame is measured
again only where the fault changes it, and only the object of a fault is judged again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.checks.detectability import Detectability
from std_toolkit.checks.gates.gate import REFUSED
from std_toolkit.checks.gates.judge import judge_scene
from std_toolkit.checks.inject.faults import (
    KINDS,
    Fault,
    FaultKind,
    FaultyScene,
    apply_fault,
    has_no_effect,
)
from std_toolkit.checks.inject.ladder import Search, TrialOutcome
from std_toolkit.checks.measure.contours import LabelCaster, object_centre
from std_toolkit.checks.measure.coverage import spread
from std_toolkit.checks.measure.residuals import FrameObservation, measure_frame, open_for_work
from std_toolkit.checks.measure.textures import compare_textures
from std_toolkit.checks.result import CheckReport
from std_toolkit.jobs import JobOptions, run_jobs
from std_toolkit.options import CheckOptions
from std_toolkit.scene import Scene

# Starting worker processes takes longer than measuring this many frames.
_SERIAL_BELOW = 12
# Number of frames in which a promise is tried, where the search uses fewer.
CONFIRMED_IN = 40


@dataclass(frozen=True)
class FaultItem:
    """A job item: one frame measured with a fault."""

    fault: Fault
    frame: int


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
    """Put faults of growing size into the scene in memory and ask the judge.

    A fault of an object is caught if its verdict turns doubtful or wrong, whatever other objects
    say. Faults with two directions must be caught in both. In recordings with more frames than the
    search uses, every smallest size is tried again with more of them.

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
    few = _Trials(scene, spread(observed, options.inject_frames), fingerprint, options, jobs, up)
    labelled = [o for o in scene.objects.objects if any(o.id in f.objects for f in few.base)]
    chosen = spread(labelled, options.inject_objects)
    camera_frame = _camera_frame(few.base)
    searches = [
        *_object_searches(few, [o.id for o in chosen], kinds),
        *_scene_searches(few.base, camera_frame, kinds),
    ]
    while pending := [(s, size) for s in searches for size in s.next_sizes()]:
        for (search, size), outcomes in zip(pending, few.outcomes(pending), strict=True):
            search.record(size, outcomes)
    frames = max(options.inject_frames, CONFIRMED_IN) if options.inject_frames else 0
    more = spread(observed, frames)
    unsure = [s for s in searches if s.fault.object] if len(more) > len(few.base) else []
    if unsure:
        many = _Trials(scene, more, fingerprint, options, jobs, up)
        for search in unsure:
            search.frames = many.frames_of(search.fault)
        while promised := [(s, p) for s in unsure if (p := s.promise) is not None]:
            found = zip(promised, many.outcomes(promised), strict=True)
            unsure = [s for (s, _), outcomes in found if not s.confirm(outcomes)]
    return Detectability(
        frames=[o.frame for o in few.base],
        confirmed_in=len(more),
        camera_frame=camera_frame,
        left_out=[o.name for o in labelled if o not in chosen],
        passed=few.plain.passed,
        rows=[s.row(few.plain) for s in searches],
    )


class _Trials:
    """Faults in some of the frames, and what the judge says of them.

    Attributes:
        scene: the scene without a fault.
        base: its frames.
        plain: the report on them.
        up: see `inject_faults`.
    """

    def __init__(
        self,
        scene: Scene,
        base: Sequence[FrameObservation],
        fingerprint: str,
        options: CheckOptions,
        jobs: JobOptions | None,
        up: NDArray[np.float64],
    ) -> None:
        self.scene, self.base, self.up = scene, list(base), up
        self._options, self._jobs, self._turn = options, jobs or JobOptions(), 0
        self._measure = partial(
            observe_with_fault, root=scene.root, fingerprint=fingerprint, options=options
        )
        self._textures = compare_textures(scene, [scene.frame(o.frame) for o in base])
        self.plain = judge_scene(scene, self.base, {}, options, up=up, compared=self._textures)

    def frames_of(self, fault: Fault) -> list[int]:
        """Ids of the frames that a fault of an object changes."""
        seen = [o.frame for o in self.base if fault.object in o.objects]
        return seen[(len(seen) + 1) // 2 :] if fault.name == "moved" else seen

    def outcomes(self, pending: Sequence[tuple[Search, float]]) -> list[list[TrialOutcome]]:
        """What the judge says of some searches with faults of a size, in each direction."""
        self._turn += 1
        items = [FaultItem(f, i) for s, size in pending for f in s.faults(size) for i in s.frames]
        serial = len(items) < _SERIAL_BELOW and self._jobs.engine == "local"
        job = run_jobs(
            self._measure,
            items,
            name=f"inject {self._turn} in {len(self.base)} frames",
            key=_item_key,
            options=replace(self._jobs, engine="serial") if serial else self._jobs,
        )
        job.raise_if_failed()
        found = []
        for search, size in pending:
            outcomes = []
            for fault in search.faults(size):
                measured = [job.results[_item_key(FaultItem(fault, i))] for i in search.frames]
                report = self._judge(fault, measured)
                outcomes.append(TrialOutcome.of(self.plain, report, fault))
            found.append(outcomes)
        return found

    def _judge(self, fault: Fault, measured: Sequence[FrameObservation]) -> CheckReport:
        """The report with the measurements of a fault in place of those without it."""
        again = {m.frame: m for m in measured}
        observed = [_merged(o, again[o.frame], fault) if o.frame in again else o for o in self.base]
        # The label of an object that moved is right in the other frames.
        altered = self.scene if fault.name == "moved" else apply_fault(self.scene, fault)
        compared = dict(self._textures)
        if fault.object in compared and fault.name == "moved":
            # A texture that is seen in two places says nothing.
            del compared[fault.object]
        elif fault.object in compared and compared[fault.object].is_textured:
            frames = [self.scene.frame(o.frame) for o in self.base]
            compared |= compare_textures(altered, frames, only=[fault.object])
        return judge_scene(
            altered,
            observed,
            {},
            self._options,
            up=self.up,
            compared=compared,
            only=[fault.object] if fault.object else None,
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
    trials: _Trials, object_ids: Sequence[int], kinds: Sequence[FaultKind]
) -> list[Search]:
    scene, (x, y, z) = trials.scene, trials.up
    verdicts = {o.object: o.verdict for o in trials.plain.objects}
    searches = []
    for object_id in object_ids:
        seen = [o.frame for o in trials.base if object_id in o.objects]
        positions = [T.t for i in seen if (T := scene.T_world_cam(i)) is not None]
        along = object_centre(scene, object_id) - np.mean(positions, axis=0)
        along /= max(float(np.linalg.norm(along)), 1e-9)
        for kind in kinds:
            if kind.of_scene:
                continue
            fault = Fault(
                kind.name,
                0.0,
                object_id,
                up=(float(x), float(y), float(z)),
                along=(float(along[0]), float(along[1]), float(along[2])),
            )
            frames, note = trials.frames_of(fault), ""
            if not frames:
                note = "visible in one frame only"
            if has_no_effect(scene, kind, fault):
                note = "symmetric about this axis"
            if verdicts[object_id] in REFUSED:
                note = f"{verdicts[object_id]} without a fault"
            name = scene.objects.object(object_id).name
            searches.append(Search(kind, fault, name, frames, note))
    return searches


def _scene_searches(
    base: Sequence[FrameObservation], camera_frame: int | None, kinds: Sequence[FaultKind]
) -> list[Search]:
    searches = []
    for kind in (k for k in kinds if k.of_scene):
        note = "" if camera_frame is not None else "no object is visible"
        frames = [] if camera_frame is None else [camera_frame]
        if kind.name == "alignment":
            frames = [o.frame for o in base if o.has_depth]
            note = "" if frames else "no sensor depth"
        fault = Fault(kind.name, 0.0, frame=camera_frame if kind.name == "camera" else None)
        searches.append(Search(kind, fault, "(scene)", frames, note))
    return searches


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


def _camera_frame(base: Sequence[FrameObservation]) -> int | None:
    """The frame in the middle of those that show most objects."""
    most = max((len(o.objects) for o in base), default=0)
    full = [o.frame for o in base if len(o.objects) == most]
    return full[len(full) // 2] if most else None


def _item_key(item: FaultItem) -> str:
    fault = item.fault
    return f"{fault.name} {fault.size:g} object {fault.object} frame {item.frame}"
