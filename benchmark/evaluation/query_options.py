"""Options of the commands of `std-bench` that are no task: lists, checks, verify, bake-off.

As `benchmark.evaluation.config`, it imports no heavy packages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from benchmark.evaluation.config import BenchJobs, Count, NetworkConfig, TaskConfig, check_lists
from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions, Material

FRAME_LIST = "frames.csv"
AUDIT_FILE = "audit.json"


@dataclass(frozen=True, kw_only=True)
class ListOptions:
    """List the methods or the splits that there are, or what papers print."""

    what: Literal["methods", "splits", "published"]
    """what to list"""
    task: Literal["depth", "pose", "grasp"] = "depth"
    """whose methods or figures"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class CheckDataOptions:
    """Report which files of a split are there and which are missing."""

    root: Path
    """folder above the data sets, or of the split"""
    splits: tuple[str, ...] = field(metadata={"option": "split"})
    """names of `std-bench list splits`"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class SelfTestOptions:
    """Compare the answers of the networks with pinned ones, on the CPU.

    Those of seed 0 of released networks are of the authors' programs, under weights by a rule;
    others are the toolkit's own. All take 2 GB of memory, and a minute on two free cores.
    """

    networks: Literal["all", "shipped", "released"] = "all"
    """shipped: those whose weights come with the toolkit; released: those of the authors' form"""
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class SpeedOptions:
    """Measure frames per second, parameters and cost of networks, without weights and data.

    Networks have the weights that training begins with, and see a made-up frame at the size they
    work at. Below are the speeds that papers print.
    """

    methods: tuple[str, ...] = field(
        default=("swindrnet", "nlspn", "dfnet", "lidf", "cleargrasp", "two-branch"),
        metadata={"option": "method"},
    )
    """names of `std-bench list methods`, package.module:Class, or file.py:Class"""
    preset: str = "published"
    """network size: published or compact"""
    size: tuple[int, int] = field(default=(640, 360), metadata={"size": True})
    """size of the frame, for networks that work at any size"""
    device: str = "cpu"
    """torch device"""
    precision: Literal["fp32", "bf16", "fp16"] = "fp32"
    """arithmetic of networks"""
    compile: bool = False
    """run networks through torch.compile"""
    batch_size: Count = 1
    """frames restored at once"""
    repeats: Count = 15
    """most timed batches; fewer for slow networks"""
    json: bool = False
    """print JSON"""

    def __post_init__(self) -> None:
        check_options(self)
        check_lists(self, "methods")
        if min(self.size) < 1:
            raise ToolkitError("must be positive", field="size", value=self.size)


