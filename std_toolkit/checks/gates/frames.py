"""Faults of single frames: a camera pose that is wrong, an object that moved, shifted depth.

A label fits in a frame if clearly more of its contour lies on image edges than by chance, about as
much as in its other frames, and no clear shift contradicts it. An object whose label fits in enough
frames is a witness: where it does not fit, the camera pose is wrong if most other witnesses do not
fit either; otherwise the object moved. The gates of this family count what was found.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot

import msgspec
import numpy as np

from std_toolkit.checks.gates.gate import (
    Measured,
    Moved,
    ObjectGate,
    Reading,
    Readings,
    SceneGate,
    listed,
    no_exemption,
)
from std_toolkit.checks.result import CheckWarning, FrameCheck, ObjectCheck, ObjectFrameCheck
from std_toolkit.options import CheckOptions
from std_toolkit.scene.model import DIFFUSE_MATERIALS
from std_toolkit.settings import NOT_RECORDED, Settings, limit

# Names of frames in a row of the report.
_MOST_NAMES = 4


@dataclass(frozen=True, kw_only=True)
class FrameSettings(Settings):
    """When a label fits in a frame, and what follows for camera and object."""

    fits: float = limit(0.55, source=NOT_RECORDED)
    """a label fits above this part of the margin that is usual for the object; margin: share of
    the contour on edges minus that of displaced contours"""
    off: float = limit(0.4, source=NOT_RECORDED)
    """a label does not fit below this part of the usual margin"""
    smallest_margin: float = limit(0.12, source=NOT_RECORDED)
    """a smaller margin is no fit"""
    fewest_fits: int = limit(2, source=NOT_RECORDED)
    """frames in which a witness fits"""
    share_of_fits: float = limit(0.3, source=NOT_RECORDED)
    """share of its frames in which a witness fits"""
    clear: float = limit(0.25, source=NOT_RECORDED)
    """usual margin of a witness"""
    camera_share: float = limit(
        0.6,
        source="where a camera pose is wrong, nearly all witnesses do not fit",
    )
    """share of the witnesses that do not fit where a camera pose is wrong"""
    fewest_witnesses: int = limit(2, source=NOT_RECORDED)
    """witnesses against a camera pose"""
    fewest_moved: int = limit(3, source="a hand in front of an object hides it for a moment")
    """frames in a row without a fit of an object that moved"""
    share_moved: float = limit(0.06, source=NOT_RECORDED)
    """the same as a share of all frames"""
    contradiction: float = limit(0.2, source=NOT_RECORDED)
    """part of single frames that may contradict a motion"""


@dataclass(frozen=True)
class FrameFaults:
    """The tables of the report with their faults, and what caused them.

    Attributes:
        objects, frames: the rows with `fault` set.
        camera: ids of the frames with a wrong camera pose.
        moved: objects that moved.
        unfit: share of the frames in which a witness does not fit, by name; frames with a wrong
            camera pose do not count.
    """

    objects: list[ObjectCheck]
    frames: list[FrameCheck]
    camera: list[int]
    moved: list[Moved]
    unfit: dict[str, float]


def find_frame_faults(
    objects: Sequence[ObjectCheck], frames: Sequence[FrameCheck], options: CheckOptions
) -> FrameFaults:
    """Set the faults of frames and of objects in frames.

    Args:
        objects, frames: tables of the report.
        options: limits and the smallest share of a contour near edges.
    """
    limits = FrameSettings.current()
    states = {o.object: _states(o, options) for o in objects}
    witnesses = [o for o in objects if _is_witness(o, states[o.object])]
    camera = []
    for row in frames:
        seen = [s for o in witnesses if (s := states[o.object].get(row.frame)) is not None]
        off = sum(not fits for fits in seen)
        if off >= limits.fewest_witnesses and off >= limits.camera_share * len(seen):
            camera.append(row.frame)
    moved = [
        m for o in witnesses if (m := _motion(o, states[o.object], frozenset(camera))) is not None
    ]
    moved_in = {(m.object, f) for m in moved for f in m.frames}
    trusted = {o.object for o in witnesses}
    return FrameFaults(
        [
            msgspec.structs.replace(
                o,
                frames=[
                    msgspec.structs.replace(
                        f,
                        fault="moved"
                        if (o.object, f.frame) in moved_in
                        else _fault(f, o, o.object in trusted, states[o.object], options),
                    )
                    for f in o.frames
                ],
            )
            for o in objects
        ],
        [_with_fault(row, camera, options) for row in frames],
        camera,
        moved,
        {o.name: _unfit(states[o.object], frozenset(camera)) for o in witnesses},
    )


def _margin(row: ObjectFrameCheck) -> float | None:
    """Share of the contour on edges minus chance; None where it was not measured."""
    if row.on_edges is None or row.on_edges_chance is None:
        return None
    return row.on_edges - row.on_edges_chance


def _shift_px(row: ObjectFrameCheck) -> float:
    return hypot(*row.shift_px) if row.shift_px is not None else 0.0


def _usual_margin(item: ObjectCheck) -> float:
    """Margin of the object where its label fits: the median of the better half of the frames."""
    margins = sorted((m for f in item.frames if (m := _margin(f)) is not None), reverse=True)
    return float(np.median(margins[: (len(margins) + 1) // 2])) if margins else 0.0


def _states(item: ObjectCheck, options: CheckOptions) -> dict[int, bool]:
    """Whether the label fits, by frame id; frames that do not tell are absent."""
    limits = FrameSettings.current()
    usual = _usual_margin(item)
    states = {}
    for row in item.frames:
        margin = _margin(row)
        if margin is None:
            continue
        if _shift_px(row) > options.max_shift_px or margin < limits.off * usual:
            states[row.frame] = False
        elif margin >= max(limits.fits * usual, limits.smallest_margin):
            states[row.frame] = True
    return states


def _is_witness(item: ObjectCheck, states: dict[int, bool]) -> bool:
    limits = FrameSettings.current()
    fits = sum(states.values())
    return (
        fits >= max(limits.fewest_fits, limits.share_of_fits * len(states))
        and _usual_margin(item) >= limits.clear
    )


def _unfit(states: dict[int, bool], camera: frozenset[int]) -> float:
    """Share of frames in which a label does not fit; a single frame is no share."""
    known = [fits for frame, fits in states.items() if frame not in camera]
    off = known.count(False)
    return off / len(known) if off > 1 else 0.0


def _motion(item: ObjectCheck, states: dict[int, bool], camera: frozenset[int]) -> Moved | None:
    """The run of frames in which the label does not fit, if it fits in nearly all others."""
    limits = FrameSettings.current()
    known = [(f, fits) for f, fits in sorted(states.items()) if f not in camera]
    gains = np.array([-1 if fits else 1 for _, fits in known])
    if len(gains) < limits.fewest_moved + limits.fewest_fits:
        return None
    # The run with the largest sum.
    total = np.concatenate([[0], np.cumsum(gains)])
    best = (0, 0, 0)
    for end in range(1, len(total)):
        start = int(total[:end].argmin())
        best = max(best, (int(total[end] - total[start]), -start, end))
    start, end = -best[1], best[2]
    inside, outside = gains[start:end], np.concatenate([gains[:start], gains[end:]])
    fewest = max(limits.fewest_moved, limits.share_moved * len(known))
    if len(inside) < fewest or len(outside) < limits.fewest_fits:
        return None
    if (inside < 0).mean() > limits.contradiction or (outside > 0).mean() > limits.contradiction:
        return None
    frames = [f for f, _ in known]
    between = []
    if start > 0:
        between.append((frames[start - 1], frames[start]))
    if end < len(frames):
        between.append((frames[end - 1], frames[end]))
    off = tuple(f for f, fits in known[start:end] if not fits)
    return Moved(item.object, item.name, tuple(between), off)


def _fault(
    row: ObjectFrameCheck,
    item: ObjectCheck,
    trusted: bool,
    states: dict[int, bool],
    options: CheckOptions,
) -> str:
    if item.material not in DIFFUSE_MATERIALS:
        return ""
    if (row.edge_support or 0) >= options.min_edge_support:
        if _shift_px(row) > options.max_shift_px:
            return f"shifted by {_shift_px(row):.1f} px"
        if trusted and states.get(row.frame) is False:
            return "contour off the image edges"
    if row.depth_unscaled_mm is not None and abs(row.depth_unscaled_mm) > options.max_depth_mm:
        return f"{row.depth_unscaled_mm:+.1f} mm against the depth"
    return ""


def _with_fault(row: FrameCheck, camera: Sequence[int], options: CheckOptions) -> FrameCheck:
    fault = ""
    shift = 0.0 if row.depth_shift_px is None else hypot(*row.depth_shift_px)
    if row.problem:
        fault = "unreadable"
    elif row.frame in camera:
        fault = "camera pose"
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
    text = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs[:limit])
    return text + (f" and {len(runs) - limit} more" if len(runs) > limit else "")


def _unreadable(measured: Measured) -> Reading | None:
    if not (measured.summary.looked_at or measured.frames):
        return None
    bad = [f.name for f in measured.frames if f.problem]
    return Reading(float(len(bad)), detail=listed(bad))


def _wrong_cameras(measured: Measured) -> Reading | None:
    if not measured.has_contours:
        return None
    names = {f.frame: f.name for f in measured.frames}
    found = [names[i] for i in measured.camera]
    return Reading(float(len(found)), detail=listed(found, _MOST_NAMES))


def _has_moved(item: ObjectCheck, measured: Measured) -> Reading | None:
    if not measured.has_contours:
        return None
    return Reading(float(any(m.object == item.object for m in measured.moved)))


def _moves(found: Readings, measured: Measured) -> str:
    names = {f.frame: f.name for f in measured.frames}
    objects = {item.object for item, _ in found}
    return "; ".join(
        f"{m.name} moved "
        + " and ".join(f"between frames {names[a]} and {names[b]}" for a, b in m.between)
        for m in measured.moved
        if m.object in objects
    )


def _most_unfit(measured: Measured) -> Reading | None:
    unfit = measured.unfit
    worst = max(unfit, key=lambda name: unfit[name], default=None)
    if worst is None:
        return None
    value = round(100 * unfit[worst], 1)
    return Reading(value, detail=worst if value else "")


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
        advice="most labels that fit in the other frames do not fit in these: run `std-curate "
        "poses` again, or leave the frames out (`std-curate export --drop-bad-frames`)",
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
    ),
    SceneGate(
        key="unfit",
        title="frames in which a label does not fit, worst object",
        measure=_most_unfit,
        limit=lambda options: round(100 * options.max_unfit, 1),
        unit="%",
        advice="look at these frames in the report; leave them out "
        "(`std-curate export --drop-bad-frames`), or label the parts of the recording apart",
    ),
)
