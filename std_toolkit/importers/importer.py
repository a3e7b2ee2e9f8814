"""Protocol of importers, which read a foreign layout and describe the scene to create.

An importer writes nothing. It returns a `Recording`, from which `import_step.py` writes the scene,
so that image checks, depth conversion and atomicity are the same for every format.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from std_toolkit import errors, plugins
from std_toolkit.geometry.mesh import OTHER_MESHES, UNREAD_MESHES
from std_toolkit.importers.bop_packed import packed_split
from std_toolkit.importers.depth_survey import UnitOrigin
from std_toolkit.importers.foreign_files import is_ros_recording
from std_toolkit.importers.options import ImportRequest
from std_toolkit.scene.model import CameraPoses, Labels, Model, Object

if TYPE_CHECKING:
    import trimesh

    from std_toolkit.geometry.camera import Camera

FileKind = Literal["color", "depth", "mask", "map"]


@dataclass(frozen=True, kw_only=True)
class SourceFile:
    """One file to add to the scene.

    Attributes:
        source: the foreign file.
        target: path in the scene without suffix; the writer adds the suffix.
        kind: "color" and "depth" must have the camera's size; "mask" contains ids (or 0/255),
            whose `background` becomes 0; "map" is a PNG or EXR that is copied unchanged.
        depth_scale: metres per unit of a 16-bit PNG.
        background: background value of a mask.
        same_size: whether the file must have the camera's size.
        binary: whether every nonzero value of a mask becomes id 1.
        resize: whether a colour image is resized to the camera's size by area averaging.
        two_bytes: whether a depth PNG may have its high and low bytes in green and red.
    """

    source: Path
    target: str
    kind: FileKind
    depth_scale: float | None = None
    background: int | None = None
    same_size: bool = True
    binary: bool = False
    resize: bool = False
    two_bytes: bool = False


@dataclass(frozen=True, kw_only=True)
class SourceFrame:
    """One frame: its colour, its sensor depth if any, and further maps of the recording.

    Attributes:
        id: id of the frame in the scene.
        name: safe and unique name.
        reference: ground truth of the foreign recording, kept in `reference/`.
    """

    id: int
    name: str
    color: SourceFile
    depth: SourceFile | None = None
    camera: str = "color"
    timestamp: float | None = None
    reference: tuple[SourceFile, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SourceModel:
    """A mesh to add to the scene.

    Attributes:
        model: its table row, with the mesh path to write.
        mesh: vertices in metres, in the frame of the labels.
    """

    model: Model
    mesh: trimesh.Trimesh


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Everything an importer found.

    Attributes:
        source: format name for `SceneInfo.source`.
        cameras: of the images as recorded; those of lenses that a scene does not keep are
            undistorted by the writer.
        depth_scale: metres per unit of 16-bit depth in the scene; None if all depth is EXR.
        unit_origin: who states the unit of depth.
        depth_name: what the depth images are called in messages; their folder if empty.
    """

    source: str
    cameras: dict[str, Camera]
    frames: tuple[SourceFrame, ...]
    depth_scale: float | None = None
    depth_correction: float = 1.0
    unit_origin: UnitOrigin = "format"
    depth_name: str = ""
    models: tuple[SourceModel, ...] = ()
    objects: tuple[Object, ...] = ()
    poses: CameraPoses | None = None
    labels: Labels | None = None
    notes: list[str] = field(default_factory=list)


class Importer(Protocol):
    """Reads one foreign format."""

    def recognises(self, source: Path) -> bool:
        """Whether `source` is certainly of this format, from file names only."""
        ...

    def read(self, request: ImportRequest) -> Recording:
        """Find and check the contents of the recording.

        Images that are not files of their own are written to `request.workspace`.

        Raises:
            ToolkitError: it is incomplete or violates its format.
        """
        ...


