"""The results of a few runs of poses as tables in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from benchmark.metrics.pose import PoseProtocol
from benchmark.pose_running.results import PoseResult
from benchmark.pose_running.scoring import ALL, HARD, Scored, score_runs
from benchmark.running.aligned import aligned

_TEXTS = ("method", "depth", "fit", "objects")


def poses_table(results: Sequence[PoseResult], protocols: Sequence[PoseProtocol]) -> str:
    """Means over classes in percent, for all objects and for specular and transparent ones."""
    blocks = []
    for split in dict.fromkeys(result.split for result in results):
        mine = [result for result in results if result.split == split]
        for protocol in protocols:
            scored = score_runs(mine, protocol, (ALL, HARD))
            shown = _table(scored, protocol) if scored else "no true object in any frame"
            blocks.append(f"{split}, protocol {protocol.name}, poses right in %\n{shown}")
    return "\n\n".join(blocks)


def _table(scored: Sequence[Scored], protocol: PoseProtocol) -> str:
    lines = [[*_TEXTS, "true", *map(heading, protocol.columns)]]
    for each in scored:
        figures = each.scores.mean
        numbers = [f"{100 * figures[c]:.1f}" for c in protocol.columns]
        lines.append([*each.result.name, each.subset, str(each.objects), *numbers])
    return aligned(lines, texts=len(_TEXTS))


def heading(column: str) -> str:
    """A column as people read it.

    >>> heading("iou25"), heading("10deg5cm")
    ('IoU25', '10°5cm')
    """
    return column.replace("iou", "IoU").replace("deg", "°")
