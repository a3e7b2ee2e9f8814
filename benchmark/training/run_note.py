"""A record of the data and the machine of a training, kept beside the weights."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from benchmark.evaluation.manifest import hardware, package_versions
from benchmark.training.config import CONFIG, TrainConfig
from benchmark.training.packed_frames import PackedFrames
from benchmark.training.run_files import BEST, SCORES, BestScores
from std_toolkit.errors import ToolkitError
from std_toolkit.io.documents import read_document

RUN_NOTE = "run.json"

_SET = "simulation.json"  # what std-sim leaves beside a set


Plain = str | int | float | bool | list[str] | None


class _SetOptions(msgspec.Struct, frozen=True, kw_only=True):
    options: dict[str, Plain] = {}


class PartNote(msgspec.Struct, frozen=True, kw_only=True):
    """Frames of one pack.

    Attributes:
        split: name of the split.
        frames: how many of its frames are meant.
        scenes: their names; those of a simulated set are its seeds.
        size: (width, height) at which they were packed.
        color: how colour was resized.
        simulation: options of the simulated set, empty for other data.
    """

    split: str
    frames: Annotated[int, msgspec.Meta(ge=1)]
    scenes: Annotated[list[str], msgspec.Meta(min_length=1)]
    size: tuple[int, int]
    color: str
    simulation: dict[str, Plain]


class StageNote(msgspec.Struct, frozen=True, kw_only=True):
    """An earlier training, whose weights another began with.

    Attributes:
        sizes: (width, height) of its frames, of each pack.
        frames: how many it trained on.
        steps, batch_size, learning_rate: of its configuration.
        taken: the step after which the weights were taken.
        geometry: whether frames were turned, mirrored and enlarged.
    """

    sizes: list[tuple[int, int]]
    frames: int
    steps: int
    taken: int
    batch_size: int
    learning_rate: float
    geometry: bool


class RunNote(msgspec.Struct, frozen=True, kw_only=True):
    """Circumstances of a training; nothing of it decides what the training ends with.

    Attributes:
        training, validation: frames to train on and to judge by.
        hardware, packages: of the machine where it began.
        earlier: the trainings before it, the first one first, as far as they are known.
    """

    training: Annotated[list[PartNote], msgspec.Meta(min_length=1)]
    validation: list[PartNote]
    hardware: dict[str, str]
    packages: dict[str, str]
    earlier: list[StageNote] = []


def note_of(
    training: PackedFrames,
    of_training: Sequence[int],
    validation: PackedFrames,
    of_validation: Sequence[int],
    weights: Path | None,
) -> RunNote:
    """A note with this machine's circumstances.

    Args:
        training, of_training: packs, and which of their frames are trained on.
        validation, of_validation: likewise, judged by.
        weights: what the training begins with; of a training of its own if that lies beside it.
    """
    return RunNote(
        training=_parts(training, of_training),
        validation=_parts(validation, of_validation),
        hardware=hardware(),
        packages=package_versions(),
        earlier=_stages(weights),
    )


def _stages(weights: Path | None) -> list[StageNote]:
    """The trainings that weights come from; none of weights that lie alone."""
    if weights is None or not (weights.parent / RUN_NOTE).is_file():
        return []
    try:
        note = read_document(weights.parent / RUN_NOTE, RunNote)
        config = read_document(weights.parent / CONFIG, TrainConfig)
        taken = config.steps
        if weights.name == BEST:
            taken = read_document(weights.parent / SCORES, BestScores).step
        stage = StageNote(
            sizes=[part.size for part in note.training],
            frames=sum(part.frames for part in note.training),
            steps=config.steps,
            taken=taken,
            batch_size=config.optimization.batch_size,
            learning_rate=config.optimization.learning_rate,
            geometry=config.geometry,
        )
    except ToolkitError:  # a courtesy, as below
        return []
    return [*note.earlier, stage]


def _parts(frames: PackedFrames, chosen: Sequence[int]) -> list[PartNote]:
    """A note for each pack that chosen frames are of."""
    notes = []
    for number, setup in enumerate(frames.setups):
        mine = [frames.frames[i].scene for i in chosen if frames.frames[i].pack == number]
        if mine:
            notes.append(
                PartNote(
                    split=setup.split,
                    frames=len(mine),
                    scenes=sorted(set(mine)),
                    size=setup.size,
                    color=setup.color,
                    simulation=_simulation(Path(setup.root)),
                )
            )
    return notes


def _simulation(root: Path) -> dict[str, Plain]:
    for folder in (root, *root.parents[:1]):
        if (folder / _SET).is_file():
            try:
                return read_document(folder / _SET, _SetOptions).options
            except ToolkitError:  # the note is a courtesy; the frames themselves were read
                return {}
    return {}
