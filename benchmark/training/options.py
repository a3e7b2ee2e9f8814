"""Options of training and packing; they import nothing heavy.

The command line is made from these dataclasses; see `std_toolkit.cli.command_options`.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import msgspec

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions, Seed

Count = Annotated[int, msgspec.Meta(ge=1)]
Pixels = Annotated[int, msgspec.Meta(ge=1, le=16_384)]
# Seeds of the scenes that are scored begin 60,000 after those of the others.
Scenes = Annotated[int, msgspec.Meta(ge=1, le=29_999)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Size = Annotated[
    str,
    msgspec.Meta(pattern=r"^[1-9]\d{1,3}x[1-9]\d{1,3}$", description="WIDTHxHEIGHT, as 224x126"),
]
Precision = Literal["fp32", "bf16"]
BatchNormStatistics = Literal["running", "recomputed"]
DepthKind = Literal["float32", "float16"]
ColorWay = Literal["cubic", "area", "nearest"]
RawKind = Literal["sensor", "cut"]

_NO_OPTION = {"option": None}


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """A training; what is not given is as published for the method, or follows from the rest."""

    method: str = field(metadata={"option": "method"})
    """swindrnet, nlspn, lidf, cleargrasp, dfnet, ..., or package.module:TRAINABLE"""
    data: tuple[Path, ...] = field(metadata={"option": "data"})
    """packed frames to train on"""
    validation: tuple[Path, ...] = ()
    """packed frames that choose the best weights (scenes of --data are held out)"""
    hold_out: float = 0.1
    """share of the scenes of --data that are held out"""
    share: float = 1.0
    """share of the other scenes that are trained on"""
    preset: str = "compact"
    """network size: published or compact"""
    settings: Mapping[str, str] = field(default_factory=dict, metadata={"option": "set"})
    """settings of the network"""
    weights: Path | None = None
    """file of weights to start from, of the same network or of one that it may start from"""
    imagenet: Path | None = None
    """file of a classifier's weights that initialise the backbone"""
    steps: Count | None = None
    """optimizer steps"""
    epochs: Count | None = None
    """how often every frame is seen, where --steps is not given"""
    phases: Mapping[str, int] = field(default_factory=dict)
    """steps of each phase of a method that has several; phases that are not named are left out"""
    batch_size: Count | None = None
    """frames of a step, over all devices and accumulated parts"""
    accumulate: Count = 1
    """gradient accumulation steps"""
    optimizer: Literal["adam", "adamw", "sgd"] | None = None
    """optimizer"""
    learning_rate: Positive | None = None
    """learning rate at its highest"""
    weight_decay: Annotated[float, msgspec.Meta(ge=0)] | None = None
    """weight decay"""
    decay: Literal["linear", "steps"] | None = None
    """how the learning rate falls"""
    loss: Mapping[str, str] = field(default_factory=dict)
    """changes to the method's loss, such as form=released"""
    colors: Literal["published", "on", "jitter", "off"] = "published"
    """colour augmentation: SwinDRNet's (on), NLSPN's (jitter)"""
    geometry: Literal["published", "on", "off"] = "published"
    """turn, mirror and enlarge frames"""
    object_dropout: Share = 0.0
    """object-depth dropout: share of the frames in which some objects have no depth, that of the
    background, or the true one"""
    copy_paste: Share = 0.0
    """copy-paste augmentation: share of the frames into which objects of another frame of the batch
    are pasted"""
    clear_gone: Share = 0.0
    """share of the glass and metal objects without any sensor depth"""
    clear_behind: Share = 0.0
    """share of the glass and metal objects in whose place the sensor sees what is behind, whole, as
    if they were not there (the others keep what the sensor has)"""
    holes: Share = 0.0
    """share of the frames with holes anywhere: ellipses, a band at the border, depth out of range,
    shadows of a second camera, dark and glossy places, patches, outlines of other objects"""
    wrong_color: Share = 0.0
    """share of the frames with noise or another frame's colour, to be answered by what was measured
    and its smooth continuation"""
    depth_noise: Share = 0.0
    """share of the frames whose sensor depth has more noise, of pixels and of patches, up to 3 mm
    at 1 m, growing with the square of the distance"""
    patterns: Share = 0.0
    """share of the frames whose background has a pattern of colour, seen through glass, too"""
    sizes: tuple[Size, ...] = ()
    """sizes such as 224x126: each step draws one, and a part of the frames of its proportions"""
    batch_norm: BatchNormStatistics = "running"
    """batch-norm statistics of validated and saved weights: running means over the last batches, as
    published, or recomputed over 400 frames before each validation"""
    precision: Precision = "fp32"
    """arithmetic of the network"""
    seed: Seed = 0
    """of weights, order, augmentation and dropout"""
    validate_every: Count | None = None
    """steps between validations"""
    checkpoint_every: Count | None = None
    """steps between checkpoints"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.clear_gone + self.clear_behind > 1:
            raise ToolkitError(
                "and --clear-behind are shares of the same objects, 1 together at most",
                field="--clear-gone",
                value=f"{self.clear_gone:g} and {self.clear_behind:g}",
            )


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Where a training runs; it may be resumed elsewhere."""

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    """processors that networks run on"""
    devices: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1
    """processes on each machine"""
    nodes: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1
    """machines, started by torchrun or Ray"""
    readers: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 2
    """processes that read packed frames, for each device"""
    log_every: Count = 50
    """steps between rows of the log"""
    progress: bool = field(default=True, metadata=_NO_OPTION)
    """a progress bar"""
    in_ray: bool = field(default=False, metadata=_NO_OPTION)
    """Ray Train started this process and knows how many there are"""

    def shown(self) -> Self:
        """The same, with a progress bar where there is a terminal."""
        return replace(self, progress=sys.stderr.isatty())


