"""From what a user types to the runs of poses that it means."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from benchmark.methods.registry import MethodOptions, restorers
from benchmark.pose_methods.fitting import FitMethod
from benchmark.pose_running.depths import RAW, TRUE, DepthChoice
from benchmark.pose_running.run import PoseRun
from benchmark.running.plan import (
    check_counts,
    check_lists,
    checked_label,
    data_of,
    options_by_method,
    roots_of,
)
from std_toolkit.errors import ToolkitError

FITS = tuple(fit.value for fit in FitMethod)


@dataclass(frozen=True, kw_only=True)
class PoseWishes:
    """What a user asks for; every method runs on every split with every depth and fit.

    Attributes:
        methods, splits: names.
        depths: `raw`, `gt`, restorers, or `NAME=FOLDER` of depth that was saved.
        fits: `ransac`, `paper`.
        as_input: networks look at that depth, too.
        data: folders; `SPLIT=ROOT` is for one split, `ROOT` for all others.
        out: folder of results.
        preset, precision, compile: of networks; see `preset_for`.
        weights: `METHOD=FILE`, of pose methods and restorers; `FILE` where there is one of them.
        settings: `METHOD.NAME=VALUE`, likewise.
        label: name in tables, where there is one method.
        devices, batch_size, limit: as in `PoseRun`.
    """

    methods: tuple[str, ...]
    splits: tuple[str, ...]
    depths: tuple[str, ...] = (RAW,)
    fits: tuple[str, ...] = ("ransac",)
    as_input: bool = False
    data: tuple[str, ...]
    out: Path
    preset: str | None = None
    precision: str = "fp32"
    compile: bool = False
    weights: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    label: str | None = None
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 8
    limit: int | None = None
    roots: dict[str | None, Path] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_lists(self, "methods", "splits", "depths", "fits", "data", "devices")
        check_counts(self, "batch_size", "limit")
        if strange := [fit for fit in self.fits if fit not in FITS]:
            raise ToolkitError("no such fit", field="fit", value=strange[0], hint=", ".join(FITS))
        if self.label is not None and len(self.methods) > 1:
            raise ToolkitError("names one method, not several", field="label", value=self.label)
        object.__setattr__(self, "roots", roots_of(self.data))


def plan_pose_runs(wishes: PoseWishes) -> list[PoseRun]:
    """The runs, method by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for what is not asked for, a split without data, a depth
            that nobody knows, or a label that cannot be a folder's name.
    """
    depths = [_depth(text) for text in wishes.depths]
    restored = [depth.name for depth in depths if depth.is_restored]
    names = [*wishes.methods, *restored]
    options = options_by_method(wishes, names)
    chosen = [
        DepthChoice(
            name=depth.name,
            options=options[depth.name] if depth.is_restored else MethodOptions(),
            folder=depth.folder,
        )
        for depth in depths
    ]
    for depth in chosen:
        checked_label(depth.label)
    return [
        PoseRun(
            split=split,
            root=data_of(split, wishes.roots),
            method=method,
            options=options[method],
            depth=depth,
            label=checked_label(wishes.label or method.replace(":", ".")),
            out=wishes.out,
            fit=fit,
            # Of raw depth nothing would change but the name.
            as_input=wishes.as_input and depth.name != RAW,
            devices=wishes.devices,
            batch_size=wishes.batch_size,
            limit=wishes.limit,
        )
        for method, split, depth, fit in product(wishes.methods, wishes.splits, chosen, wishes.fits)
    ]


def _depth(text: str) -> DepthChoice:
    name, equals, folder = text.partition("=")
    if equals:
        if name in (RAW, TRUE, *restorers.names()) or not name:
            raise ToolkitError(
                "depth in a folder needs a name of its own", field="depth", value=text
            )
        return DepthChoice(name=name, folder=Path(folder))
    return DepthChoice(name=text)
