"""What each command of `std-curate` takes: the options of its step, and its own.

The command lines are generated from these dataclasses (see `std_toolkit.cli.command_options`).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from std_toolkit.errors import ToolkitError
from std_toolkit.importers.options import ImportOptions
from std_toolkit.jobs.door import Writes
from std_toolkit.options import (
    CheckBasics,
    CheckOptions,
    ExportOptions,
    JobOptions,
    LinkMode,
    Material,
    PoseBasics,
    PoseOptions,
    PropagateOptions,
    RenderBasics,
    RenderOptions,
    Unit,
)

_REPEATED: dict[str, Any] = {"repeat": True}


@dataclass(frozen=True, kw_only=True)
class ImportCommand:
    """Make a scene from a recording.

    Give SOURCE of a known format, or separate images with --color, --intrinsics and optionally
    --depth. Of a recording of ROS with several cameras, --color and --depth name topics.
    """

    source: Path | None = field(default=None, metadata={"option": ""})
    """folder of a recording in a known format, or a recording of ROS (rosbag2, .mcap, .db3,
    .bag)"""
    out: Path = field(metadata={"option": "out", "writes": Writes("new")})
    """new scene folder"""
    name: str | None = None
    """name of the scene (default: name of its folder)"""
    format: str | None = None
    """folder, ros, std, dreds, bop, nocs, cleargrasp or a plug-in (default: detected from
    SOURCE)"""
    options: ImportOptions = field(default_factory=ImportOptions)
    link: LinkMode = "copy"
    """copy images that need no conversion, or make hard or symbolic links; --link alone means
    --link hard"""
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class DoctorCommand:
    """Tell what an import would find, read, guess and ignore; nothing is written.

    Give a recording and the options of `std-curate import`, or a mesh, a file of intrinsics or one
    of camera poses. The exit status is 1 if the import would stop.
    """

    source: Path | None = field(default=None, metadata={"option": ""})
    """folder or file to examine"""
    format: str | None = None
    """as for import"""
    options: ImportOptions = field(default_factory=ImportOptions)
    json: bool = False
    """print JSON"""


@dataclass(frozen=True, kw_only=True)
class InfoCommand:
    """Print the contents of a scene, what is missing, and the next command.

    Of several scenes, print a row each: labels, verdicts, people, check and the next command. The
    exit status is 1 if one of them cannot be read.
    """

    scenes: tuple[Path, ...] = field(metadata={"writes": Writes("scene")})
    """scene folders"""
    frames: bool = False
    """list the frames of one scene instead: id, name, files, registered, labelled"""
    json: bool = False
    """print JSON"""

    def __post_init__(self) -> None:
        if not self.scenes:
            raise ToolkitError("needed", field="SCENES", hint="name one scene folder or several")


@dataclass(frozen=True, kw_only=True)
class PosesCommand:
    """Recover the camera pose of every frame with structure from motion.

    With --cameras, known poses are checked against the images and used instead. The metric scale
    is estimated from every source that the scene has. If a quality gate fails, the exit status is
    1 and the poses are saved with the failed gate.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    options: PoseOptions = field(default_factory=PoseOptions)
    json: bool = False
    """print the result as JSON"""
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class TrajectoryCommand:
    """Write the camera poses, in metres, for other tools."""

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    out: Path = field(metadata={"option": "out", "writes": Writes("place")})
    """output file; for colmap, output folder"""
    format: Literal["csv", "tum", "colmap", "nerf"] = "csv"
    """csv (one row per frame, T_world_cam row-major), tum, colmap (text model) or nerf
    (transforms.json, OpenGL axes)"""


