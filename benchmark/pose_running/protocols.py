"""Pose protocols as a user asks for them: by name, with single choices changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from benchmark.metrics.pose import BoxIoU, PoseProtocol, PoseScoring, get_pose_protocol

# What both published evaluations ask for before angle and distance count.
FOUND_MEANS_OVERLAP = 0.1
GATES = ("all", "found")


def wanted_protocols(
    names: Sequence[str],
    *,
    iou: str | None = None,
    score: str | None = None,
    gates: str | None = None,
) -> list[PoseProtocol]:
    """Protocols with some of their choices changed, which their names then tell.

    Args:
        names: of `pose_protocols`.
        iou: `oriented`, `aabb` or `nocs2019`, instead of the protocol's own.
        score: `ap` or `accuracy`.
        gates: whether angle and distance count of `all` predictions, or of `found` ones, which
            overlap a true box.

    Raises:
        ToolkitError: no such protocol.

    >>> [p.name for p in wanted_protocols(["strict"], iou="aabb", score="ap")]
    ['strict, iou aabb']
    """
    found = []
    for name in names:
        protocol = get_pose_protocol(name)
        told = [name]
        if iou is not None and BoxIoU(iou) is not protocol.iou:
            protocol = replace(protocol, iou=BoxIoU(iou))
            told.append(f"iou {iou}")
        if score is not None and PoseScoring(score) is not protocol.score:
            protocol = replace(protocol, score=PoseScoring(score))
            told.append(f"score {score}")
        if gates is not None and (gates == "found") != (protocol.pose_needs_iou is not None):
            least = FOUND_MEANS_OVERLAP if gates == "found" else None
            protocol = replace(protocol, pose_needs_iou=least)
            told.append(f"gates {gates}")
        found.append(replace(protocol, name=", ".join(told)))
    return found
