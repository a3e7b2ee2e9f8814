"""The infrared pair of an active stereo camera, for methods that match it themselves.

The pair lies beside the other images of a frame. Its calibration is `infrared.json`, in the folder
of the scene or one above it, or else in the records of `std-sim` and `std-record`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Protocol, runtime_checkable

import msgspec
import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.camera import Camera
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import read_png
from std_toolkit.scene.document import check_pose
from std_toolkit.scene.model import pose_from_list
from std_toolkit.scene.pose_model import CameraModel

CALIBRATION = "infrared.json"
_ABOVE = 4  # folders above a scene, as for records
_HINT = (
    f"write {CALIBRATION}: left (camera), baseline_m and T_color_left; data_spec.md describes it"
)

Image = NDArray[np.uint8]
_Baseline = Annotated[float, msgspec.Meta(gt=0, lt=1)]
_Pose = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class InfraredCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """infrared.json: a rectified pair.

    Attributes:
        left: intrinsics of both cameras, at any size of the images.
        baseline_m: from the left camera to the right one, along x.
        T_color_left: maps points of the left camera into the colour camera; 16 numbers, row-major.
    """

    left: CameraModel
    baseline_m: _Baseline
    T_color_left: _Pose


class _View(msgspec.Struct, frozen=True, kw_only=True):
    index: int
    T_world_cam: _Pose
    T_world_ir: _Pose


class _Simulated(msgspec.Struct, frozen=True, kw_only=True):
    """Part of the record of a scene of `std-sim`."""

    infrared_camera: CameraModel
    frames: list[_View]
    baseline_m: _Baseline | None = None


class _Recorded(msgspec.Struct, frozen=True, kw_only=True):
    """Part of recording.json of `std-record`."""

    T_color_depth: _Pose
    infrared: CameraModel | None = None
    baseline_m: _Baseline | None = None


@dataclass(frozen=True, eq=False)
class InfraredPair:
    """Two rectified infrared images: a point is in the same row of both.

    Attributes:
        left, right: (H, W) uint8.
        camera: intrinsics of both at this size.
        baseline_m: from the left camera to the right one, along x.
        T_color_left: maps points of the left camera into the colour camera.
    """

    left: Image
    right: Image
    camera: Camera
    baseline_m: float
    T_color_left: SE3


@runtime_checkable
class InfraredSource(Protocol):
    """A source of frames that may have an infrared pair."""

    def infrared(self, index: int) -> InfraredPair:
        """Read the infrared pair of a frame.

        Raises:
            ToolkitError: as `read_infrared`.
        """
        ...

    def infrared_files(self, index: int) -> dict[str, Path]:
        """Return the files that `infrared` reads, by content."""
        ...


def pair_files(folder: Path, name: str) -> tuple[Path, Path]:
    """Left and right image of a frame, whether or not they exist.

    Args:
        folder: of the scene: in a layout of DREDS, or of the toolkit.
        name: of the frame.
    """
    for left, right in (
        (folder / "infrared/left", folder / "infrared/right"),
        (folder / "reference/infrared_left", folder / "reference/infrared_right"),
    ):
        if left.is_dir():
            return left / f"{name}.png", right / f"{name}.png"
    return folder / f"{name}_ir_l.png", folder / f"{name}_ir_r.png"


def calibration_file(folder: Path, record: Path | None = None) -> Path | None:
    """The file that a scene's calibration is read from; None if there is none.

    Args:
        folder: of the scene.
        record: that `std-sim` wrote for it elsewhere.
    """
    return next((path for path in _places(folder, record) if path.is_file()), None)


def _places(folder: Path, record: Path | None) -> Iterator[Path]:
    place = folder.resolve()
    for top in (place, *list(place.parents)[:_ABOVE]):
        yield top / CALIBRATION
    if record is not None:
        yield record
    yield folder / ".std/simulation.json"
    yield folder / "recording.json"


def infrared_inputs(folder: Path, name: str, record: Path | None = None) -> dict[str, Path]:
    """The files that `read_infrared` reads, by content."""
    left, right = pair_files(folder, name)
    found = {"left infrared image": left, "right infrared image": right}
    calibration = calibration_file(folder, record)
    return found if calibration is None else found | {"infrared calibration": calibration}


def read_infrared(folder: Path, name: str, index: int, record: Path | None = None) -> InfraredPair:
    """Read the infrared pair of a frame.

    Args:
        folder: of the scene.
        name: of the frame.
        index: of the frame in the record of `std-sim`.
        record: as in `calibration_file`.

    Raises:
        ToolkitError: an image or the calibration is missing or damaged, or they do not fit.
    """
    left_path, right_path = pair_files(folder, name)
    for path in (left_path, right_path):
        if not path.is_file():
            raise ToolkitError("the frame has no infrared pair: no such file", path=path)
    told = calibration_file(folder, record)
    if told is None:
        problem = "nothing tells the cameras of the infrared pair"
        raise ToolkitError(problem, path=folder, hint=_HINT)
    return read_pair(left_path, right_path, _calibration(told, index), told)


def read_pair(
    left_path: Path, right_path: Path, known: InfraredCalibration, told: Path
) -> InfraredPair:
    """Read two images of a known pair.

    Args:
        left_path, right_path: grey images.
        known: their calibration.
        told: file or folder that the calibration is of, for errors.

    Raises:
        ToolkitError: an image is missing or damaged, or they do not fit.
    """
    left, right = _grey(left_path), _grey(right_path)
    if left.shape != right.shape:
        raise ToolkitError("the infrared images differ in size", path=right_path,
                           value=f"{right.shape[1]}x{right.shape[0]}")  # fmt: skip
    size = (left.shape[1], left.shape[0])
    camera = known.left.camera()
    if camera.width * size[1] != camera.height * size[0]:
        raise ToolkitError(
            f"has other proportions than its camera, {camera.width}x{camera.height}",
            path=left_path, value=f"{size[0]}x{size[1]}",
        )  # fmt: skip
    camera = camera if camera.size == size else camera.resized(*size)
    with located(told, "T_color_left"):
        check_pose(known.T_color_left, "T_color_left")
        pose = pose_from_list(known.T_color_left)
    return InfraredPair(left, right, camera, known.baseline_m, pose)


def _calibration(path: Path, index: int) -> InfraredCalibration:
    if path.name == CALIBRATION:
        return read_document(path, InfraredCalibration)
    if path.name == "recording.json":
        recorded = read_document(path, _Recorded)
        camera, baseline, pose = recorded.infrared, recorded.baseline_m, recorded.T_color_depth
    else:
        simulated = read_document(path, _Simulated)
        camera, baseline = simulated.infrared_camera, simulated.baseline_m
        view = next((v for v in simulated.frames if v.index == index), None)
        if view is None:
            raise ToolkitError("the record has no such frame", path=path, value=index)
        cam, left = pose_from_list(view.T_world_cam), pose_from_list(view.T_world_ir)
        pose = (cam.inverse() @ left).flat()
    if camera is None or baseline is None:
        raise ToolkitError("the record does not tell the infrared pair", path=path,
                           field="baseline_m", hint=_HINT)  # fmt: skip
    return InfraredCalibration(left=camera, baseline_m=baseline, T_color_left=pose)


def _grey(path: Path) -> Image:
    image = read_png(path)
    if image.ndim == 3 and (image == image[..., :1]).all():
        image = np.ascontiguousarray(image[..., 0])
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ToolkitError("an infrared image is 8-bit grey", path=path,
                           value=f"{image.dtype} {image.shape}")  # fmt: skip
    return image  # type: ignore[return-value]
