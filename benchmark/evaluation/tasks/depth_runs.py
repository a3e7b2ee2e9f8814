"""Depth runs from the options of a user, carried out one after the other.

From what a user types to the runs that it means.
"""

from __future__ import annotations

import multiprocessing
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Protocol

from benchmark.evaluation.engine import UnusableMethod
from benchmark.evaluation.manifest import hardware
from benchmark.evaluation.results import report_failures
from benchmark.evaluation.tasks.depth import Run, chosen_frames, frame_view, run_method, source_of
from benchmark.evaluation.tasks.depth_pictures import FOLDER, INDEX_FILE, make_gallery
from benchmark.evaluation.tasks.depth_results import SPEED, Speed, measure_speed
from benchmark.methods.registry import MethodOptions, make_restorer, preset_for
from benchmark.metrics.protocols.protocol import get_protocol
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import write_document
from std_toolkit.jobs import JobOptions

_LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*")

_LONGEST_LABEL = 120  # file systems stop at 255 bytes


@dataclass(frozen=True, kw_only=True)
class DepthConfig:
    """What a user asks for; every method is scored on every split by every protocol.

    Attributes:
        methods, splits, protocols: names.
        data: folders; `SPLIT=ROOT` is for one split, `ROOT` for all others.
        out: folder of results.
        preset, precision, compile: of networks; see `preset_for`.
        weights: `METHOD=FILE`, or `FILE` where there is one method.
        settings: `METHOD.NAME=VALUE`, or `NAME=VALUE` where there is one method.
        label: name in tables, where there is one method.
        devices, batch_size, limit, save_depth, depth_from: as in `Run`.
    """

    methods: tuple[str, ...]
    splits: tuple[str, ...]
    protocols: tuple[str, ...] = ("strict",)
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
    save_depth: bool = False
    depth_from: Path | None = None
    roots: dict[str | None, Path] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_lists(self, "methods", "splits", "protocols", "data", "devices")
        check_counts(self, "batch_size", "limit")
        if self.label is not None and len(self.methods) > 1:
            raise ToolkitError("names one method, not several", field="label", value=self.label)
        object.__setattr__(self, "roots", roots_of(self.data))


def plan_runs(config: DepthConfig) -> list[Run]:
    """The runs, method by method so that each network is loaded once.

    Raises:
        ToolkitError: weights or settings for a method that is not asked for, a split without
            data, or a label that cannot be a folder's name.
    """
    options = options_by_method(config, config.methods)
    return [
        Run(
            split=split,
            root=data_of(split, config.roots),
            method=method,
            options=options[method],
            protocol=protocol,
            label=checked_label(config.label or method.replace(":", ".")),
            out=config.out,
            devices=config.devices,
            batch_size=config.batch_size,
            limit=config.limit,
            save_depth=config.save_depth,
            depth_from=config.depth_from,
        )
        for method, split, protocol in product(config.methods, config.splits, config.protocols)
    ]


class NetworkConfig(Protocol):
    """What every task is asked about networks; see `Wishes`."""

    @property
    def preset(self) -> str | None: ...
    @property
    def precision(self) -> str: ...
    @property
    def compile(self) -> bool: ...
    @property
    def weights(self) -> tuple[str, ...]: ...
    @property
    def settings(self) -> tuple[str, ...]: ...


def options_by_method(config: NetworkConfig, methods: Sequence[str]) -> dict[str, MethodOptions]:
    """Options of each method, by its name.

    Raises:
        ToolkitError: weights or settings for a method that is not asked for.
    """
    weights = weights_by_method(config.weights, methods)
    settings = settings_by_method(config.settings, methods)
    return {
        method: MethodOptions(
            preset=preset_for(method, config.preset, weights.get(method)),
            weights=weights.get(method),
            precision=config.precision,  # type: ignore[arg-type]
            compile=config.compile,
            settings=settings[method],
        )
        for method in methods
    }


def check_lists(config: object, *names: str) -> None:
    """Refuse lists that are empty, or tell something twice.

    Raises:
        ToolkitError: the field, and what is told twice.
    """
    for name in names:
        values = getattr(config, name)
        if not values:
            raise ToolkitError("needs at least one value", field=name)
        if twice := [v for v in values if values.count(v) > 1]:
            raise ToolkitError("is given twice", field=name, value=twice[0])


def check_counts(config: object, *names: str) -> None:
    """Refuse numbers below 1; None is none.

    Raises:
        ToolkitError: the field and its value.
    """
    for name in names:
        value = getattr(config, name)
        if value is not None and value < 1:
            raise ToolkitError("must be at least 1", field=name, value=value)


def roots_of(texts: Sequence[str]) -> dict[str | None, Path]:
    """Folders of data by split; None for those that are not told otherwise.

    Args:
        texts: `SPLIT=ROOT`, or `ROOT`.
    """
    found: dict[str | None, Path] = {}
    for text in texts:
        split, equals, root = text.partition("=")
        # A folder's own name may hold "=".
        named = bool(equals) and not Path(text).exists()
        found[split if named else None] = Path(root if named else text)
    return found