@dataclass(frozen=True, kw_only=True)
class LabelCommand:
    """Add an object and set its pose in one or more frames.

    Repeat --frame, each with its own --pose or --correspondences. The frames become annotated
    keyframes. The pose maps mesh coordinates to camera coordinates. Formats of --pose: a 4x4
    matrix as text, .npy or JSON; JSON with quaternion_wxyz or quaternion_xyzw and translation_m
    or translation_mm; BOP scene_gt.json; 6D-PAT poses.json; LabelFusion *_poses.yaml and
    registration_result.yaml; vision6D .npy. See docs/labelling.md.
    """

    object: str = field(metadata={"option": "object"})
    """name of the object in this scene"""
    mesh: Path | None = None
    """mesh file; it is copied into the scene"""
    mesh_unit: Unit = "m"
    """unit of the mesh file"""
    model: str | None = None
    """model id (default: name of the mesh file)"""
    category: str | None = None
    """category, such as mug (default: other)"""
    material: Material | None = None
    """material; refinement uses sensor depth on raw and diffuse objects only (default: diffuse)"""
    symmetry: tuple[str, ...] | None = field(default=None, metadata=_REPEATED)
    """auto (turns after which the mesh and its colours are the same), axis:z (continuous about z),
    fold:z:4 (four-fold about z), a JSON file, or none; the axis
    passes through the centre of the bounding box, or with '@origin' through the mesh origin; may
    be repeated"""
    frames: tuple[str, ...] = field(default=(), metadata={"option": "frame", **_REPEATED})
    """file name, name or id of a frame; a number that means two frames is refused; may be
    repeated"""
    poses: tuple[Path, ...] = field(default=(), metadata={"option": "pose", **_REPEATED})
    """file with the object's pose in this frame; may be repeated"""
    correspondences: tuple[Path, ...] = field(default=(), metadata=_REPEATED)
    """CSV or JSON file of four or more u, v (pixels) and x, y, z (mesh coordinates); may be
    repeated"""
    pose_format: str = "auto"
    """matrix, quaternion, bop, 6dpat or labelfusion; auto detects it from the content"""
    pose_unit: Unit | None = None
    """unit of the translation, for files that do not define it"""
    pose_convention: Literal["opencv", "opengl"] = "opencv"
    """camera axes of the file: opencv (z forward) or opengl (-z forward)"""
    pose_frame: str | None = None
    """image to read from the file (default: that of --frame; a file that holds another image's pose
    is refused)"""
    pose_item: str | None = None
    """object to read from a file of several objects"""
    threshold_px: float = 4.0
    """inlier threshold of PnP in pixels"""
    add_view: bool = False
    """keep earlier annotations of the object"""
    annotator: str = ""
    """name of the annotator"""


@dataclass(frozen=True, kw_only=True)
class LabelArguments(LabelCommand):
    __doc__ = LabelCommand.__doc__

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""


@dataclass(frozen=True, kw_only=True)
class PropagateCommand:
    """Compute one world pose for each labelled object, and from it the pose in every frame."""

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    options: PropagateOptions = field(default_factory=PropagateOptions)


@dataclass(frozen=True, kw_only=True)
class RenderCommand:
    """Render ground truth for every labelled frame into SCENE/gt.

    Writes z-depth, instance mask, NOCS map and surface normals per frame, and the visible fraction
    and bounding boxes per object. Frames that are complete and whose inputs did not change are
    kept.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    options: RenderOptions = field(default_factory=RenderOptions)
    frames: tuple[str, ...] | None = None
    """file names, names or ids of the frames to render (default: all labelled frames)"""
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class CheckCommand:
    """Compare the labels of a scene with its images and depth.

    Writes check/report.html, report.json, report.csv and frames.csv, and the verdict on each label
    into labels.json. Exit status 1 if a label is wrong or doubtful, or a gate of the scene fails.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    options: CheckOptions = field(default_factory=CheckOptions)
    json: bool = False
    """print the report as JSON"""
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class ExportCommand:
    """Write every frame with ground truth in the layout of STD, BOP or NOCS.

    The file std_toolkit.json holds what the layout cannot: camera poses, intrinsics, object poses,
    the source of the metric scale and the verdicts on the labels. A scene with a wrong label, or
    whose check failed, is refused.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    format: str = field(metadata={"option": "format"})
    """std, bop, nocs or a plug-in"""
    # Its staging area takes an earlier export, too, to go on or to replace it.
    out: Path = field(metadata={"option": "out", "writes": Writes("place")})
    """new output folder"""
    options: ExportOptions = field(default_factory=ExportOptions)
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class RunBasics:
    """What `std-curate run` and `std-curate project run` share."""

    refine: bool = True
    """refinement: propagate the annotated poses unchanged"""
    refine_scale: bool = False
    """correct the scale of the camera poses from the known sizes of the objects"""
    poses: PoseBasics = field(default_factory=PoseBasics)
    render: RenderBasics = field(default_factory=RenderBasics)
    jobs: JobOptions = field(default_factory=JobOptions)


@dataclass(frozen=True, kw_only=True)
class RunCommand(RunBasics):
    """Run poses, propagate --refine, render and check on a scene with labelled objects.

    Completed steps and frames are kept, outdated ones are repeated. Run the command again after an
    interruption. Imported camera poses are kept. The exit status is that of the worst step; see
    `std-curate check`.
    """

    scene: Path = field(metadata={"writes": Writes("scene")})
    """scene folder"""
    check: CheckBasics = field(default_factory=CheckBasics)


@dataclass(frozen=True, kw_only=True)
class SchemaCommand:
    """Print the JSON Schema of one document, write all schemas, or list the documents."""

    document: str | None = field(default=None, metadata={"option": ""})
    """name of a document, such as scene or poses"""
    out: Path | None = field(default=None, metadata={"writes": Writes("parts")})
    """write all schemas to this folder"""


@dataclass(frozen=True, kw_only=True)
class SettingsCommand:
    """Print the limits that decide what is accepted, as a file for `--settings`."""

    group: str = field(default="", metadata={"option": ""})
    """name of a group or of several, such as checks.gates (default: all)"""