IMPORTERS: plugins.Registry[Importer] = plugins.Registry(
    "std_toolkit.importers",
    {
        "folder": "std_toolkit.importers.folder_importer:FOLDER",
        "std": "std_toolkit.importers.std_importer:STD",
        "dreds": "std_toolkit.importers.std_importer:DREDS",
        "bop": "std_toolkit.importers.bop_importer:BOP",
        "nocs": "std_toolkit.importers.nocs_importer:NOCS",
        "ros": "std_toolkit.importers.ros_importer:ROS",
        "cleargrasp": "std_toolkit.importers.cleargrasp_importer:CLEARGRASP",
    },
)


def read_recording(name: str, request: ImportRequest) -> Recording:
    """What the importer of a format reads.

    Raises:
        ToolkitError: as `Importer.read`; an error of a plug-in names its file.
    """
    reader = IMPORTERS.get(name)
    try:
        recording = reader.read(request)
        if not isinstance(recording, Recording):
            raise TypeError(f"`read` returned {type(recording).__name__}, not a Recording")
    except errors.ToolkitError:
        raise
    except Exception as error:
        raise _of_plugin(name, reader, error) from error
    return recording


def _of_plugin(name: str, reader: Importer, error: Exception) -> Exception:
    """The error of a plug-in in one line; that of an importer of the toolkit as it is."""
    if type(reader).__module__.startswith("std_toolkit."):
        return error
    try:
        file = inspect.getfile(type(reader))
    except (OSError, TypeError):
        file = name
    return errors.ToolkitError(
        f"the importer {name} failed: {type(error).__name__}: {error}",
        path=file,
        hint="an error of this plug-in; --debug prints the traceback",
    )


def _recognises(name: str, source: Path) -> bool:
    reader = IMPORTERS.get(name)
    try:
        return bool(reader.recognises(source))
    except errors.ToolkitError:
        raise
    except Exception as error:
        raise _of_plugin(name, reader, error) from error


def needs_workspace(name: str, source: Path) -> bool:
    """Whether the images of a recording are not files of their own.

    Args:
        name: of the importer.
        source: of the recording.
    """
    return name == "ros" or (name == "bop" and packed_split(source) is not None)


def format_of(request: ImportRequest) -> str:
    """The importer of a request without --format: "folder" for separate images.

    Raises:
        ToolkitError: as `detect_format`.
    """
    if request.color is not None and not is_ros_recording(request.source):
        return "folder"
    return detect_format(request.source)


_CONVERT: dict[str, str] = {
    **dict.fromkeys(
        (".mkv", ".svo", ".svo2", ".oni"),
        "write it as a rosbag2, or as folders of colour and of aligned depth (16-bit PNG), with "
        "the camera's own tools (Azure Kinect: Open3D's azure_kinect_mkv_reader.py); import these",
    ),
    **dict.fromkeys(
        (".mp4", ".mov", ".avi", ".webm", ".m4v"),
        "a video has no depth: std-scan takes it as photos; for an import give folders of images",
    ),
    **dict.fromkeys(UNREAD_MESHES, OTHER_MESHES),
}


def refuse_other_programs(source: Path) -> None:
    """Tell what to do with a file that other programs write and no importer reads.

    Raises:
        ToolkitError: it is a recording of the Azure Kinect or ZED, a video, or a mesh in another
            format.
    """
    hint = _CONVERT.get(source.suffix.lower())
    if hint is not None and source.is_file():
        raise errors.ToolkitError(
            f"{source.suffix.lower()} files are not read", path=source, hint=hint
        )


def detect_format(source: Path) -> str:
    """Detect the format of `source`.

    Raises:
        ToolkitError: no importer or several recognise it.
    """
    if not source.exists() and packed_split(source) is None:
        raise errors.ToolkitError("no such file or folder", path=source)
    refuse_other_programs(source)
    found = [name for name in IMPORTERS if _recognises(name, source)]
    if len(found) > 1 and "folder" in found:  # other formats, too, have folders of images
        found.remove("folder")
    if len(found) == 1:
        return found[0]
    raise errors.ToolkitError(
        "cannot detect the format of the recording" if not found else "several formats match",
        path=source,
        value=found or None,
        hint=f"give --format ({', '.join(IMPORTERS)}); colour images: --color DIR --intrinsics K",
    )