def data_of(split: str, roots: Mapping[str | None, Path]) -> Path:
    """The folder of a split's data.

    Raises:
        ToolkitError: there is none for it.
    """
    root = roots.get(split, roots.get(None))
    if root is None:
        raise ToolkitError("no data for this split", field="data", value=split, hint="give ROOT")
    return root


def weights_by_method(texts: Sequence[str], methods: Sequence[str]) -> dict[str, Path]:
    """Files of weights by the method that they are for.

    Args:
        texts: `METHOD=FILE`, or `FILE` where there is one method.
        methods: that there are.

    Raises:
        ToolkitError: weights for none of them.
    """
    return {m: Path(text) for m, text in _by_method(texts, methods, "weights", "=")}


def settings_by_method(texts: Sequence[str], methods: Sequence[str]) -> dict[str, dict[str, str]]:
    """Settings by the method that they are for, each of `methods` having some or none.

    Args:
        texts: `METHOD.NAME=VALUE`, or `NAME=VALUE` where there is one method.
        methods: that there are.

    Raises:
        ToolkitError: a setting for none of them, or one without a value.
    """
    settings: dict[str, dict[str, str]] = {method: {} for method in methods}
    for method, text in _by_method(texts, methods, "settings", "."):
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise ToolkitError("expected NAME=VALUE", field="settings", value=text)
        settings[method][name] = value
    return settings


def _by_method(
    texts: Sequence[str], methods: Sequence[str], field_name: str, separator: str
) -> list[tuple[str, str]]:
    """Pairs of a method and what is told of it."""
    found = []
    for text in texts:
        method = next((m for m in methods if text.startswith(m + separator)), None)
        if method is not None:
            found.append((method, text.removeprefix(method + separator)))
        elif len(methods) == 1:
            found.append((methods[0], text))
        else:
            raise ToolkitError(
                "does not say which method it is for",
                field=field_name,
                value=text,
                hint=f"METHOD{separator}..., with one of {', '.join(methods)}",
            )
    return found


def checked_label(text: str) -> str:
    """A name of a method in tables and folders.

    Raises:
        ToolkitError: it cannot be a folder's name.
    """
    if len(text) > _LONGEST_LABEL:
        raise ToolkitError(
            f"must have at most {_LONGEST_LABEL} characters",
            field="label",
            value=f"{text[:40]}...",
        )
    if not _LABEL.fullmatch(text):
        raise ToolkitError(
            "must be usable as a folder's name",
            field="label",
            value=text,
            hint="letters, digits and . _ + -",
        )
    return text


@dataclass
class CampaignReport:
    """What became of the runs.

    Attributes:
        finished: the runs that have a table.
        failed: an error line for each of the others.
        failed_frames: frames without a score, over all runs.
    """

    finished: list[Run] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    failed_frames: int = 0


def run_all(
    runs: Sequence[Run],
    jobs: JobOptions | None = None,
    *,
    speed: bool = True,
    gallery: bool = True,
) -> CampaignReport:
    """Run everything; see `run_method`.

    Args:
        runs: in the order that they are to run in.
        jobs: where the work runs.
        speed: also time each method.
        gallery: also keep pictures of a few frames.

    Raises:
        ToolkitError: a split's data are not there, or no such protocol; nothing has run then.
    """
    for run in {(r.split, r.root): r for r in runs}.values():
        source_of(run)  # before anything runs: data that are not there are told once
    for protocol in {run.protocol for run in runs}:
        get_protocol(protocol)
    report = CampaignReport()
    unusable: set[tuple[str, str]] = set()
    for run in runs:
        if (run.method, run.label) in unusable:
            continue
        try:
            table = run_method(run, jobs)
            report.failed_frames += report_failures(table, run.title, run.folder)
            if speed and not (run.folder / SPEED).exists():
                write_document(run.folder / SPEED, speed_of(run))
            if gallery and not (run.folder / FOLDER / INDEX_FILE).exists():
                make_gallery(run)
        except UnusableMethod as error:
            unusable.add((run.method, run.label))
            report.failed[run.label] = str(error)
        except ToolkitError as error:
            report.failed[run.title] = str(error)
        else:
            report.finished.append(run)
    return report


def speed_of(run: Run) -> Speed:
    """Time the method on a frame of the run, in a process of its own, whose memory is its own.

    Raises:
        ToolkitError: no frame can be read, or the method fails on it.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            return pool.submit(_speed_here, run).result()
        except BrokenProcessPool as error:
            raise ToolkitError(
                "the process that times the method died (killed, or out of memory)",
                value=run.title,
                hint="--no-speed leaves the timing out",
            ) from error


def _speed_here(run: Run) -> Speed:
    source = source_of(run)
    restorer = make_restorer(run.method, replace(run.options, device=run.devices[0]))
    protocol = get_protocol(run.protocol)
    index = chosen_frames(len(source), 1)[0]
    view = frame_view(source.load(index), restorer, protocol)
    where = hardware()
    on_gpu = run.devices[0].startswith("cuda")
    return measure_speed(restorer, [view], hardware=where["gpus" if on_gpu else "processor"])
