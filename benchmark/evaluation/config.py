"""Options of each benchmark task, and the parsing of their values.

The command line is generated from these dataclasses; see `std_toolkit.cli.command_options`. The
module imports no heavy packages.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, get_args

import msgspec

from benchmark.evaluation.values import (
    is_folder,
    labels_by_method,
    roots_of,
    settings_by_method,
    weights_by_method,
)
from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions

if TYPE_CHECKING:
    from benchmark.methods.registry import MethodOptions

Count = Annotated[int, msgspec.Meta(ge=1)]
Fit = Literal["ransac", "paper"]
FITS: tuple[Fit, ...] = get_args(Fit)

# In the place of a depth and of a fit, where poses lie in files.
AS_FILED = "as-filed"


def _option(name: str) -> dict[str, str]:
    return {"option": name}


@dataclass(frozen=True, kw_only=True)
class BenchJobs(JobOptions):
    """Options of the worker processes."""

    gpus: Annotated[float, msgspec.Meta(ge=0)] = field(
        default=0.0, metadata=_option("gpus-per-task")
    )
    """GPUs that Ray reserves for each task, which then sees no others; may be a share"""


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """Options of every task."""

    task: ClassVar[str]

    json: bool = False
    """print the table as JSON"""
    jobs: BenchJobs = field(default_factory=BenchJobs)

    def __post_init__(self) -> None:
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class NetworkConfig(TaskConfig):
    """Options of every task that runs methods."""

    out: Path = field(metadata={"option": "out", "writes": Writes("parts")})
    """folder of results"""
    preset: str | None = None
    """network size: published or compact (compact if its weights ship and no --weights is given,
    else published)"""
    weights: tuple[str, ...] = ()
    """[METHOD=]FILE of trained weights: safetensors, or a checkpoint of tensors alone"""
    settings: tuple[str, ...] = field(default=(), metadata=_option("set"))
    """[METHOD.]NAME=VALUE, a method's own settings (of the only method that has one so called)"""
    devices: tuple[str, ...] = field(default=("cpu",), metadata=_option("device"))
    """torch devices: cpu, cuda:0 cuda:1, ..."""
    precision: Literal["fp32", "bf16", "fp16"] = "fp32"
    """arithmetic of networks"""
    compile: bool = False
    """run networks through torch.compile"""
    gallery: bool = True
    """pictures of a few frames or rounds"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "devices")


@dataclass(frozen=True, kw_only=True)
class FrameConfig(NetworkConfig):
    """Options of a task over the frames of data sets; every method runs on every split."""

    methods: tuple[str, ...] = field(metadata=_option("method"))
    """names of `std-bench list methods`, package.module:Class, file.py:Class, NAME=DIR
    of predictions, 'command:PROGRAM ARGUMENTS'"""
    splits: tuple[str, ...] = field(metadata=_option("split"))
    """names of `std-bench list splits`"""
    data: tuple[str, ...] = field(metadata=_option("data"))
    """[SPLIT=]ROOT, folder above the data sets, or of one split"""
    protocols: tuple[str, ...] = field(default=("strict",), metadata=_option("protocol"))
    """how predictions are scored: strict, paper, ..."""
    label: tuple[str, ...] = ()
    """[METHOD=]NAME of a method in tables (its own name)"""
    batch_size: Count = 8
    """frames that a method receives at once"""
    limit: Count | None = None
    """score only N frames, evenly spaced"""
    gallery_frames: tuple[str, ...] = ()
    """SCENE/FRAME of the pictures that all methods have (a few, evenly spaced)"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "methods", "splits", "protocols", "data")
        _ = self.labels

    @property
    def labels(self) -> dict[str, str]:
        """Names in tables by method; predictions in folders have their own."""
        return labels_by_method(self.label, [m for m in self.methods if not is_folder(m)])

    @property
    def roots(self) -> dict[str | None, Path]:
        """Data folders by split; the key None is for splits without an entry."""
        return roots_of(self.data)


