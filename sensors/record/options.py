"""Options of `std-record`; they import nothing heavy."""

import os
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from std_toolkit.errors import CheckedOptions, ToolkitError, check_options
from std_toolkit.jobs.door import Writes

Count = Annotated[int, msgspec.Meta(ge=1)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
ColorFormat = Literal["jpg", "png"]

_SIZE = {"size": True}
_THREADS = min(8, os.cpu_count() or 2)
_OFF: dict[str, Any] = {"option": None}


@dataclass(frozen=True)
class StreamRequest(CheckedOptions):
    """Streams of a camera; sizes are (width, height)."""

    color: tuple[int, int] = field(default=(1280, 720), metadata=_SIZE)
    """size of colour images"""
    depth: tuple[int, int] = field(default=(1280, 720), metadata=_SIZE)
    """size of depth images"""
    fps: Count = 30
    """frames per second"""
    infrared: bool = field(default=False, metadata=_OFF)
    """infrared images too"""


@dataclass(frozen=True)
class CameraSettings:
    """What is set before recording; None leaves the camera as it is."""

    exposure: float | str | None = None
    """of colour: auto, lock (automatic until recording starts, then fixed), or milliseconds"""
    white_balance: float | str | None = None
    """auto, lock, or kelvins"""
    gain: float | None = None
    """of colour"""
    infrared_exposure: float | str | None = None
    """of depth: auto, or milliseconds"""
    laser: float | str | None = None
    """projector of the dots: off, on (the preset's power), max, or milliwatts"""
    preset: str | None = None
    """of the depth camera: high-accuracy, high-density, hand, default"""

    def __post_init__(self) -> None:
        for name, words in (
            ("exposure", ("auto", "lock")),
            ("white_balance", ("auto", "lock")),
            ("infrared_exposure", ("auto",)),
            ("laser", ("off", "on", "max")),
        ):
            value = getattr(self, name)
            if value in (None, *words):
                continue
            if isinstance(value, str) or not (value > 0 and isfinite(value)):
                problem = f"expected {', '.join(words)} or a number above 0"
                raise ToolkitError(problem, field=name, value=value)


@dataclass(frozen=True)
class FileOptions(CheckedOptions):
    """How frames become files."""

    color_format: ColorFormat = "jpg"
    """of colour images; png takes ten times as long"""
    quality: Annotated[int, msgspec.Meta(ge=50, le=100)] = 95
    """of jpg"""
    infrared: bool = False
    """keep both infrared images in reference/"""
    raw_depth: bool = False
    """keep unaligned depth in reference/"""

    @property
    def kept(self) -> list[str]:
        """Kinds of maps in `reference/`."""
        infrared = ["infrared_left", "infrared_right"] if self.infrared else []
        return infrared + (["depth_raw"] if self.raw_depth else [])


@dataclass(frozen=True)
class WriterOptions(CheckedOptions):
    """How frames are queued and written."""

    files: FileOptions = field(default_factory=FileOptions)
    threads: Count = _THREADS
    """number of threads that align and encode"""
    queue: Count = 48
    """frames that may wait to be written; 6.4 MB each at 1280x720"""
    keep_free_gb: Positive = field(default=1.0, metadata={"option": "keep-free"})
    """recording ends before the disk has fewer gigabytes left"""
    resume: bool = False
    """add frames to the existing scene"""

    @property
    def keep_free_bytes(self) -> int:
        return int(self.keep_free_gb * 1e9)


@dataclass(frozen=True)
class SessionOptions:
    """Which frames are recorded."""

    name: str = ""
    """of the scene (that of its folder)"""
    frames: Count | None = None
    """stop after this number of frames"""
    seconds: Positive | None = None
    """stop after this time"""
    every: Count = 1
    """keep each n-th set of images"""
    warm_up: int | None = None
    """sets of images left out at the start while exposure settles (30; of a file 0)"""
    sensor: str | None = None
    """specification that the camera should fit (its model's)"""
    writer: WriterOptions = field(default_factory=WriterOptions)

    def __post_init__(self) -> None:
        check_options(self)
        if self.seconds is not None and not isfinite(self.seconds):
            raise ToolkitError("must be finite", field="seconds", value=self.seconds)


@dataclass(frozen=True, kw_only=True)
class RecordCommand:
    """Record a scene with a RealSense camera, or from a file of librealsense or ROS.

    Ctrl-C ends a recording; what was finished is a scene at any time.
    """

    scene: Path | None = field(default=None, metadata={"option": "", "writes": Writes("scene")})
    """folder of the new scene"""
    file: str | None = field(default=None, metadata={"option": "from"})
    """read a .bag or .db3 file of librealsense, or a recording of ROS (rosbag2 folder, .mcap, .db3,
    .bag)"""
    recover: bool = False
    """only restore all finished frames of a recording that was killed"""
    list: bool = False
    """show connected cameras and exit"""
    json: bool = False
    """with --list: print JSON"""
    serial: str | None = None
    """of the camera, if several are connected"""
    align: Literal["toolkit", "librealsense"] = "toolkit"
    """software that aligns depth to the colour image"""
    preview: Path | None = field(default=None, metadata={"writes": Writes("file")})
    """JPEG file that is replaced continuously"""
    web: int | None = None
    """port of a preview page for a browser on this machine"""
    token: str | None = None
    """secret that the preview page asks for, as ?token=... behind its address
    ($STD_PREVIEW_TOKEN, which other users of this computer cannot see)"""
    wait: bool = False
    """only show the preview until Enter is pressed"""
    session: SessionOptions = field(default_factory=SessionOptions)
    streams: StreamRequest = field(default_factory=StreamRequest)
    settings: CameraSettings = field(default_factory=CameraSettings)

    def __post_init__(self) -> None:
        if self.scene is None and not self.list:
            raise ToolkitError("SCENE: needed")
