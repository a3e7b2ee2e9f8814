"""Faults of single frames: a camera pose that is wrong, an object that moved, shifted depth.

`measure.frame_evidence` says which frames contradict the others, and whether camera or object is
the cause. The gates of this family count what was found. Frames that show an object nowhere are no
fault: something may hide it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot

import msgspec
import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.checks.gates.gate import (
    Measured,
    Moved,
    ObjectGate,
    Reading,
    Readings,
    SceneGate,
    no_exemption,
)
from std_toolkit.checks.gates.hypotheses import JudgeSettings
from std_toolkit.checks.measure.frame_evidence import FrameEvidence
from std_toolkit.checks.measure.frame_motion import Displaced
from std_toolkit.checks.result import CheckWarning, FrameCheck, ObjectCheck, ObjectFrameCheck
from std_toolkit.errors import listed
from std_toolkit.options import CheckOptions
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.settings import Settings, limit

# Names of frames in a row of the report.
_MOST_NAMES = 4


@dataclass(frozen=True, kw_only=True)
class FrameGateSettings(Settings):
    """What single frames are believed."""

    fewest_reflecting: int = limit(
        3,
        source="world seeds 211, 212 and 223 to 229: one frame or two show steel 10 to 61 mm off",
    )
    """steel that fewer frames in a row show elsewhere did not move"""
    topples: float = limit(3.0, source="what is bumped slides; what falls over moves far")
    """limits of the displacement below which glass and steel slide on their support"""


@dataclass(frozen=True)
class FrameFaults:
    """The tables of the report with their faults, and what caused them.

    Attributes:
        objects, frames: the rows with `fault` set.
        moved: objects that moved.
    """

    objects: list[ObjectCheck]
    frames: list[FrameCheck]
    moved: list[Moved]


def find_frame_faults(
    objects: Sequence[ObjectCheck],
    frames: Sequence[FrameCheck],
    options: CheckOptions,
    evidence: FrameEvidence,
    *,
    up: Array,
) -> FrameFaults:
    """Set the faults of frames and of objects in frames.

    Args:
        objects, frames: tables of the report.
        options: limits.
        evidence: what contradicts the other frames.
        up: (3,) normal of the plane on which objects stand, in the world.
    """
    moved = [
        Moved(
            o.object,
            o.name,
            tuple(
                (a, b)
                for a, b in ((run.before, run.frames[0]), (run.frames[-1], run.after))
                if a is not None and b is not None
            ),
            run.frames,
            run.mm,
            evidence.right.isdisjoint(run.frames),
        )
        for o in objects
        for run in evidence.displaced.get(o.object, ())
        if not _is_reflection(o, run, up, options)
    ]
    faults = {(m.object, f): _said(m) for m in moved for f in m.frames}
    return FrameFaults(
        [
            msgspec.structs.replace(
                o,
                frames=[
                    msgspec.structs.replace(
                        f, fault=faults.get((o.object, f.frame)) or _depth_fault(f, options)
                    )
                    for f in o.frames
                ],
            )
            for o in objects
        ],
        [_with_fault(row, evidence.camera, options) for row in frames],
        moved,
    )


def _is_reflection(item: ObjectCheck, run: Displaced, up: Array, options: CheckOptions) -> bool:
    """Whether edges that glass or steel shows, not its own, seem to put it elsewhere.

    So do few frames of steel, and small motions that do not slide on the support.
    """
    limits = FrameGateSettings.current()
    if item.material in DIFFUSE_MATERIALS:
        return False
    few = item.material == "specular" and len(run.frames) < limits.fewest_reflecting
    near = run.mm < limits.topples * options.max_motion_mm
    return few or (near and not _slides(run, up))


def _slides(run: Displaced, up: Array) -> bool:
    """Whether a motion along the support explains what frames show of glass or steel.

    What is bumped slides and turns about the normal of its support, `up` (3,). The margin of the
    evidence must exceed chi square of lift and tilts, which reflections and refraction mislead.
    """
    limits = JudgeSettings.current()
    off = np.zeros((3, 6))
    off[0, :3], off[1:, 3:] = up, np.linalg.svd(up[None])[2][1:]
    misled = np.diag([limits.misled_mm / 1000] + [np.radians(limits.misled_deg)] * 2) ** 2
    lifted = off @ run.motion
    chi2 = lifted @ np.linalg.solve(off @ run.covariance @ off.T + misled, lifted)
    return bool(chi2 <= run.margin)


def _said(moved: Moved) -> str:
    what = "camera pose or object moved" if moved.or_camera else "moved"
    return f"{what}: {moved.mm:.0f} mm"


def _depth_fault(row: ObjectFrameCheck, options: CheckOptions) -> str:
    if row.depth_unscaled_mm is not None and abs(row.depth_unscaled_mm) > options.max_depth_mm:
        return f"{row.depth_unscaled_mm:+.1f} mm against the depth"
    return ""


def _with_fault(row: FrameCheck, camera: Mapping[int, str], options: CheckOptions) -> FrameCheck:
    fault = ""
    shift = 0.0 if row.depth_shift_px is None else hypot(*row.depth_shift_px)
    if row.problem:
        fault = "unreadable"
    elif row.frame in camera:
        fault = f"camera pose: {camera[row.frame]}"
    elif shift > options.max_alignment_px:
        fault = f"depth shifted by {shift:.1f} px"
    return msgspec.structs.replace(row, fault=fault)


def frame_ranges(ids: Sequence[int], limit: int = 8) -> str:
    """Ids as ranges, such as "3-7, 12"."""
    runs: list[list[int]] = []
    for i in ids:
        if runs and i == runs[-1][1] + 1:
            runs[-1][1] = i
        else:
            runs.append([i, i])
    return listed([str(a) if a == b else f"{a}-{b}" for a, b in runs], limit)


def _unreadable(measured: Measured) -> Reading | None:
    if not (measured.summary.looked_at or measured.frames):
        return None
    bad = [f.name for f in measured.frames if f.problem]
    return Reading(float(len(bad)), detail=listed(bad))


def _wrong_cameras(measured: Measured) -> Reading | None:
    if not measured.has_contours:
        return None
    names = {f.frame: f.name for f in measured.frames}
    found = [names[i] for i in sorted(measured.evidence.camera)]
    return Reading(float(len(found)), detail=listed(found, _MOST_NAMES))


def _has_moved(item: ObjectCheck, measured: Measured) -> Reading | None:
    if not measured.has_contours:
        return None
    return Reading(float(any(m.object == item.object for m in measured.moved)))


def _moves(found: Readings, measured: Measured) -> str:
    names = {f.frame: f.name for f in measured.frames}
    objects = {item.object for item, _ in found}
    return "; ".join(_sentence(m, names) for m in measured.moved if m.object in objects)


def _sentence(m: Moved, names: Mapping[int, str]) -> str:
    first, last = names[m.frames[0]], names[m.frames[-1]]
    where = f"frame {first}" if first == last else f"frames {first} to {last}"
    if m.or_camera:
        return f"{m.name} moved or the camera pose is wrong in {where}, by {m.mm:.0f} mm"
    between = " and ".join(f"between frames {names[a]} and {names[b]}" for a, b in m.between)
    return f"{m.name} moved {m.mm:.0f} mm {between or 'in ' + where}"


def _unseen(measured: Measured) -> Iterable[CheckWarning]:
    """Frames that say nothing of an object that the others show."""
    for item in measured.objects:
        frames = measured.evidence.unseen.get(item.object, ())
        if frames:
            yield CheckWarning(
                severity="low",
                about=item.name,
                problem=f"is not seen in {len(frames)} frames in which its label puts it: "
                f"{frame_ranges(frames)}",
                advice="something hides it there, or it was taken away: look at these frames",
            )


def _damaged_and_stale(measured: Measured) -> Iterable[CheckWarning]:
    for f in measured.frames:
        if f.problem:
            yield CheckWarning(
                severity="high",
                about=f"frame {f.name}",
                problem=f"could not be checked: {f.problem}",
                advice="restore the file or import the recording again",
            )
    stale = [f.frame for f in measured.frames if f.truth == "stale"]
    if stale:
        yield CheckWarning(
            severity="high",
            about=f"{len(stale)} frames",
            problem="ground truth was rendered from other labels or camera poses: "
            f"{frame_ranges(stale)}",
            advice="run `std-curate render`",
        )


GATES = (
    SceneGate(
        key="frames",
        title="frames that could not be checked",
        measure=_unreadable,
        names=True,
        advice="restore the files named in the warnings, or import the recording again",
        warn=_damaged_and_stale,
    ),
    SceneGate(
        key="camera",
        title="frames with a wrong camera pose",
        measure=_wrong_cameras,
        advice="other frames put the camera elsewhere in these: run `std-curate poses` again, or "
        "leave the frames out (`std-curate export --drop-bad-frames`)",
    ),
    ObjectGate(
        key="moved",
        title="objects that moved during the recording",
        measure=_has_moved,
        counts=True,
        exempt=no_exemption,
        names=False,
        detail=_moves,
        advice="cut the recording where the object moved, or leave the frames out "
        "(`std-curate export --drop-bad-frames`)",
        warn=_unseen,
    ),
)
