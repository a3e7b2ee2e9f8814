"""Depth runs whose scenes are aligned as wholes, and restored depth in files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from benchmark.data import splits
from benchmark.data.frame import DepthFrame, resize_nearest
from benchmark.data.predictions import DepthFolder
from benchmark.data.splits import FrameKey
from benchmark.evaluation.batches import Batch, batches_of, read_ahead
from benchmark.evaluation.frames import Base, load_each
from benchmark.evaluation.results import FRAME, INDEX, SCENE, write_part
from benchmark.methods.protocol import Restored, Restorer
from benchmark.metrics.protocols.alignment import Line, PairSums
from benchmark.metrics.protocols.protocol import get_protocol
from benchmark.metrics.protocols.score import pair_sums
from std_toolkit.io.exr import write_exr

Frames = Sequence[tuple[Base, DepthFrame | str]]
Answers = Mapping[int, Restored | str]


class ScoresFrames(Protocol):
    """What `score_clip` asks of a run of the depth task."""

    @property
    def protocol(self) -> str: ...
    @property
    def folder(self) -> Path: ...
    def load(self, data: splits.DepthSource, index: int) -> DepthFrame: ...
    def restored(self, restorer: Restorer, frames: Frames) -> dict[int, Restored | str]: ...
    def keep(self, data: splits.DepthSource, frames: Frames, answers: Answers) -> None: ...
    def scored(
        self, data: splits.DepthSource, methods: Restorer, frames: Frames, answers: Answers,
        line: Line | None = None,
    ) -> list[dict[str, Any]]: ...  # fmt: skip


def clips_left(
    keys: Sequence[FrameKey], frames: Sequence[int], size: int, done: set[int]
) -> list[tuple[Batch, ...]]:
    """Return the batches of each scene that has at least one unfinished frame."""
    scenes: dict[str, list[int]] = {}
    for index in frames:
        scenes.setdefault(keys[index].scene, []).append(index)
    left = [of_scene for of_scene in scenes.values() if not done.issuperset(of_scene)]
    return [tuple(batches_of(of_scene, size)) for of_scene in left]


def score_clip(
    run: ScoresFrames, data: splits.DepthSource, restorer: Restorer, item: Sequence[Batch]
) -> int:
    """Write the rows of a scene; see `TaskRun.work`.

    The scene is gone through twice: for its scale and shift, and to be scored. Only the pixels that
    are compared are kept meanwhile.
    """
    protocol, keys = get_protocol(run.protocol), data.keys()
    kept: dict[int, Restored | str] = {}
    sums = PairSums()

    def batches() -> Iterator[list[tuple[Base, DepthFrame | str]]]:
        for batch, frames in read_ahead(item, partial(load_each, partial(run.load, data))):
            bases = [{INDEX: i, SCENE: keys[i].scene, FRAME: keys[i].name} for i in batch]
            yield list(zip(bases, frames, strict=True))

    for frames in batches():
        answers = run.restored(restorer, frames)
        run.keep(data, frames, answers)
        for base, frame in frames:
            answer = answers.get(base[INDEX], "")
            if isinstance(answer, Restored) and isinstance(frame, DepthFrame):
                sums += pair_sums(answer.depth, frame.depth_true, protocol)
                size = protocol.grids[0].size or frame.camera.size
                answer = Restored(resize_nearest(answer.depth, size))
            kept[base[INDEX]] = answer
    rows = []
    for frames in batches():
        rows += run.scored(data, restorer, frames, kept, sums.line)
    write_part(run.folder, item[0][0], item[-1][-1], rows)
    return sum(map(len, item))


def save_depth(folder: Path, split: str, key: FrameKey, restored: Restored) -> None:
    """Write restored depth in the layout of the sensor depth: FOLDER/depth/SCENE/NAME + suffix.

    The file has the size of the method's output and three equal channels of float32 metres, as in
    the public data sets. Pixels without a prediction are 0.

    Raises:
        ToolkitError: the file cannot be written.
    """
    depth = restored.depth
    channel = depth.astype("float32")
    channel[~(channel > 0) | (channel == float("inf"))] = 0.0
    path = splits.saved_depth_path(folder / "depth", split, key)
    write_exr(path, dict.fromkeys("RGB", channel))


def with_spread(answer: Restored | str, folder: DepthFolder, key: FrameKey) -> Restored | str:
    """Return saved depth with the expected error that lies beside it, if any."""
    if isinstance(answer, str) or (spread := folder.spread(key)) is None:
        return answer
    size = (answer.depth.shape[1], answer.depth.shape[0])
    return replace(answer, spread=resize_nearest(spread, size))