@dataclass(frozen=True, kw_only=True)
class TrainCommand(TrainOptions):
    """Train a network on packed frames.

    Interrupted or killed, the same command resumes from the last checkpoint and ends with the same
    weights. What is not given is as published for the method.
    """

    out: Path = field(metadata={"option": "out", "writes": Writes("parts")})
    """folder of the training"""
    machine: Machine = field(default_factory=Machine)
    engine: Literal["local", "ray"] = "local"
    """processes of this machine and of torchrun (local), or of Ray Train"""
    ray_address: str | None = None
    """HOST:PORT of a running Ray cluster (one is started on this machine)"""


@dataclass(frozen=True, kw_only=True)
class PackOptions:
    """How frames are packed."""

    size: tuple[Pixels, Pixels] = (224, 224)
    """width and height of all maps; the aspect need not be kept"""
    depth: DepthKind = "float32"
    """float16 halves the largest part of the files and rounds depths of 0.5 to 1 m by up to
    0.25 mm"""
    color: ColorWay = "cubic"
    """how colour is resized; depth and masks take the nearest pixel"""
    shard: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 64
    """frames per file: what is lost at most when packing is killed"""
    nocs: bool = False
    """also pack NOCS and classes, for pose networks"""
    raw: RawKind = "sensor"
    """the sensor's depth, or exact depth without specular and transparent objects (cut)"""

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class PackCommand(PackOptions):
    """Pack the frames of a split at training size, to be read without decoding.

    Run the same command again to resume.
    """

    folder: Path = field(metadata={"writes": Writes("parts")})
    """folder of the packed frames"""
    split: str = field(metadata={"option": "split"})
    """name of `std-bench list splits`"""
    data: Path = field(metadata={"option": "data"})
    """folder of the data set"""
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True)
class TableOptions:
    """What is drawn on a table."""

    assets: str = "procedural"
    """source of shapes: procedural, shapenet, folder"""
    assets_root: Path | None = None
    """folder of its files, of sources that have files"""
    split: Literal["train", "test", "all"] = "train"
    """which shapes"""
    objects: tuple[int, int] = (4, 8)
    """least and largest number of objects"""
    sizes: tuple[float, float] = (0.4, 0.9)
    """range of factors on the usual sizes of the categories, which are mostly too wide for a jaw of
    8 cm"""
    half_width_m: float = field(default=0.25, metadata=_NO_OPTION)
    """of the square that they fall on"""

    def __post_init__(self) -> None:
        if not 1 <= self.objects[0] <= self.objects[1]:
            raise ToolkitError("must be two rising counts", field="objects", value=self.objects)
        if not 0 < self.sizes[0] <= self.sizes[1]:
            raise ToolkitError("must be two rising factors", field="sizes", value=self.sizes)