@dataclass(frozen=True, kw_only=True)
class DepthConfig(FrameConfig):
    """Score depth restorers: every method on every split by every protocol."""

    task = "depth"

    depth_from: Path | None = None
    """folder of predicted depth that replaces the sensor's; as --method NAME=DIR"""
    depth_units: tuple[str, ...] = field(default=(), metadata=_option("depth-unit"))
    """[NAME=]UNIT of predicted depth in folders: m, cm, mm, 0.1mm, or metres per number (mm of
    whole numbers, m of others)"""
    save_depth: bool = False
    """keep the restored depth beside the results"""
    probes: tuple[Literal["holes", "color"], ...] = field(default=(), metadata=_option("probe"))
    """run the methods again: holes cut into depth that was right (once more a frame), or colour
    replaced by noise and another frame's (five times more)"""
    speed: bool = True
    """the time that the methods take"""
    released_loader: Count | None = None
    """with --protocol paper: frames as the authors' loader gives them in batches of N; ids of EXR
    masks are truncated, and the last frames that fill no batch are left out"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.probes:
            check_lists(self, "probes")
            if self.depth_from is not None:
                raise ToolkitError(
                    "runs the methods again, which saved depth cannot",
                    field="--probe",
                    value=" ".join(self.probes),
                    hint="leave out --depth-from",
                )
        if self.released_loader is not None and self.protocols != ("paper",):
            raise ToolkitError(
                "is for --protocol paper alone",
                field="released_loader",
                value=self.released_loader,
                hint="run other protocols without it",
            )


@dataclass(frozen=True, kw_only=True)
class PoseConfig(FrameConfig):
    """Score category-level pose methods: every method on every split with every depth and fit."""

    task = "pose"

    depths: tuple[str, ...] = field(default=("raw",), metadata=_option("depth"))
    """depth that poses are fitted to: raw, gt, restorers, or NAME=DIR of saved depth"""
    fits: tuple[Fit, ...] = field(default=("ransac",), metadata=_option("fit"))
    """how poses are fitted: RANSAC, or least squares as in the paper's program"""
    depth_as_input: bool = False
    """networks also receive the depth of --depth, not the raw depth"""
    iou: Literal["oriented", "aabb", "nocs2019"] | None = None
    """overlap of boxes, instead of the protocol's own"""
    score: Literal["ap", "accuracy"] | None = None
    """what a figure means, instead of the protocol's own"""
    gates: Literal["all", "found"] | None = None
    """angle and distance of all predictions, or of those that overlap a true box"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "depths", "fits")


@dataclass(frozen=True, kw_only=True)
class GraspConfig(NetworkConfig):
    """Clear tables in simulation: every planner on every depth, all on the same rounds."""

    task = "grasp"

    depths: tuple[str, ...] = field(default=("raw",), metadata=_option("depth"))
    """depth that grasps are planned on: raw, gt, restorers, or NAME=DIR of saved depth"""
    planners: tuple[str, ...] | None = field(default=None, metadata=_option("planner"))
    """antipodal, graspnet, oracle (knows where the objects are), flat-patches (for suction),
    package.module:Class, or file.py:Class (antipodal, or flat-patches with --gripper suction)"""
    gripper: Literal["panda", "suction"] = "panda"
    """panda: a parallel jaw; suction: a suction cup"""
    cup_radius: Annotated[float, msgspec.Meta(ge=0.002, le=0.05)] | None = None
    """metres, of the suction cup (0.01)"""
    rounds: Count | None = None
    """tables to clear (6, or one for each of --scenes)"""
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0
    """decides every round and all noise"""
    camera: Literal["quick", "simulated"] = "quick"
    """quick: depth by a model fitted to the simulator; simulated: by the simulator itself"""
    attempts: Count = 10
    """most attempts in a round"""
    move: Literal["guarded", "straight"] = "guarded"
    """guarded: the hand stops at a contact, backs off and closes; straight: what it meets ends the
    attempt"""
    meshes: Path | None = None
    """folder of meshes for the tables, CATEGORY/NAME.obj or with assets.json (built-in shapes)"""
    meshes_unit: Literal["m", "cm", "mm"] | None = None
    """unit of these meshes, which then keep their size (a size is drawn that the jaw can hold)"""
    scenes: Path | None = None
    """folder of labelled scenes, whose objects stand on the tables as they do there"""
    save_views: Path | None = field(default=None, metadata={"writes": Writes("parts")})
    """write every view (colour, depth, camera) to scenes in this folder, for your own restorer"""
    label: tuple[str, ...] = ()
    """[PLANNER=]NAME of a planner in tables (its own name), or NAME of the dump"""
    dump: Path | None = None
    """folder of grasps to score on GraspNet's test scenes instead, such as
    scene_0100/realsense/0000.npy"""
    data: Path | None = field(default=None, metadata=_option("data"))
    """folder of GraspNet-1Billion, for --dump"""
    graspnet_split: Literal["test", "seen", "similar", "novel"] = "test"
    """scenes of --dump"""
    graspnet_camera: Literal["realsense", "kinect"] = "realsense"
    """camera of --dump"""
    contacts: Literal["exact", "sdf"] = "exact"
    """contacts of --dump: exact, on the mesh; sdf: as in graspnetAPI, for published figures"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "depths", *(["planners"] if self.planners is not None else []))
        if self.cup_radius is not None and self.gripper != "suction":
            raise ToolkitError(
                "belongs to --gripper suction", field="cup_radius", value=self.cup_radius
            )
        if self.gripper == "suction" and self.move == "straight":
            raise ToolkitError(
                "is a move of the jaw; a suction cup stops where it touches",
                field="move",
                value=self.move,
            )
        if self.meshes_unit is not None and self.meshes is None:
            raise ToolkitError("belongs to --meshes", field="meshes_unit", value=self.meshes_unit)
        if self.scenes is not None and self.meshes is not None:
            raise ToolkitError(
                "tables are of --meshes or of --scenes", field="scenes", value=str(self.scenes)
            )
        _ = self.labels

    @property
    def labels(self) -> dict[str, str]:
        """Names in tables by planner, or that of the dump by "dump"."""
        if self.dump is not None:
            return labels_by_method(self.label, ["dump"])
        return labels_by_method(self.label, self.planners or [""])


