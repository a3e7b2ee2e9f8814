"""Score methods: what `std-bench` and Python have in common, and `evaluate`."""

import importlib
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import pandas as pd

from benchmark.evaluation.config import (
    BopConfig,
    DepthConfig,
    FrameConfig,
    NetworkConfig,
    PoseConfig,
)
from benchmark.evaluation.engine import Campaign, run_all
from benchmark.evaluation.task_run import Task
from benchmark.evaluation.values import OBJECT, checked_label
from benchmark.methods.registry import METHODS
from std_toolkit.errors import ToolkitError
from std_toolkit.jobs import JobOptions


@dataclass(frozen=True)
class Scored:
    """Outcome of `score_config`.

    Attributes:
        task: the task of `config`.
        campaign: which runs have results, and the errors of the others.
        results: results of the finished runs, in the order of the plan.
    """

    config: NetworkConfig | BopConfig
    task: Task
    campaign: Campaign[Any]
    results: Sequence[Any]

    @property
    def records(self) -> Sequence[Any]:
        """Figures of the table, in SI units and fractions."""
        return self.task.records(self.results, self.config) if self.results else []

    @property
    def table(self) -> str:
        """The table for a terminal."""
        return self.task.table(self.results, self.config) if self.results else ""


def score_config(config: NetworkConfig | BopConfig) -> Scored:
    """Run what a configuration asks for and that has no results yet; read all results.

    Raises:
        ToolkitError: data are missing; what fails later is in `Scored.campaign`.
    """
    with ExitStack() as stack:
        if config.out is None:  # only the figures are wanted
            config = replace(config, out=Path(stack.enter_context(TemporaryDirectory())))
        task = importlib.import_module(f"benchmark.evaluation.tasks.{config.task}").TASK
        campaign = run_all(task.plan(config), config.jobs)
        return Scored(config, task, campaign, [run.read() for run in campaign.finished])


_CONFIGS: dict[str, type[FrameConfig]] = {"depth": DepthConfig, "pose": PoseConfig}


def evaluate(
    methods: object,
    split: str | Sequence[str],
    protocol: str | Sequence[str] = "strict",
    *,
    data: str | Path | Mapping[str, str | Path],
    task: Literal["depth", "pose"] = "depth",
    out: str | Path | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Score every method on every split by every protocol, as `std-bench` does.

    A frame at which a method fails counts as missing everywhere, and is logged. Work runs in other
    processes: a script calls it under `if __name__ == "__main__":`, or gives
    `jobs=JobOptions(engine="serial")`.

    Args:
        methods: one, or a sequence, of: a name of `std-bench list methods`; `file.py:Class` or
            `package.module:Class`; a class or function that takes `MethodOptions`; or an object
            that restores depth (task `pose`: that estimates poses). A mapping gives objects and
            classes names; without one they have their class's. They run in this process and,
            since their contents are not known, never resume earlier results.
        split: names of `std-bench list splits`; `scenes` for your own scenes.
        protocol: names or locations of protocols.
        data: folder above the data sets, or of one split; or such a folder by split.
        task: whose methods they are.
        out: folder of results, as that of `std-bench`: what it has is kept, and `std-report` and
            `read_results` read it. Without it nothing is kept, and neither speed nor pictures are
            made.
        **options: other options of `std-bench`, by the names of the fields of `DepthConfig` or
            `PoseConfig` in `benchmark.evaluation.config`: `limit=100`, `devices=("cuda:0",)`,
            `weights={"nlspn": "nlspn.safetensors"}`, `settings={"fusion": "confidence"}`.

    Returns:
        The figures of `std-bench --json`, a row for each method, split, protocol and subset of
        objects: means over images, errors in metres, shares from 0 to 1.

    Raises:
        ToolkitError: an option or method is wrong, data are missing, or a run failed. Runs that
            were finished before are kept in `out`.

    Examples:
        Errors of two methods on your own scenes, and of one of your own; see examples/06 to 08:

            table = evaluate(["raw", "nearest", MyRestorer], "scenes", data="scenes/")
            table.pivot(index="method", columns="subset", values="mae")
    """
    if task not in _CONFIGS:
        raise ToolkitError(f"expected one of {', '.join(_CONFIGS)}", field="task", value=task)
    config_type, registry = _CONFIGS[task], METHODS[task]
    known = {field.name for field in fields(config_type)} - {"methods", "splits", "protocols"}
    if wrong := [name for name in options if name not in known]:
        raise ToolkitError(
            "is no option of evaluate", field=wrong[0], hint=f"options: {', '.join(sorted(known))}"
        )
    names, objects = _named(methods, registry.called)
    if out is None:
        options = {"gallery": False, **({"speed": False} if task == "depth" else {}), **options}
    if objects:  # other processes do not have them
        options["jobs"] = replace(options.get("jobs", JobOptions()), engine="serial")
    for name, separator in (("weights", "="), ("settings", "="), ("label", "=")):
        options[name] = _words(options.get(name, ()), separator)
    with ExitStack() as stack:
        stack.enter_context(registry.holding(objects))
        place = stack.enter_context(TemporaryDirectory()) if out is None else out
        scored = score_config(
            config_type(
                methods=tuple(names),
                splits=_tuple(split),
                protocols=_tuple(protocol),
                data=_words(data, "="),
                out=Path(place),
                **options,
            )
        )
    for title, error in scored.campaign.failed.items():
        raise ToolkitError(
            f"could not be scored: {error}",
            field="methods",
            value=title,
            hint=None if out is None else f"the results of the others are in {out}",
        )
    return pd.DataFrame(scored.records)


def _tuple(values: str | Sequence[str]) -> tuple[str, ...]:
    return (values,) if isinstance(values, str) else tuple(values)


def _words(values: Any, separator: str) -> tuple[str, ...]:
    """Values as the command line has them: one, several, or by name."""
    if isinstance(values, Mapping):
        return tuple(f"{name}{separator}{value}" for name, value in values.items())
    return (str(values),) if isinstance(values, str | Path) else tuple(map(str, values))


def _named(methods: object, verb: str) -> tuple[list[str], dict[str, Callable[[Any], Any]]]:
    """Names of all methods, and the factories of those that are objects by their names.

    Raises:
        ToolkitError: something that is no method, or a name that cannot be that of a folder.
    """
    if isinstance(methods, Mapping):
        given = list(methods.items())
        if named := [name for name, method in given if isinstance(method, str)]:
            raise ToolkitError(
                "only objects and classes can be given a name", field="methods", value=named[0]
            )
    else:
        each = methods if isinstance(methods, list | tuple) else [methods]
        given = [(None, method) for method in each]
    names: list[str] = []
    labels: list[str] = []
    objects: dict[str, Callable[[Any], Any]] = {}
    for label, method in given:
        if isinstance(method, str):
            names.append(method)
            continue
        is_object = not isinstance(method, type) and hasattr(method, verb)
        if not is_object and not callable(method):
            raise ToolkitError(
                f"is no method: it has no {verb}()", field="methods", value=type(method).__name__
            )
        label = label or getattr(method, "__name__", type(method).__name__)
        if label in labels:
            raise ToolkitError(
                "two methods have this name", field="methods", value=label,
                hint='give them others: {"one": ..., "two": ...}',
            )  # fmt: skip
        labels.append(label)
        # Another name each time: results of an object that is not the same are not resumed.
        name = f"{OBJECT}{checked_label(label)}:{uuid.uuid4().hex[:12]}"
        objects[name] = _giver(method) if is_object else method
        names.append(name)
    return names, objects


def _giver(method: object) -> Callable[[object], object]:
    return lambda _options: method
