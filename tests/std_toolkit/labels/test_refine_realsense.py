"""Refinement on sensor depth: a real camera, twenty scanned objects, one frame each."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from depth_picture import off
from realsense_ycb import YcbFrame, depth_residuals_mm, load_frame

from std_toolkit.geometry.se3 import SE3
from std_toolkit.geometry.symmetry import rotation_error
from std_toolkit.labels.refine.depth.icp import DepthFit, refine_on_depth
from std_toolkit.labels.refine.problem import RefineObject

pytestmark = [pytest.mark.real, pytest.mark.slow]

# Starts further off than this show another place, not the object.
LARGEST_START_M = 0.05
SHIFT_MM, TURN_DEG = 5.0, 3.0


@dataclass(frozen=True)
class Row:
    """One object from its initial reference pose: errors are against the refined reference.

    Seconds are those of the processor: a busy machine does not change them.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    reference_mm: float
    ours_mm: float
    seconds: float
    fit: DepthFit

    @property
    def passes(self) -> bool:
        near = self.end[0] < SHIFT_MM and self.end[1] < TURN_DEG
        return near or self.ours_mm < self.reference_mm

    def __str__(self) -> str:
        return (
            f"{self.name:<23}{self.start[0]:>7.1f}{self.start[1]:>6.1f}"
            f"{self.end[0]:>8.1f}{self.end[1]:>6.1f}{self.reference_mm:>9.2f}{self.ours_mm:>7.2f}"
            f"{100 * self.fit.depth.explained:>8.0f}{self.seconds:>7.2f}"
            f"  {'yes' if self.passes else 'NO'}"
        )


HEAD = (
    f"{'object':<23}{'start mm':>8}{'deg':>5}{'end mm':>8}{'deg':>6}{'ref mm':>9}{'ours':>7}"
    f"{'expl %':>8}{'cpu s':>7}  passes"
)


@pytest.fixture(scope="module")
def frames(test_data: Path) -> list[YcbFrame]:
    return [load_frame(test_data, i) for i in range(4)]


def difference(a: SE3, b: SE3, thing: RefineObject) -> tuple[float, float]:
    """Millimetres between the centres and degrees, symmetry aware."""
    shift = 1000 * float(np.linalg.norm(a @ thing.centre - b @ thing.centre))
    return shift, float(np.rad2deg(rotation_error(a, b, thing.symmetry)))


def refined_row(frame: YcbFrame, index: int) -> Row:
    thing, initial = frame.objects[index], frame.initial[index]
    start = time.process_time()
    fit = refine_on_depth([frame.view], replace(thing, T_world_obj=initial))
    seconds = time.process_time() - start
    reference, ours = depth_residuals_mm(frame, index, [thing.T_world_obj, fit.T_world_obj])
    return Row(
        thing.name,
        difference(initial, thing.T_world_obj, thing),
        difference(fit.T_world_obj, thing.T_world_obj, thing),
        reference,
        ours,
        seconds,
        fit,
    )


def test_initial_poses_are_brought_into_place(frames: list[YcbFrame]) -> None:
    """No neighbour is given, as in a first annotation.

    The references are rough themselves (contours off by up to 25 px, residuals of 4 to 15 mm where
    2 to 7 mm can be had), so nearly every object passes by its residual, not by being near them.
    """
    rows = [refined_row(f, k) for f in frames for k in range(len(f.objects))]
    starts = [
        float(np.linalg.norm(o.T_world_obj.t - T.t))
        for f in frames
        for o, T in zip(f.objects, f.initial, strict=True)
    ]
    inside = [row for row, start in zip(rows, starts, strict=True) if start < LARGEST_START_M]
    text = "\n".join([HEAD, *map(str, rows)])
    print(f"\n{text}\n{sum(r.passes for r in inside)} of {len(inside)} within 5 cm pass")
    assert len(inside) == 16
    assert sum(r.passes for r in inside) >= 0.9 * len(inside), text
    ratios = [r.ours_mm / r.reference_mm for r in inside]
    assert np.median(ratios) < 0.75, text
    assert all(r.fit.converged for r in inside), text
    assert np.median([r.seconds for r in rows]) < 3.0, text


@pytest.mark.parametrize(
    "index",
    [0, 2, pytest.param(1, marks=pytest.mark.long), pytest.param(3, marks=pytest.mark.long)],
)
def test_rough_starts_end_at_one_pose(frames: list[YcbFrame], index: int) -> None:
    """From 50 mm and 30 degrees off, objects come back to where a near start leads.

    The large marker is left out: nobody has a pose of it that fits.
    """
    frame = frames[index]
    ends = {}
    for k, thing in enumerate(frame.objects):
        if thing.name == "040_large_marker":
            continue
        settled = refine_on_depth([frame.view], replace(thing, T_world_obj=frame.initial[k]))
        for seed in range(2):
            rough = off(settled.T_world_obj, thing.centre, 0.05, 30, seed)
            again = refine_on_depth([frame.view], replace(thing, T_world_obj=rough))
            ends[thing.name, seed] = difference(again.T_world_obj, settled.T_world_obj, thing)
    back = [shift < 5 and turn < 5 for shift, turn in ends.values()]
    assert np.mean(back) >= 0.8, ends
    assert np.median([shift for shift, _ in ends.values()]) < 1.5, ends
