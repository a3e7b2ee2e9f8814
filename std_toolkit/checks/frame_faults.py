"""Faults of single frames, and of objects in single frames."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import msgspec

from std_toolkit.checks.result import FrameCheck, ObjectCheck, ObjectFrameCheck
from std_toolkit.options import CheckOptions

# In a frame with a wrong camera pose nearly all objects are off, in other frames they are not.
_CAMERA_SHARE = 0.6
_FEWEST_OBJECTS = 2


def with_object_faults(item: ObjectCheck, options: CheckOptions) -> ObjectCheck:
    """The object with `fault` set in the frames in which its label does not fit."""
    rows = [msgspec.structs.replace(f, fault=_object_fault(f, options)) for f in item.frames]
    return msgspec.structs.replace(item, frames=rows)


def with_frame_faults(
    frames: Sequence[FrameCheck], objects: Sequence[ObjectCheck]
) -> list[FrameCheck]:
    """The frames with `fault` set where the camera pose is wrong or a file cannot be read.

    Objects that are off in most of their frames have wrong labels and say nothing about cameras.
    """
    usable = [o for o in objects if o.label in ("propagated", "refined") and not _mostly_off(o)]
    found = []
    for row in frames:
        seen = [f for o in usable for f in o.frames if f.frame == row.frame and f.shift_px]
        off = sum(bool(f.fault) for f in seen)
        fault = row.fault
        if row.problem:
            fault = "unreadable"
        elif not fault and off >= _FEWEST_OBJECTS and off >= _CAMERA_SHARE * len(seen):
            fault = "camera pose"
        found.append(msgspec.structs.replace(row, fault=fault))
    return found


def _object_fault(row: ObjectFrameCheck, options: CheckOptions) -> str:
    if row.fault:
        return row.fault
    clear = (row.edge_support or 0) >= options.min_edge_support
    if clear and row.shift_px is not None and hypot(*row.shift_px) > options.max_shift_px:
        return f"shifted by {hypot(*row.shift_px):.1f} px"
    if row.depth_unscaled_mm is not None and abs(row.depth_unscaled_mm) > options.max_depth_mm:
        return f"{row.depth_unscaled_mm:+.1f} mm against the depth"
    return ""


def _mostly_off(item: ObjectCheck) -> bool:
    return 2 * sum(bool(f.fault) for f in item.frames) > len(item.frames)
