"""The results of table clearing as the paper's table, in the terminal and as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmark.clearing.precision import PRECISION
from benchmark.clearing.rates import Rate
from benchmark.clearing.results import GraspResult
from benchmark.running.aligned import aligned

HEADINGS = (
    "planner", "depth", "rounds", "grasped / attempts", "success % per attempt", "per table",
    "removed / objects", "completion % per object", "per table", "tables cleared %",
    "transparent %", "specular %",
)  # fmt: skip


PLAN_HEADINGS = (
    "planner", "depth", "views", "grasps of a view", "AP %", "AP0.8 %", "AP0.4 %",
)  # fmt: skip


def grasp_table(results: Sequence[GraspResult]) -> str:
    """One line per run, of what was cleared and of what was planned; intervals of 95 % in
    brackets."""
    blocks = []
    for camera, seed in dict.fromkeys(r.name[:2] for r in results):
        mine = [r for r in results if r.name[:2] == (camera, seed)]
        cleared = aligned([list(HEADINGS), *(cells(r) for r in mine)])
        planned = aligned([list(PLAN_HEADINGS), *(plan_cells(r) for r in mine)])
        blocks.append(f"table clearing, {camera} camera, seed {seed}\n{cleared}")
        blocks.append(f"grasps planned on the first view of each table\n{planned}")
    return "\n\n".join(blocks)


def cells(result: GraspResult) -> list[str]:
    """The texts of a run's line, in the order of `HEADINGS`."""
    r = result.rates
    removed = r.grasped + r.lost
    lost = f" ({r.lost} off)" if r.lost else ""
    return [
        result.manifest.planner_label,
        result.manifest.depth_label,
        str(r.rounds),
        f"{int(r.success_attempts.count)} / {r.attempts}",
        share(r.success_attempts),
        share(r.success_tables),
        f"{removed} / {r.objects}{lost}",
        share(r.completion_objects),
        share(r.completion_tables),
        share(r.cleared),
        share(r.completion_of.get("transparent")),
        share(r.completion_of.get("specular")),
    ]


def plan_cells(result: GraspResult) -> list[str]:
    """The texts of a run's line, in the order of `PLAN_HEADINGS`."""
    r = result.rates
    return [
        result.manifest.planner_label,
        result.manifest.depth_label,
        str(r.precision["ap"].total),
        f"{r.planned:.1f}",
        *(share(r.precision[name]) for name in PRECISION),
    ]


def share(rate: Rate | None) -> str:
    """A rate in percent, with its interval where there is one.

    >>> share(Rate(0.5, 0.25, 0.75, 3, 6)), share(None)
    ('50.0 [25.0, 75.0]', '-')
    """
    if rate is None or math.isnan(rate.value):
        return "-"
    if math.isnan(rate.low):
        return f"{100 * rate.value:.1f}"
    return f"{100 * rate.value:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
