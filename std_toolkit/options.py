"""Options of each curation step, with defaults and ranges.

The command lines are generated from these dataclasses (see `std_toolkit.cli.command_options`). The
module imports no heavy library. Lengths are in metres and angles in radians unless the name has a
unit.
"""

import enum
import math
import os
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from std_toolkit.errors import CheckedOptions, ToolkitError, check_options

Material = Literal["raw", "diffuse", "transparent", "specular"]
LinkMode = Literal["copy", "hard", "sym"]
Unit = Literal["m", "cm", "mm"]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Whole = Annotated[int, msgspec.Meta(ge=0)]
# Lightning takes 32 bits, and scenes and views count on from it.
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**31 - 1)]
_REPEATED: dict[str, Any] = {"repeat": True}


class Refinement(enum.StrEnum):
    """Intrinsics that bundle adjustment refines together with the poses.

    "none" keeps the given intrinsics, "focal" refines fx and fy, "intrinsics" also cx and cy,
    "distortion" also k1 k2 p1 p2.
    """

    NONE = "none"
    FOCAL = "focal"
    INTRINSICS = "intrinsics"
    DISTORTION = "distortion"


class Mapper(enum.StrEnum):
    """COLMAP mapper that reconstructs the keyframes."""

    INCREMENTAL = "incremental"
    GLOBAL = "global"


