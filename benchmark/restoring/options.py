"""Options of `std-restore`; the module imports no heavy package."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from std_toolkit.errors import ToolkitError, check_options
from std_toolkit.importers.options import ImageOptions
from std_toolkit.jobs.door import Writes
from std_toolkit.options import JobOptions

Backend = Literal["auto", "onnx", "torch"]
Where = Literal["everywhere", "glass", "glass-and-holes"]
DepthFormat = Literal["same", "png", "exr"]


@dataclass(frozen=True, kw_only=True)
class MethodChoice:
    """A depth restorer and how it is run."""

    method: str = "swindrnet"
    """a name of `std-bench list methods`, package.module:Class, or file.py:Class"""
    preset: str | None = None
    """network size: published or compact (compact if its weights ship and no --weights is given,
    else published)"""
    weights: Path | None = None
    """file of trained weights: .safetensors, or .onnx of `std-restore export`"""
    settings: tuple[str, ...] = field(default=(), metadata={"option": "set"})
    """NAME=VALUE, the method's own settings"""
    size: tuple[int, int] | None = field(default=None, metadata={"size": True})
    """image size that the network works at (default: its own)"""
    where: Where | None = None
    """where the method answers: everywhere; glass: only where glass or metal is found (by the
    method, or by compactdr), all else stays the sensor's, holes too; glass-and-holes: only where
    compactdr finds glass or metal and doubts the sensor, all else is compactdr's (default:
    glass-and-holes for swindrnet as it ships, else everywhere)"""
    max_error_m: Annotated[float, msgspec.Meta(gt=0)] | None = field(
        default=None, metadata={"option": "max-error", "factor": 1000}
    )
    """leave out (0) where the expected error is larger, millimetres; by default and of methods with
    a spread, such as compactdr"""

    @property
    def answers(self) -> Where:
        """Where the method answers, as given or by default."""
        return self.where or default_where(self.method, self.weights)


def default_where(method: str, weights: Path | str | None = None) -> Where:
    """Where a method answers unless that is stated; a user's own weights answer everywhere."""
    return "glass-and-holes" if method == "swindrnet" and weights is None else "everywhere"


@dataclass(frozen=True, kw_only=True)
class RestoreOptions:
    """Restore the depth of recordings at the camera's own size.

    SOURCES are folders: a scene of std-curate, a folder with color/ and depth/,
    or a data set that `std-curate import` reads; or recordings of ROS (rosbag2
    folder, .mcap, .db3, .bag) or librealsense (.bag, .db3). Without SOURCES, give
    images: --color and --depth, each one image, a folder or a quoted pattern. Of
    recordings of ROS with several cameras, --color and --depth name topics.
    """

    sources: tuple[Path, ...] = field(default=(), metadata={"option": ""})
    """folders or files of recordings"""
    out: Path = field(metadata={"option": "out", "writes": Writes("parts")})
    """folder of results; of several recordings, each has a folder in it"""
    choice: MethodChoice = field(default_factory=MethodChoice)
    device: str = "cpu"
    """cpu, cuda, or cuda:1"""
    backend: Backend = "auto"
    """what runs the network: onnx (onnxruntime), torch, or auto (onnxruntime where the toolkit has
    the graph, otherwise torch)"""
    images: ImageOptions = field(default_factory=ImageOptions)
    multi_view: bool = False
    """fuse glass and metal of all frames of scenes with camera poses (`std-curate poses`); by
    default and of methods with a spread and a mask, such as compactdr; single/ has the frames
    restored alone"""
    depth_format: DepthFormat = field(default="same", metadata={"option": "format"})
    """of restored depth: 16-bit PNG with the recording's unit, EXR in metres, or the same as the
    recording"""
    points: bool = False
    """write a coloured point cloud of every frame"""
    pictures: bool = False
    """write a picture of every frame: colour, raw and restored depth side by side"""
    video: Annotated[float, msgspec.Meta(gt=0, le=240)] | None = None
    """write video.mp4, colour, raw and restored depth side by side, at this number of frames per
    second"""
    json: bool = False
    """print the summary as JSON"""
    jobs: JobOptions = field(default_factory=JobOptions)

    def __post_init__(self) -> None:
        check_options(self)
        given = [bool(self.images.color), bool(self.images.depth)]
        if not self.sources and not all(given):
            raise ToolkitError(
                "needed", field="SOURCES", hint="or give images with --color and --depth"
            )
        scale, correction = self.images.depth_scale, self.images.depth_correction
        if scale is not None and not 0 < scale <= 1:
            raise ToolkitError(
                "must be metres per unit of the depth images, above 0 and at most 1",
                field="--depth-scale", value=scale, hint="millimetres: 0.001",
            )  # fmt: skip
        if not 0.8 < correction < 1.25:
            raise ToolkitError(
                "must be between 0.8 and 1.25", field="--depth-correction", value=correction
            )


@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """Restore the depth of a connected camera until Ctrl-C.

    The newest frame is always restored next; frames that arrive meanwhile are not
    restored. The preview shows colour, raw and restored depth, and the trust in the
    sensor.
    """

    camera: str = "realsense"
    """realsense, another registered camera, or file.py:Class"""
    serial: str | None = None
    """of the camera, if several are connected"""
    camera_size: tuple[int, int] = field(default=(640, 480), metadata={"size": True})
    """size of the camera's images"""
    fps: Annotated[int, msgspec.Meta(ge=1)] = 30
    """images per second of the camera"""
    web: int | None = None
    """port of a preview page for a browser on this machine"""
    token: str | None = None
    """secret that the preview page asks for, as ?token=... behind its address
    ($STD_PREVIEW_TOKEN, which other users of this computer cannot see)"""
    preview: Path | None = field(default=None, metadata={"writes": Writes("file")})
    """JPEG file that is replaced continuously"""
    out: Path | None = field(default=None, metadata={"writes": Writes("new")})
    """new folder that keeps the camera's images and what is restored"""
    frames: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """stop after this number of restored frames"""
    choice: MethodChoice = field(default_factory=MethodChoice)
    device: str = "cpu"
    """cpu, cuda, or cuda:1"""
    backend: Backend = "auto"
    """what runs the network: onnx, torch, or auto"""
    points: bool = False
    """with --out: a coloured point cloud of every frame"""
    pictures: bool = False
    """with --out: a picture of every frame"""

    def __post_init__(self) -> None:
        check_options(self)
        if self.web is None and self.preview is None and self.out is None:
            raise ToolkitError(
                "needed", field="--web", hint="or --preview FILE, or --out DIR: where it is shown"
            )


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Write a network as one ONNX file and compare it with torch.

    The file runs without torch: `std-restore ... --weights FILE.onnx`,
    `std-bench --method onnx --weights FILE.onnx`, or another program that reads
    ONNX.
    """

    out: Path = field(metadata={"option": "onnx", "writes": Writes("file")})
    """the file to write, FILE.onnx"""
    choice: MethodChoice = field(default_factory=MethodChoice)

    def __post_init__(self) -> None:
        check_options(self)
        if self.out.suffix != ".onnx":
            raise ToolkitError("must end in .onnx", field="--onnx", value=str(self.out))
