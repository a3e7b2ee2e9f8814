"""What an importer is: it reads a foreign layout and says what the scene will hold.

An importer writes nothing. It returns a `Recording`; one writer (`writer.py`) makes the scene of
it, so that checks of images, conversions of depth and atomicity are the same for every format.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from std_toolkit import errors, options, plugins
from std_toolkit.scene.model import CameraModel, CameraPoses, Labels, Model, Object

if TYPE_CHECKING:
    import trimesh

FileKind = Literal["color", "depth", "mask", "map"]


@dataclass(frozen=True, kw_only=True)
class SourceFile:
    """One file to bring into the scene.

    Attributes:
        source: the foreign file.
        target: path in the scene without suffix; the writer adds the one of what it writes.
        kind: "color" and "depth" must have the camera's size; "mask" holds ids (or 0/255), whose
            `background` becomes 0; "map" is a PNG or EXR kept as it is.
        depth_scale: metres per unit if it is a 16-bit PNG.
        background: of a mask.
        same_size: the file must have the camera's size.
        binary: a mask of 0 and anything else, which becomes id 1.
        resize: a colour image is brought to the camera's size by averaging areas.
    """

    source: Path
    target: str
    kind: FileKind
    depth_scale: float | None = None
    background: int | None = None
    same_size: bool = True
    binary: bool = False
    resize: bool = False


@dataclass(frozen=True, kw_only=True)
class SourceFrame:
    """One frame: its colour, its sensor depth if any, and maps that came with it.

    Attributes:
        id: of the frame in the scene.
        name: safe and unique.
        reference: ground truth of the foreign recording, kept below `reference/`.
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
    """A mesh to bring into the scene.

    Attributes:
        model: its table row; the mesh path inside it is where it will be written.
        mesh: vertices in metres, in the frame that the labels refer to.
    """

    model: Model
    mesh: trimesh.Trimesh


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Everything an importer found.

    Attributes:
        source: format name for `SceneInfo.source`.
        depth_scale: metres per unit of 16-bit depth in the scene; None if all depth is EXR.
    """

    source: str
    cameras: dict[str, CameraModel]
    frames: tuple[SourceFrame, ...]
    depth_scale: float | None = None
    depth_correction: float = 1.0
    models: tuple[SourceModel, ...] = ()
    objects: tuple[Object, ...] = ()
    poses: CameraPoses | None = None
    labels: Labels | None = None
    notes: list[str] = field(default_factory=list)


class Importer(Protocol):
    """Reads one foreign format."""

    def recognises(self, source: Path) -> bool:
        """Whether `source` is unmistakably of this format. Looks at names only."""
        ...

    def read(self, request: options.ImportRequest) -> Recording:
        """Find and check what the recording holds.

        Raises:
            ToolkitError: it is incomplete or breaks its format.
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
        "cleargrasp": "std_toolkit.importers.cleargrasp_importer:CLEARGRASP",
    },
)


def detect_format(source: Path) -> str:
    """The one format whose marks `source` bears.

    Raises:
        ToolkitError: none or several recognise it.
    """
    if not source.exists():
        raise errors.ToolkitError("no such file or folder", path=source)
    found = [name for name in IMPORTERS if IMPORTERS.get(name).recognises(source)]
    if len(found) == 1:
        return found[0]
    raise errors.ToolkitError(
        "cannot tell the format of the recording" if not found else "several formats fit",
        path=source,
        value=found or None,
        hint=f"give --format ({', '.join(IMPORTERS)}); colour images: --color DIR --intrinsics K",
    )
