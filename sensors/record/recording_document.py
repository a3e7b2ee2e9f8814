"""Contents of a recording: captured frames, the device and its calibration, recording.json."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document, write_document
from std_toolkit.scene.document import (
    Count,
    Document,
    NonNegative,
    Pose16,
    Positive,
    check_pose,
    pose_from_list,
)
from std_toolkit.scene.model import CameraModel

AlignedBy = Literal["toolkit", "librealsense"]

Image8 = NDArray[np.uint8]

Units = NDArray[np.uint16]


class Device(Document, frozen=True, kw_only=True):
    """Information reported by the device; empty if it reports none."""

    name: str = ""
    serial: str = ""
    firmware: str = ""
    product_line: str = ""
    usb: str = ""


class Session(Document, frozen=True, kw_only=True):
    """One run of std-record.

    Attributes:
        version: of the toolkit.
        source: "camera", or the name of the file that was read.
        first_frame: id.
        ended: false while recording, and permanently if it was killed.
        frames: number written.
        seconds: time between the first and the last frame.
        dropped: sets of images dropped because the writer was too slow.
        lost: images that the camera counted but that never arrived, by stream.
        single: images without a partner in the other streams, by stream.
        settings: of the camera, as they were set.
    """

    version: str
    source: str
    first_frame: Count
    ended: bool = False
    frames: Count = 0
    seconds: NonNegative = 0.0
    dropped: Count = 0
    lost: dict[str, Count] = msgspec.field(default_factory=dict)
    single: dict[str, Count] = msgspec.field(default_factory=dict)
    settings: dict[str, str] = msgspec.field(default_factory=dict)

    def summary(self, scene: Path) -> str:
        """What was recorded, what was lost, and the next command, in lines."""
        lost = max(self.lost.values(), default=0)
        single = sum(self.single.values())
        lines = [
            f"{self.frames} frames in {self.seconds:.1f} s written to {scene}",
            f"dropped: {self.dropped} because writing was behind, {lost} lost before they arrived, "
            f"{single} images without a partner",
        ]
        if self.dropped:
            lines.append(
                "to drop none: more --threads, --color-format jpg, a lower --fps, a faster disk"
            )
        return "\n".join([*lines, f"next: std-curate poses {shlex.quote(str(scene))}"])


class RecordingDocument(Document, frozen=True, kw_only=True):
    """recording.json.

    Attributes:
        color, depth, infrared: intrinsics of the streams; infrared only if it is kept.
        T_color_depth: depth's frame, the left infrared camera's, into the colour camera's.
        depth_unit_m: metres per unit of the camera's depth image.
        baseline_m: from the left infrared camera to the right one, or null.
        aligned_by: software that aligned depth to colour.
        kept: kinds of maps in `reference/`: infrared_left, infrared_right, depth_raw.
        notes: conversions, and deviations of the camera from its specification.
    """

    format: Literal["std-recording"] = "std-recording"
    version: Literal[1] = 1
    device: Device
    color: CameraModel
    depth: CameraModel
    infrared: CameraModel | None = None
    T_color_depth: Pose16
    depth_unit_m: Positive
    baseline_m: Positive | None = None
    aligned_by: AlignedBy
    kept: list[str] = msgspec.field(default_factory=list)
    notes: list[str] = msgspec.field(default_factory=list)
    sessions: list[Session] = msgspec.field(default_factory=list)

    def check(self) -> None:
        check_pose(self.T_color_depth, "T_color_depth")

    def calibration(self) -> Calibration:
        return Calibration(
            color=self.color,
            depth=self.depth,
            T_color_depth=pose_from_list(self.T_color_depth),
            depth_unit_m=self.depth_unit_m,
            baseline_m=self.baseline_m,
            infrared=self.infrared,
        )


def recording_path(scene: Path) -> Path:
    return scene / "recording.json"


def read_recording(scene: Path) -> RecordingDocument:
    """The camera data of a recorded scene.

    Raises:
        ToolkitError: the scene was not recorded by std-record, or the document is damaged.
    """
    return read_document(recording_path(scene), RecordingDocument)


def write_recording(scene: Path, document: RecordingDocument) -> None:
    write_document(recording_path(scene), document)


def device_document(info: DeviceInfo) -> Device:
    return Device(
        name=info.name,
        serial=info.serial,
        firmware=info.firmware,
        product_line=info.product_line,
        usb=info.usb,
    )


@dataclass(frozen=True)
class DeviceInfo:
    """Identity of the device; empty fields if it reports none."""

    name: str = ""
    serial: str = ""
    firmware: str = ""
    product_line: str = ""
    usb: str = ""


@dataclass(frozen=True)
class Calibration:
    """Calibration stored in the camera.

    Attributes:
        color, depth: intrinsics of the two streams as they are recorded.
        T_color_depth: depth's frame (the left infrared camera's) into the colour camera's.
        depth_unit_m: metres per unit of the depth image.
        baseline_m: from the left infrared camera to the right one, or None.
        infrared: intrinsics of the infrared streams, or None if they are not recorded.
        notes: conversions, as text for the user.
    """

    color: CameraModel
    depth: CameraModel
    T_color_depth: SE3
    depth_unit_m: float
    baseline_m: float | None = None
    infrared: CameraModel | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class CapturedFrame:
    """Images taken at one time.

    Attributes:
        color: (H, W, 3) RGB.
        depth: (h, w) units, 0 = none, in the depth camera.
        aligned: (H, W) units in the colour camera, if the camera's software aligned it.
        infrared: left and right (h, w), if recorded.
        timestamp: of colour, seconds.
        exposure_s: of colour, or None if the camera does not report it.
    """

    color: Image8
    depth: Units
    timestamp: float
    aligned: Units | None = None
    infrared: dict[str, Image8] = field(default_factory=dict)
    exposure_s: float | None = None