@dataclass(frozen=True, kw_only=True)
class GraspPackOptions:
    """How scenes of labelled grasps are made."""

    table: TableOptions = field(default_factory=TableOptions)
    seed: Seed = 0
    """of the first scene; the others follow"""
    frames: Count = 4
    """views of a scene"""
    size: tuple[Count, Count] = (640, 360)
    """width and height of the depth images"""
    depth: Literal["exact", "sensor"] = "exact"
    """exact, or with the errors of an active stereo camera (sensor)"""
    points: Count = 40_000
    """most points of a frame that are kept"""
    gripper: str = "panda"
    """the one that must not hit anything: panda, graspnet"""
    spacing: Positive = 0.008
    """metres between the points of an object that have labels"""

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class GraspPackCommand(GraspPackOptions):
    """Make scenes of objects on a table with all their grasps, for `std-train --method graspnet`.

    Run the same command again to resume, with more --scenes to add some.
    """

    folder: Path = field(metadata={"writes": Writes("parts")})
    """folder of the packed scenes"""
    scenes: Count = field(metadata={"option": "scenes"})
    """how many scenes"""
    jobs: JobOptions = field(default_factory=JobOptions)


# Links to the user's scenes tell those that are trained on from those that are scored.
_MINE = Writes("results", ("sets", "scenes"), inputs=("scenes/train", "scenes/test"))


@dataclass(frozen=True, kw_only=True)
class MineOptions:
    """Fine-tune the shipped weights on your own objects, and score them before and after.

    Objects of --meshes are simulated by std-sim; --scenes are labelled scenes with ground truth
    (`std-curate render`). Scenes that are scored are never trained on. Run the same command again
    to resume.
    """

    out: Path = field(metadata={"option": "out", "writes": _MINE})
    """folder of sets, packs, training and results"""
    meshes: Path | None = None
    """folder of your meshes; sub-folders are categories, and `assets.json` gives units and more"""
    scenes: Path | None = None
    """folder of your labelled scenes; the last third by name is scored and not trained on"""
    method: str = "swindrnet"
    """network with shipped compact weights: swindrnet, nlspn, dfnet"""
    simulated: Scenes = 24
    """scenes to simulate for training"""
    tests: Scenes = 6
    """further scenes to simulate for the scores"""
    views: Count = 12
    """frames of a simulated scene"""
    size: tuple[Count, Count] = field(default=(424, 240), metadata={"size": True})
    """image size of simulated scenes"""
    quality: Literal["rough", "draft", "better", "fine"] = "draft"
    """light paths per pixel of simulated scenes"""
    steps: Count = 400
    """optimizer steps"""
    batch_size: Count = 16
    """frames of a step"""
    learning_rate: Positive = 1e-4
    """learning rate at its highest"""
    seed: Annotated[int, msgspec.Meta(ge=0, le=30_000)] = 0
    """of the first simulated scene, and of the training"""
    machine: Machine = field(default_factory=Machine)
    jobs: JobOptions = field(default_factory=JobOptions)

    def __post_init__(self) -> None:
        check_options(self)
        if self.meshes is None and self.scenes is None:
            raise ToolkitError("needed", field="--meshes", hint="or --scenes, or both")


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Write the best weights of a training in half precision, with their SHA-256 and a model card.

    The card names data, steps, machine, time and scores.
    """

    run: Path
    """folder of the training"""
    out: Path = field(metadata={"option": "out", "writes": Writes("files")})
    """folder of the files"""
    results: tuple[Path, ...] = ()
    """results of `std-bench` for the card"""
