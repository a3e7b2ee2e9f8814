"""Gates on single frames: camera poses, objects that moved, share of frames that do not fit,
alignment of depth and colour."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import Literal

from std_toolkit.checks.gates.frame_faults import FrameFaults, Motion
from std_toolkit.checks.result import CheckGate, SceneSummary
from std_toolkit.options import CheckOptions

# Fewer outlines do not determine the shift of depth.
_FEWEST_OUTLINES = 3
# The shift must exceed its limit by this many standard deviations to fail.
_SIGMAS = 2.0
_MOST_NAMES = 4


def fault_gates(
    faults: FrameFaults, summary: SceneSummary, options: CheckOptions
) -> list[CheckGate]:
    """The gates `camera`, `moved`, `unfit` and `alignment`; open if nothing was measured."""
    names = {f.frame: f.name for f in faults.frames}
    measured = any(f.edge_px is not None for o in faults.objects for f in o.frames)
    return [
        _count(
            "camera",
            "frames with a wrong camera pose",
            len(faults.camera) if measured else None,
            _listed([names[i] for i in faults.camera]),
            "most labels that fit in the other frames do not fit in these: run `std-curate poses` "
            "again, or leave the frames out (`std-curate export --drop-bad-frames`)",
        ),
        _count(
            "moved",
            "objects that moved during the recording",
            len(faults.moved) if measured else None,
            "; ".join(_described(m, names) for m in faults.moved),
            "cut the recording where the object moved, or leave the frames out "
            "(`std-curate export --drop-bad-frames`)",
        ),
        _unfit(faults, options),
        _alignment(summary, options),
    ]


def _unfit(faults: FrameFaults, options: CheckOptions) -> CheckGate:
    worst = max(faults.unfit, key=lambda name: faults.unfit[name], default=None)
    value = None if worst is None else round(100 * faults.unfit[worst], 1)
    limit = round(100 * options.max_unfit, 1)
    status: Literal["pass", "fail", "open"] = "open"
    if value is not None:
        status = "fail" if value > limit else "pass"
    return CheckGate(
        key="unfit",
        title="frames in which a label does not fit, worst object",
        value=value,
        limit=limit,
        rule="at most",
        unit="%",
        status=status,
        detail=worst if worst is not None and value else "",
        advice="look at these frames in the report; leave them out "
        "(`std-curate export --drop-bad-frames`), or label the parts of the recording apart",
    )


def depth_shift_words(shift_px: Sequence[float]) -> str:
    """A shift of depth in words, such as "5.0 px right, 0.1 px up"."""
    x, y = shift_px
    return (
        f"{abs(x):.1f} px {'right' if x >= 0 else 'left'}, "
        f"{abs(y):.1f} px {'down' if y >= 0 else 'up'}"
    )


def _alignment(summary: SceneSummary, options: CheckOptions) -> CheckGate:
    value, detail = None, ""
    status: Literal["pass", "fail", "open"] = "open"
    if summary.depth_shift_px is not None and summary.depth_shifts >= _FEWEST_OUTLINES:
        value = round(hypot(*summary.depth_shift_px), 3)
        slack = _SIGMAS * (summary.depth_shift_std_px or 0.0)
        status = "fail" if value > options.max_alignment_px + slack else "pass"
        detail = (
            f"depth lies {depth_shift_words(summary.depth_shift_px)} of colour, "
            f"± {summary.depth_shift_std_px:.1f} px, {summary.depth_shifts} outlines"
        )
    return CheckGate(
        key="alignment",
        title="shift of sensor depth against colour",
        value=value,
        limit=options.max_alignment_px,
        rule="at most",
        unit="px",
        status=status,
        detail=detail,
        advice="align depth to colour with the extrinsics of the sensor, and record both at the "
        "same time",
    )


def _count(key: str, title: str, value: int | None, detail: str, advice: str) -> CheckGate:
    status: Literal["pass", "fail", "open"] = "open"
    if value is not None:
        status = "fail" if value else "pass"
    return CheckGate(
        key=key,
        title=title,
        value=None if value is None else float(value),
        limit=0.0,
        rule="at most",
        status=status,
        detail=detail,
        advice=advice,
    )


def _described(motion: Motion, names: dict[int, str]) -> str:
    places = " and ".join(f"between frames {names[a]} and {names[b]}" for a, b in motion.between)
    return f"{motion.name} moved {places}"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMES])
    more = len(names) - _MOST_NAMES
    return shown + (f" and {more} more" if more > 0 else "")
