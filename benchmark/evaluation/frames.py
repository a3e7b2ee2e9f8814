"""Common parts of tasks over the frames of a split: failed frames, fields of a run."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np

from benchmark.data.prediction_files import FrameFiles
from benchmark.data.provenance import Provenance, provenance_of
from benchmark.data.splits import (
    DepthSource,
    FrameKey,
    Inputs,
    inputs_of,
    names_digest,
    open_split,
)
from benchmark.evaluation.batches import (
    Batch,
    chosen_frames,
    describe_frames,
    pieces_left,
    write_rows,
)
from benchmark.evaluation.results import FRAME, INDEX, SCENE
from benchmark.evaluation.task_run import TaskRun
from benchmark.evaluation.values import checked_label, data_of, plain_label
from benchmark.methods.protocol import Restored, Restorer, View
from benchmark.methods.registry import MethodOptions, restorers, weights_digest
from std_toolkit.errors import ToolkitError, is_interrupt
from std_toolkit.jobs.outcome import error_of

if TYPE_CHECKING:
    from benchmark.evaluation.config import FrameConfig

A = TypeVar("A")
T = TypeVar("T")
V = TypeVar("V")
D = TypeVar("D", bound=Any)
M = TypeVar("M")


def error_line(error: Exception) -> str:
    """Return an error as one line."""
    return error_of(error).error or type(error).__name__


def load_each(load: Callable[[int], T], indices: Sequence[int]) -> list[T | str]:
    """Load the frames of a batch; for one that cannot be read, the error as one line."""
    loaded: list[T | str] = []
    for index in indices:
        try:
            loaded.append(load(index))
        except Exception as error:  # a damaged file can raise anything in the libraries below
            loaded.append(error_line(error))
    return loaded


def answers_one_by_one(
    call: Callable[[list[V]], Sequence[A]],
    check: Callable[[V, A], None],
    views: Mapping[int, V],
) -> dict[int, A | str]:
    """Return the outputs of a method by index, or error lines of failed frames.

    If the batch fails as a whole, its frames are tried one by one.

    Args:
        call: runs the method on a batch.
        check: raises an error if an output is invalid.
        views: inputs of the method by index.
    """
    if not views:
        return {}
    try:
        answers = call(list(views.values()))
        if len(answers) != len(views):
            raise ToolkitError(f"the method gave {len(answers)} answers to {len(views)} views")
        for view, answer in zip(views.values(), answers, strict=True):
            check(view, answer)
        return dict(zip(views, answers, strict=True))
    except (KeyboardInterrupt, MemoryError):
        raise
    except Exception as error:
        if is_interrupt(error):
            raise
        if len(views) == 1:
            return {next(iter(views)): error_line(error)}
    found: dict[int, A | str] = {}
    for index, view in views.items():
        alone = answers_one_by_one(call, check, {index: view})
        found |= alone
    return found


def restore_views(restorer: Restorer, views: Mapping[int, View]) -> dict[int, Restored | str]:
    """Return restored depth by index, or error lines; see `answers_one_by_one`."""
    return answers_one_by_one(restorer.restore, check_restored, views)


# Half precision rounds 1 by as much.
_ROUNDING = 1e-3


def check_restored(view: View, answer: Restored) -> None:
    """Refuse an answer of another type or shape, without a single depth, or with odd confidence.

    Raises:
        ToolkitError: what is wrong.
    """
    if not isinstance(answer, Restored):
        raise ToolkitError("the method must give Restored(depth)", value=type(answer).__name__)
    for name, values in (("depth", answer.depth), ("confidence", answer.confidence)):
        if values is not None and getattr(getattr(values, "dtype", None), "kind", "") not in "fiu":
            kind = type(values).__name__
            raise ToolkitError("must be an array of numbers", field=f"Restored.{name}", value=kind)
    if answer.depth.shape != view.depth.shape:
        raise ToolkitError(
            f"the method was given a view of {view.depth.shape}",
            field="Restored.depth",
            value=answer.depth.shape,
        )
    for name, values in (("spread", answer.spread), ("clear", answer.clear)):
        if values is not None and values.shape != view.depth.shape:
            raise ToolkitError(
                f"the method was given a view of {view.depth.shape}",
                field=f"Restored.{name}",
                value=values.shape,
            )
    if answer.depth.size and not np.isfinite(answer.depth).any():
        raise ToolkitError(
            "every pixel of the answer is NaN or infinite",
            field="Restored.depth",
            hint="are the weights those of this network and precision?",
        )
    if (answer.depth < 0).any() and not (answer.depth > 0).any():
        raise ToolkitError(
            "no pixel of the answer is a depth: there are negative ones and none above 0",
            field="Restored.depth",
            hint="depth is in metres along z, 0 for none",
        )
    if answer.confidence is None:
        return
    if answer.confidence.shape != view.depth.shape:
        raise ToolkitError(
            f"the method was given a view of {view.depth.shape}",
            field="Restored.confidence",
            value=answer.confidence.shape,
        )
    low, high = float(np.min(answer.confidence)), float(np.max(answer.confidence))
    if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
        raise ToolkitError(
            "must be in [0, 1]", field="Restored.confidence", value=f"{low:g} to {high:g}"
        )


Base = dict[str, Any]  # first columns of a row: index, scene, frame


class FramesRun(TaskRun[D, M]):
    """A run of a task over frames.

    Attributes:
        batch_size: frames that are passed to the method together.
    """

    batch_size: int

    def chosen(self, data: D) -> Sequence[int]:
        """Return the frames that the run uses."""
        return range(len(data))

    def load(self, data: D, index: int) -> Any:
        """Read the data of a frame.

        Raises:
            ToolkitError: the frame cannot be read.
        """
        raise NotImplementedError

    def rows(self, data: D, methods: M, frames: Sequence[tuple[Base, Any]]) -> list[dict[str, Any]]:
        """Return the table rows of a batch.

        Args:
            data, methods: data and methods of the run.
            frames: for each frame the first columns of its rows, and its data or the error line.
        """
        raise NotImplementedError

    def items(self, data: D, done: set[int], workers: int) -> list[tuple[Batch, ...]]:
        return pieces_left(self.chosen(data), self.batch_size, workers, done)

    def item_title(self, item: Sequence[Batch]) -> str:
        return describe_frames(item)

    def work(self, data: D, methods: M, item: Sequence[Batch]) -> int:
        keys = data.keys()

        def rows_of(batch: Batch, loaded: list[Any]) -> list[dict[str, Any]]:
            bases = [{INDEX: i, SCENE: keys[i].scene, FRAME: keys[i].name} for i in batch]
            return self.rows(data, methods, list(zip(bases, loaded, strict=True)))

        return write_rows(self.folder, item, partial(load_each, partial(self.load, data)), rows_of)


@dataclass(frozen=True, kw_only=True)
class FrameRun(FramesRun[DepthSource, M]):
    """A method on a split.

    Attributes:
        split, root: name of the split and folder of the data.
        method, options: the method; `options.device` is ignored in favour of `devices`.
        label: name of the method in tables.
        out: folder of results.
        limit: number of frames, evenly spaced over the split; None for all.
        gallery: keep pictures of a few frames.
        gallery_frames: names of the frames whose pictures all methods have; empty: evenly spaced.
        needs_nocs: whether the task reads what only poses need.
    """

    needs_nocs: ClassVar[bool] = False
    split: str
    root: Path
    method: str
    options: MethodOptions
    label: str
    out: Path
    devices: tuple[str, ...] = ("cpu",)
    batch_size: int = 8
    limit: int | None = None
    gallery: bool = True
    gallery_frames: tuple[str, ...] = ()

    @property
    def data_key(self) -> object:
        return self.split, self.root

    def open(self) -> DepthSource:
        """Open the data.

        Raises:
            ToolkitError: the data are missing, or no frame has sensor depth and ground truth.
        """
        source = open_split(self.split, self.root)
        if not len(source):
            raise ToolkitError(
                "no frame has sensor depth and ground truth, so nothing can be scored",
                path=self.root,
                field="--data",
                hint=f"`std-restore {shlex.quote(str(self.root))} --out restored` restores depth "
                "without ground truth",
            )
        return source

    def chosen(self, data: DepthSource) -> list[int]:
        return chosen_frames(len(data), self.limit)

    def pictured(self, data: DepthSource) -> list[int]:
        """Return the frames of `gallery_frames`, in their order.

        Raises:
            ToolkitError: the run has no such frame.
        """
        keys = data.keys()
        index = {str(keys[i]): i for i in self.chosen(data)}
        for name in self.gallery_frames:
            if name not in index:
                raise ToolkitError(
                    "the run has no such frame",
                    path=self.root,
                    field="--gallery-frames",
                    value=name,
                    hint=f"SCENE/FRAME as in the tables, such as {next(iter(index))}",
                )
        return [index[name] for name in dict.fromkeys(self.gallery_frames)]

    def inputs(self, data: DepthSource) -> Iterator[tuple[int, FrameKey, Inputs]]:
        """Yield the frames that the run uses, with the files that are read for each."""
        keys, answers = data.keys(), self.answers(data)
        for index in self.chosen(data):
            found = dict(inputs_of(data, index, nocs=self.needs_nocs))
            if answers is not None:
                with suppress(ToolkitError):  # scoring says what is wrong
                    found |= answers.files(keys[index])
            yield index, keys[index], found

    def answers(self, data: DepthSource) -> FrameFiles | None:  # noqa: ARG002
        """Return the folder of predictions that the run reads, if any."""
        return None

    def provenance(self, data: DepthSource) -> Provenance:
        return provenance_of(data, self.split)

    def setup(self, data: DepthSource, method: object) -> dict[str, Any]:
        """Return the fields that determine the table and are common to all methods on frames."""
        keys, chosen = data.keys(), self.chosen(data)
        self.pictured(data)  # a wrong name ends the run before it begins
        return {
            "split": self.split,
            "frames": len(chosen),
            "frames_sha256": names_digest(keys[i] for i in chosen),
            "method": self.method,
            "preset": self.options.preset,
            "settings": dict(self.options.settings),
            "weights_sha256": weights_digest(self.method, method, self.options),
            "precision": self.options.precision,
            "compile": self.options.compile,
            "device": self.devices[0].partition(":")[0],
            "batch_size": self.batch_size,
        }


def _label(method: str, options: MethodOptions) -> str:
    """The name in tables of a method without one of the user's: some tell their settings."""
    name = plain_label(method)
    if method not in restorers.names():
        return name
    end = getattr(restorers.get(method), "label_end", None)
    return name if end is None else f"{name}{end(options.settings)}"


_OF_CONFIG = ("out", "devices", "batch_size", "limit", "gallery", "gallery_frames")


def frame_options(
    config: FrameConfig, split: str, method: str, options: Mapping[str, MethodOptions]
) -> dict[str, Any]:
    """Return the fields of `FrameRun`.

    Raises:
        ToolkitError: a split without data, or a label that cannot be the name of a folder.
    """
    return {
        "split": split,
        "root": data_of(split, config.roots),
        "method": method,
        "options": options[method],
        "label": config.labels.get(method) or checked_label(_label(method, options[method])),
        **{name: getattr(config, name) for name in _OF_CONFIG},
    }