@dataclass(frozen=True, kw_only=True)
class BopConfig(TaskConfig):
    """Score result files of instance-level poses, or a program, on a data set in BOP's layout."""

    task = "bop"

    data: Path = field(metadata=_option("data"))
    """folder of the data set"""
    results: tuple[Path, ...] = field(default=(), metadata=_option("results"))
    """CSV files in BOP's format"""
    program: str = ""
    """a program that finds the poses, as NAME=COMMAND; {data} is the data set, {folder} the folder
    of targets.json, into which it writes results.csv"""
    detections: Path | None = None
    """JSON file of BOP's default detections, handed to the program"""
    timeout_s: Annotated[float, msgspec.Meta(gt=0)] = 86400.0
    """seconds after which the program is stopped"""
    bop_split: str = "test"
    """folder of the scenes"""
    sensors: tuple[str, ...] = field(default=(), metadata=_option("sensor"))
    """of a data set with several, such as photoneo; of each scene the first that it has (those that
    the BOP Challenge scores)"""
    errors: tuple[Literal["vsd", "mssd", "mspd"], ...] = ("vsd", "mssd", "mspd")
    """errors to score; VSD is left out where there is no depth"""
    symmetry_steps: Count | None = None
    """samples of a turn about a continuous axis of symmetry: 315 in published figures (the exact
    minimum)"""
    vsd_delta_mm: Annotated[float, msgspec.Meta(gt=0)] = 15.0
    """how far behind the measured depth a surface of VSD counts as visible (ITODD: 5)"""
    multi_view: bool = False
    """score detection on the views of test_targets_multiview_bop25.json"""
    out: Path | None = field(default=None, metadata={"writes": Writes("parts")})
    """folder of results (the table is only printed)"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_lists(self, "errors", *(["results"] if self.results or not self.program else []))
        if self.detections is not None and not self.program:
            raise ToolkitError(
                "belongs to --program", field="detections", value=str(self.detections)
            )


def options_by_method(config: NetworkConfig, methods: Sequence[str]) -> dict[str, MethodOptions]:
    """Return the options of each method, by its name.

    Raises:
        ToolkitError: weights or settings for a method that is not requested.
    """
    from benchmark.methods.registry import MethodOptions, has_setting, preset_for

    weights = weights_by_method(config.weights, methods)
    settings = settings_by_method(config.settings, methods, has_setting)
    return {
        method: MethodOptions(
            preset=preset_for(method, config.preset, weights.get(method)),
            weights=weights.get(method),
            precision=config.precision,
            compile=config.compile,
            settings=settings[method],
        )
        for method in methods
    }


def check_lists(config: object, *names: str) -> None:
    """Check that lists are not empty and have no duplicates.

    Raises:
        ToolkitError: a list is empty or has a duplicate; names the field and the duplicate.
    """
    for name in names:
        values = getattr(config, name)
        if not values:
            raise ToolkitError("needs at least one value", field=name)
        if twice := [v for v in values if values.count(v) > 1]:
            raise ToolkitError("is given twice", field=name, value=twice[0])