CameraConvention = Literal[
    "camera-to-world", "world-to-camera", "camera-to-world-opengl", "world-to-camera-opengl",
    "camera-to-world-unity", "world-to-camera-unity",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class JobOptions(CheckedOptions):
    """Where work runs and how much of it in parallel."""

    engine: Literal["local", "serial", "ray"] = "local"
    """local (processes on this machine), serial (this process) or ray (needs extra `cluster`)"""
    workers: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """number of parallel processes or Ray tasks (default: the usable cores)"""
    ray_address: str | None = None
    """host:port of a running Ray cluster (default: start one on this machine)"""
    gpus: Annotated[float, msgspec.Meta(ge=0)] = field(default=0.0, metadata={"option": None})
    """GPUs that Ray reserves for each task, which sees only these; may be fractional"""
    progress: bool = field(default=True, metadata={"option": None})
    """show a progress bar if stderr is a terminal"""

    @property
    def worker_count(self) -> int:
        """Number of processes: `workers`, or one for each core that this process may use."""
        return self.workers or usable_cores()


def usable_cores() -> int:
    """Cores that this process may use; those of the machine where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS, Windows


@dataclass(frozen=True, kw_only=True)
class KnownCameras(CheckedOptions):
    """Camera poses from a robot, a motion capture system or another reconstruction."""

    cameras: Path | None = None
    """known camera poses: a folder with a 4x4 matrix per image or a file of all, TUM, CSV,
    transforms.json, a COLMAP model or *_par.txt; see docs/camera-poses.md"""
    cameras_convention: CameraConvention | None = None
    """direction and camera axes of these poses; OpenCV axes (y down, z forward) where none are
    named, left-handed ones (y up, z forward) for unity, as of ICL-NUIM (default: that of the
    format; camera-to-world where it fixes none)"""
    cameras_unit: Literal["m", "cm", "mm", "unknown"] | None = None
    """unit of these positions; unknown estimates the scale (default: m; required for
    transforms.json and COLMAP models)"""
    cameras_quaternion: Literal["wxyz", "xyzw"] | None = None
    """order of quaternions in files of poses that do not name it (default: wxyz for nanoseconds and
    commas, as in EuRoC; xyzw for seconds, as in TUM)"""
    cameras_use: Literal["keep", "refine"] = "keep"
    """keep these poses as they are, or refine them by bundle adjustment, with their scale held"""
    cameras_max_px: Positive = 4.0
    """refuse poses with a larger median reprojection error of matched features"""
    cameras_max_dt: Positive = 0.02
    """largest time in seconds between an image and its pose, for files with time stamps"""
    cameras_first: Annotated[int, msgspec.Meta(ge=0)] | None = None
    """number of the pose that belongs to the first image, where poses and images count from
    different numbers (default: equal numbers belong together)"""
    cameras_unchecked: bool = False
    """keep poses that do not pass this check or cannot be checked"""
    hand_eye: Path | None = None
    """hand-eye calibration T_flange_cam of a robot; the poses are then those of its flange in its
    base"""
    hand_eye_unit: Unit = "m"
    """unit of the hand-eye calibration"""


@dataclass(frozen=True, kw_only=True)
class PoseBasics:
    """Camera pose options that `std-curate run` shares."""

    scale: str = "auto"
    """source of the metric scale: auto (every source the scene has; they must agree), none (unit
    unknown), depth, cad, board, or the name of a plug-in"""
    board: Path | None = None
    """description of the fiducial board (default: SCENE/board.json)"""
    seed: int = 0
    """random seed"""
    threads: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """number of threads; 1 makes runs byte-identical (default: all cores)"""


@dataclass(frozen=True, kw_only=True)
class PoseOptions(PoseBasics):
    """Options of camera pose recovery."""

    known: KnownCameras = field(default_factory=KnownCameras)
    refine: Refinement = Refinement.NONE
    """intrinsics to refine together with the poses"""
    mapper: Mapper = Mapper.INCREMENTAL
    """COLMAP mapper for the keyframes"""
    keyframe_motion: Positive = 0.05
    """median image motion between keyframes, as a fraction of the image width"""
    max_keyframe_gap: Annotated[int, msgspec.Meta(ge=1)] = 30
    """largest number of frames between keyframes"""
    max_features: Annotated[int, msgspec.Meta(ge=100)] = 8192
    """SIFT features per image"""
    fine_keyframes: bool = False
    """extract twice the features in four times the time, for scenes with little texture"""
    overlap: Annotated[int, msgspec.Meta(ge=1)] = 6
    """number of temporal neighbours to match each keyframe with"""
    loops: Whole = 4
    """number of similar keyframes from other times to match each keyframe with"""
    small_set: Whole = 60
    """match all pairs of up to this many frames where the usual pairs leave frames out"""
    min_points: Annotated[int, msgspec.Meta(ge=6)] = 20
    """smallest number of points needed to register a frame"""
    # Reduced on a short sweep and where an image has too few points. The limit keeps the objects
    # that the camera circles and drops the far background, where people walk.
    min_angle_deg: float = 18.0
    """smallest triangulation angle of points in the final bundle adjustment"""
    min_registered: Share = 0.95
    """gate: smallest fraction of keyframes, and of all frames, with a pose"""
    max_reprojection_px: Positive = 1.0
    """gate: largest mean reprojection error"""
    max_position_sigma: Positive = 0.01
    """gate: largest median standard deviation of the camera positions, relative to the distance
    of the observed points"""
    max_disagreement: float = 0.005
    """gate: largest relative difference between two scale sources; sources contradict each other
    if this and max_disagreement_sigma are exceeded"""
    max_disagreement_sigma: Positive = 3.0
    """gate: largest difference between two scale sources, in units of their joint standard
    deviation"""

    def __post_init__(self) -> None:
        # Without this check, a string that names no member would act as the default.
        for name, kind in (("mapper", Mapper), ("refine", Refinement)):
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError as error:
                raise ToolkitError(
                    "unknown choice",
                    field=name,
                    value=getattr(self, name),
                    hint=f"one of {', '.join(kind)}",
                ) from error
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class PropagateOptions:
    """Options of propagating labels to every registered frame."""

    objects: tuple[str, ...] | None = field(
        default=None, metadata={"option": "object", **_REPEATED}
    )
    """propagate this object only; may be repeated (default: all labelled objects)"""
    refine: bool = False
    """refine the pose of each object jointly over spread keyframes, from image edges, silhouettes
    and, on raw and diffuse objects only, sensor depth"""
    refine_scale: bool = False
    """also correct the scale of the camera poses from the known sizes of the objects"""
    keyframes: Annotated[int, msgspec.Meta(ge=2, le=200)] = 10
    """number of frames used for refinement"""
    use_depth: bool = field(default=True, metadata={"option": "depth"})
    """sensor depth: refine from the images only"""

    def __post_init__(self) -> None:
        if self.refine_scale and not self.refine:
            raise ToolkitError("--refine-scale needs --refine")
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class FusionOptions:
    """Options of fusing occluding geometry from sensor depth."""

    voxel_m: float = field(default=0.004, metadata={"option": None})
    """edge length of a voxel"""
    clearance_m: float = field(default=0.03, metadata={"option": "clearance-mm", "factor": 1000})
    """policy fused: ignore geometry closer than this to a labelled object"""


@dataclass(frozen=True, kw_only=True)
class RenderBasics:
    """Rendering options that `std-curate run` shares."""

    renderer: str = "pyrender"
    """pyrender, raycast, or the name of a plug-in; pyrender falls back to raycast without a GL
    context and for cameras with distortion"""
    policy: Literal["auto", "models", "sensor", "fused"] = "auto"
    """what occludes the labelled objects besides each other: nothing (models), the sensor depth
    of the frame (sensor), or geometry fused from the sensor depth of many frames (fused); auto
    selects fused if 8 or more registered frames have sensor depth, sensor with fewer if no object
    is transparent or specular, otherwise models"""


@dataclass(frozen=True, kw_only=True)
class RenderOptions(RenderBasics):
    """Options of rendering ground truth."""

    delta_m: float = field(default=0.015, metadata={"option": "delta-mm", "factor": 1000})
    """sensor depth or fused geometry occludes an object from this distance in front of it"""
    fusion: FusionOptions = field(default_factory=FusionOptions)
    smooth_normals: bool = field(default=True, metadata={"off": "flat-normals"})
    """use the normal of each triangle instead of interpolated vertex normals"""
    force: bool = False
    """render again frames that are complete and up to date"""

    def __post_init__(self) -> None:
        check_options(self)
        for name, value in (
            ("delta_m", self.delta_m),
            ("clearance_m", self.fusion.clearance_m),
            ("voxel_m", self.fusion.voxel_m),
        ):
            if not 0 < value < 1:
                raise ToolkitError("must be between 0 and 1 m", field=name, value=value)


@dataclass(frozen=True, kw_only=True)
class CheckBasics:
    """Verdicts that fail the check, besides "wrong"; those that `std-curate run` has, too."""

    allow_doubtful: bool = False
    """pass with doubtful labels, after a person has looked at them"""
    strict: bool = False
    """fail for a label of which nothing is known, too"""


@dataclass(frozen=True, kw_only=True)
class CheckOptions(CheckBasics):
    """Gates of the check and how many frames it measures."""

    min_registered: Share = 0.9
    """gate: smallest fraction of frames with a camera pose"""
    max_reprojection_px: float = 1.5
    """gate: largest mean reprojection error of the camera poses"""
    max_scale_disagreement: float = 0.005
    """gate: largest relative difference between two scale sources; the gate fails if this and
    max_scale_sigma are exceeded"""
    max_scale_sigma: Positive = 3.0
    """gate: largest difference between two scale sources, in units of their joint standard
    deviation"""
    max_edge_px: float = 3.0
    """gate: largest median distance from a contour to the nearest image edge"""
    max_shift_px: float = 3.0
    """gate: largest median shift between a contour and the image"""
    max_depth_mm: float = 5.0
    """gate: largest median depth residual on a diffuse object, without the part due to scale"""
    max_drift_px: float = 3.0
    """gate: largest image motion relative to a label that no pose explains"""
    max_alignment_px: float = 3.0
    """gate: largest shift of sensor depth against colour"""
    max_motion_mm: float = 4.0
    """gate: largest significant translation between a label and the images"""
    max_motion_deg: float = 2.5
    """gate: largest significant rotation between a label and the images"""
    max_size_error: float = 0.025
    """gate: largest significant relative difference in size between a mesh and its object"""
    max_label_std_mm: float = 5.0
    """gate: largest standard deviation of a label along its weakest direction"""
    min_edge_support: Share = 0.3
    """smallest fraction of a contour that must be near image edges to be measured"""
    max_frames: int = 0
    """number of evenly spaced frames to measure; 0 = all"""
    overlay_frames: int = 6
    """number of frames to show with all labels; 0 = no images"""
    search_px: Annotated[float, msgspec.Meta(ge=4, le=100)] = 16.0
    """search radius around a contour for image edges"""
    shift_px: Positive = 12.0
    """largest shift of a whole contour to try"""
    image_width: Annotated[int, msgspec.Meta(ge=160)] = 1280
    """largest width of the images in the report"""
    jpeg_quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 82
    """JPEG quality of the images in the report"""
    inject: bool = False
    """report the smallest known faults, put into the scene in memory, that the check catches"""
    inject_objects: Whole = 6
    """--inject: number of evenly spaced objects that get faults; 0 = all"""
    inject_frames: Whole = 8
    """--inject: number of evenly spaced frames to measure; 0 = all"""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not math.isfinite(value) or value < 0:
                raise ToolkitError(
                    "must be a finite, non-negative number", field=entry.name, value=value
                )
        check_options(self)
        if self.shift_px > self.search_px:
            raise ToolkitError("must be at most search_px", field="shift_px", value=self.shift_px)

    def label_limits(self) -> dict[str, float]:
        """The limits that decide on labels and differ from the defaults, by name."""
        return {
            entry.name: float(value)
            for entry in fields(self)
            if entry.name not in _NOT_OF_LABELS
            and (value := getattr(self, entry.name)) != entry.default
        }


# Options of the check that no verdict on a label depends on: gates of the scene, exit status, page.
_NOT_OF_LABELS = frozenset(
    (
        *(entry.name for entry in fields(CheckBasics)),
        *("min_registered", "max_reprojection_px", "max_scale_disagreement", "max_scale_sigma"),
        *("max_alignment_px", "max_frames", "overlay_frames", "image_width", "jpeg_quality"),
        *("inject", "inject_objects", "inject_frames"),
    )
)


@dataclass(frozen=True, kw_only=True)
class ExportBasics:
    """Options of exports of one scene and of a project."""

    label_size: tuple[int, int] | None = field(default=None, metadata={"size": True})
    """STD: size of the label images (default: half the size for 1280x720 colour, else the size of
    colour)"""
    quaternion: Literal["dreds", "plain"] = "dreds"
    """STD: rotation in the meta file: dreds (inverse, as the DREDS generator writes it) or plain
    (object to camera)"""
    only: Literal["all", "fits"] = "all"
    """fits: leave out objects whose label is wrong, doubtful or unknown: their pixels become
    background"""
    drop_bad_frames: bool = False
    """leave out frames with a wrong camera pose, shifted depth or an unreadable file, and objects
    in the frames in which they do not fit; needs a current report of `std-curate check`"""
    settings: tuple[str, ...] = field(default=(), metadata={"option": "set"})
    """NAME=VALUE, own settings of an exporter plug-in"""
    overwrite: bool = False
    """replace an earlier export"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.label_size is not None and min(self.label_size) < 1:
            raise ToolkitError("must be positive", field="label_size", value=self.label_size)


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ExportBasics):
    """Options of writing a labelled scene in another layout."""

    scene_number: Annotated[int, msgspec.Meta(ge=0, le=999999)] = 1
    """BOP, NOCS: number of the scene"""
    split: Literal["train", "val", "test"] = "test"
    """BOP, NOCS: name of the split folder"""
    allow_wrong: bool = False
    """export although a label is wrong or a gate of the scene failed; the export says so"""
    scene_name: str = field(default="", metadata={"option": None})
    """STD: folder of the frames; "" is the name of the scene"""
    model_ids: tuple[str, ...] = field(default=(), metadata={"option": None})
    """BOP: models whose positions are the numbers of objects; () are those of the scene"""
