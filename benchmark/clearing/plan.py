"""From what a user types to the runs of table clearing that it means."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path

from benchmark.clearing.round import MOST_ATTEMPTS
from benchmark.clearing.run import ORACLE, RAW, TRUE, GraspRun
from benchmark.clearing.sensing import CAMERAS
from benchmark.grasp_methods.registry import grasp_planners
from benchmark.methods.registry import MethodOptions
from benchmark.running.plan import (
    check_lists,
    checked_label,
    options_by_method,
)
from std_toolkit.errors import ToolkitError


@dataclass(frozen=True, kw_only=True)
class GraspWishes:
    """What a user asks for; every planner works on every depth, all on the same rounds.

    Attributes:
        depths: `raw`, `gt`, or restorers.
        planners: registered ones, or `oracle`.
        rounds, seed, camera, attempts, strips, devices, out: as in `GraspRun`.
        preset, precision, compile: of networks; see `preset_for`.
        weights: `NAME=FILE`, of planners and restorers; `FILE` where there is one of them.
        settings: `NAME.SETTING=VALUE`, likewise.
    """

    depths: tuple[str, ...]
    planners: tuple[str, ...]
    rounds: int
    seed: int
    out: Path
    camera: str = "quick"
    attempts: int = MOST_ATTEMPTS
    preset: str | None = None
    precision: str = "fp32"
    compile: bool = False
    weights: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    devices: tuple[str, ...] = ("cpu",)
    strips: bool = True

    def __post_init__(self) -> None:
        check_lists(self, "depths", "planners", "devices")
        for name, low in (("rounds", 1), ("attempts", 1), ("seed", 0)):
            if getattr(self, name) < low:
                raise ToolkitError(f"must be at least {low}", field=name, value=getattr(self, name))
        if self.camera not in CAMERAS:
            raise ToolkitError(
                "no such camera", field="camera", value=self.camera, hint=", ".join(CAMERAS)
            )


def plan_grasp_runs(wishes: GraspWishes) -> list[GraspRun]:
    """The runs, planner by planner.

    Raises:
        ToolkitError: weights or settings for what is not asked for, or a label that cannot be a
            folder's name.
    """
    for name in wishes.planners:
        if name != ORACLE and ":" not in name and name not in grasp_planners.names():
            raise ToolkitError(
                "no such planner",
                field="--planner",
                value=name,
                hint=f"known: {', '.join([*grasp_planners.names(), ORACLE])}",
            )
    names = [
        *(d for d in wishes.depths if d not in (RAW, TRUE)),
        *(p for p in wishes.planners if p != ORACLE),
    ]
    options = options_by_method(wishes, names)
    for name in (*wishes.depths, *wishes.planners):
        checked_label(name.replace(":", "."))
    return [
        GraspRun(
            depth=depth,
            planner=planner,
            rounds=wishes.rounds,
            seed=wishes.seed,
            out=wishes.out,
            depth_options=options.get(depth, MethodOptions()),
            planner_options=options.get(planner, MethodOptions()),
            camera=wishes.camera,  # type: ignore[arg-type]
            attempts=wishes.attempts,
            devices=wishes.devices,
            strips=wishes.strips,
        )
        for planner, depth in product(wishes.planners, wishes.depths)
    ]