@dataclass(frozen=True, kw_only=True)
class InferListOptions:
    """Write the list of frames that a program of another environment is to restore.

    Writes frames.csv (scene, frame, color, raw, raw_unit_m, width, height, fx, fy, cx, cy, out) and
    raw/ into the folder. The program writes depth to `out`, metres as .npy, or another suffix.
    Then: std-bench depth --method NAME=OUT/predictions.
    """

    data: Path = field(metadata={"option": "data"})
    """folder above the data sets, or of the split"""
    split: str = field(metadata={"option": "split"})
    """name of `std-bench list splits`"""
    out: Path = field(metadata={"option": "out", "writes": Writes("results", (FRAME_LIST,))})
    """folder of the list"""
    limit: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """list only N frames, evenly spaced, as the same option of `std-bench depth`"""
    jobs: JobOptions = field(default_factory=JobOptions)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class OrderOptions(TaskConfig):
    """Score the order of points on layers of glass, on LayeredDepth's validation photos.

    The set has no depth but the order of points: its scores stand apart from all others. Folders of
    predictions have KEY_LAYER.png, 16 bit, or .npy, or KEY.png of the first layer alone. Without
    predictions, what of the set is there is counted.
    """

    task = "order"

    data: Path = field(metadata={"option": "data"})
    """folder of the photos and tuples, unpacked or in *.tar"""
    predictions: tuple[str, ...] = ()
    """NAME=DIR of predictions"""
    subset: Literal["layer_first", "layer_all"] = "layer_first"
    """first surfaces, or all layers"""
    layers: Literal["auto", "odd", "counted"] = "auto"
    """how files count layers: 1, 3, 5, 7 (odd), or 0, 1, 2, 3 (counted); auto: as they tell"""
    npy: Literal["inverse", "depth"] = "inverse"
    """what .npy holds: inverse depth, as in the authors' program, or depth"""
    out: Path | None = field(
        default=None,
        metadata={"option": "out", "writes": Writes("results", ("layered-depth",))},
    )
    """folder of results for `std-report` and `verify`, which the same command goes on with (scores
    are printed and not kept)"""
    jobs: BenchJobs = field(default_factory=lambda: BenchJobs(engine="serial"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.out and not self.predictions:
            raise ToolkitError("needs predictions", field="out", hint="--predictions NAME=DIR")

    @property
    def folders(self) -> dict[str, Path]:
        """Folders of predictions by name."""
        return _named_paths(self.predictions, "predictions")


@dataclass(frozen=True, kw_only=True)
class AuditOptions(TaskConfig):
    """Judge the labels of a data set against its images, and write a page to publish.

    Where objects stand still and the camera moves, frames are judged together; others alone. The
    judge and its limits are those of `std-curate check`.
    """

    task = "audit"

    set: Path
    """folder of the data set"""
    out: Path = field(metadata={"option": "out", "writes": Writes("results", (AUDIT_FILE,))})
    """folder of the audit: report.html, audit.json, and tables of objects, labels and frames"""
    split: str = "bop"
    """bop (any set in BOP's form), or a name of `std-bench list splits`"""
    scenes: tuple[str, ...] = field(default=(), metadata={"option": "scene"})
    """judge these scenes only"""
    frames: Count = 40
    """frames of each scene, evenly spaced"""
    models: Path | None = None
    """folder of the meshes, if they do not lie in the set; named after models, or after numbers of
    the masks"""
    material: Material | None = None
    """material of objects whose set does not state it (bop: diffuse)"""
    name: str = ""
    """name of the set on the page (that of the folder)"""


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(TaskConfig):
    """Check results: by their own files, and with the data by making their rows again."""

    task = "verify"

    results: tuple[Path, ...]
    """folders that std-bench wrote"""
    data: tuple[str, ...] = field(default=(), metadata={"option": "data"})
    """[SPLIT=]ROOT, folder of the data (the files of the results alone are checked)"""
    sample: Count | None = None
    """make the rows of N frames of each run again, evenly spaced (all)"""
    predictions: tuple[str, ...] = ()
    """NAME=PATH of predictions that are not where they were: folder of a method, CSV file of BOP"""
    rerun: bool = False
    """run the depth methods again instead of reading their predictions"""
    weights: tuple[str, ...] = ()
    """METHOD=FILE, weights that the results state the digest of"""
    trust: tuple[str, ...] = ()
    """methods outside of the toolkit that --rerun may run, as the results name them"""
    device: str = "cpu"
    """torch device of --rerun"""
    out: Path | None = field(default=None, metadata={"writes": Writes("file")})
    """record for `std-report site --verified` (verification.json in the first folder)"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "results")
        for name in ("sample", "rerun", "predictions"):
            if getattr(self, name) and not self.data:
                raise ToolkitError("needs the data", field=name, hint="--data ROOT")

    @property
    def prediction_files(self) -> dict[str, Path]:
        """Folders and files of predictions by name."""
        return _named_paths(self.predictions, "predictions")

    @property
    def weight_files(self) -> dict[str, Path]:
        """Files of weights by label or method."""
        return _named_paths(self.weights, "weights")


@dataclass(frozen=True, kw_only=True)
class BakeoffOptions(NetworkConfig):
    """Say which depth restorer to use for a camera, by labelled recordings made with it.

    Methods at hand are raw, nearest, colorization and the networks whose weights come with the
    toolkit. Folders depth_NAME of a recording, which the camera's own software restored, are scored
    as vendor.NAME. Writes bakeoff.html; run the same command again to resume.
    """

    task = "bakeoff"

    recordings: tuple[Path, ...]
    """scenes with labels and ground truth (`std-curate run`), or folders above some"""
    out: Path = field(
        metadata={"option": "out", "writes": Writes("results", ("bakeoff.html", "results"))}
    )
    """folder of copied frames, results and the page"""
    sprayed: tuple[Path, ...] = ()
    """a recording of the same scene with its objects sprayed matt, for each recording in their
    order: truth in place of labels; a board that was not moved lies in both (board.json)"""
    methods: tuple[str, ...] = field(default=(), metadata={"option": "method"})
    """further methods, as of `std-bench depth`: names, file.py:Class, NAME=DIR of predictions"""
    at_hand: bool = True
    """the methods at hand (of those, raw alone)"""
    depth_units: tuple[str, ...] = field(default=(), metadata={"option": "depth-unit"})
    """[NAME=]UNIT of predictions in folders, as of `std-bench depth`"""
    limit: Count = 24
    """most frames, evenly spaced in each scene"""
    gallery: bool = False
    """pictures of a few frames"""
    speed: bool = True
    """processor time of a frame of 640x480"""
    jobs: BenchJobs = field(default_factory=lambda: BenchJobs(engine="serial"))

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "recordings", *(["methods"] if self.methods else []))


def _named_paths(texts: Sequence[str], option: str) -> dict[str, Path]:
    found = {}
    for text in texts:
        name, equals, path = text.partition("=")
        if not (name and equals and path):
            raise ToolkitError("expected NAME=PATH", field=option, value=text)
        if not Path(path).exists():
            raise ToolkitError("no such file or folder", path=path, field=option)
        found[name] = Path(path)
    return found
