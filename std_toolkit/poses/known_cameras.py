"""Known camera poses and their convention."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import digest_of
from std_toolkit.log import logger
from std_toolkit.options import KnownCameras
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.camera_table import FiledCameras
from std_toolkit.poses.frame_matching import match_frames
from std_toolkit.poses.hand_eye import read_transform
from std_toolkit.poses.pose_columns import FiledOrder, QuaternionOrder
from std_toolkit.scene import Frame

_UNITS_IN_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "unknown": 1.0}
# OpenGL camera axes (x right, y up, z backward) to OpenCV's.
_CV_FROM_GL = SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
_Y_UP = np.diag([1.0, -1.0, 1.0])
_AXES = {"": "OpenCV", "opengl": "OpenGL", "unity": "Unity"}


@dataclass(frozen=True, kw_only=True)
class Convention:
    """How filed poses become T_world_cam.

    Attributes:
        direction: "camera-to-world" or "world-to-camera"; with a hand-eye transform, of the
            flange instead of the camera.
        axes: of the camera: "" for OpenCV's, "opengl" for x right, y up, z backward, or
            "unity" for x right, y up, z forward (POV-Ray, too), where y of the world is
            turned over too.
        unit: unit of the positions.
        hand_eye: T_flange_cam, metres.
        hand_eye_inverted: whether `hand_eye` is T_cam_flange instead.
        hand_eye_factor: further factor of its translation.
        quaternion: order of the four numbers of a quaternion, if another than `FiledCameras`
            took them to have.
    """

    direction: str = "camera-to-world"
    axes: str = ""
    unit: str = "m"
    hand_eye: SE3 | None = None
    hand_eye_inverted: bool = False
    hand_eye_factor: float = 1.0
    quaternion: QuaternionOrder | None = None

    @property
    def title(self) -> str:
        """What is read, in words."""
        axes = _AXES[self.axes]
        title = f"{self.direction} in {axes} axes"
        if self.hand_eye is not None:
            to_base = self.direction == "camera-to-world"
            title = f"{'flange-to-base' if to_base else 'base-to-flange'}, camera in {axes} axes"
        if self.hand_eye_inverted:
            title += ", with the inverse hand-eye transform"
        if self.hand_eye_factor != 1:
            title += ", with another unit of the hand-eye transform or of the log"
        if self.quaternion is not None:
            title += f", with the quaternion as {' '.join(f'q{c}' for c in self.quaternion)}"
        return title

    @property
    def option(self) -> str:
        return "-".join(filter(None, (self.direction, self.axes)))

    def apply(self, matrices: NDArray[np.float64]) -> list[SE3]:
        """Return T_world_cam in metres (or the unknown unit) of filed matrices (N, 4, 4)."""
        factor = _UNITS_IN_M[self.unit]
        poses = [SE3(M[:3, :3], M[:3, 3] * factor) for M in matrices]
        if self.quaternion is not None:
            poses = [_reordered(T, self.quaternion) for T in poses]
        if self.direction == "world-to-camera":
            poses = [T.inverse() for T in poses]
        if self.hand_eye is not None:
            hand_eye = SE3(self.hand_eye.R, self.hand_eye.t * self.hand_eye_factor)
            hand_eye = hand_eye.inverse() if self.hand_eye_inverted else hand_eye
            poses = [T @ hand_eye for T in poses]
        if self.axes == "unity":
            return [SE3(_Y_UP @ T.R @ _Y_UP, _Y_UP @ T.t) for T in poses]
        return [T @ _CV_FROM_GL for T in poses] if self.axes else poses

    def alternatives(self, filed: FiledOrder | None) -> list[tuple[Convention, str]]:
        """Other conventions in use, with the advice that selects each.

        Args:
            filed: the order as which quaternions were read, where the file does not name it.
        """
        found = []
        for direction in ("camera-to-world", "world-to-camera"):
            for axes in _AXES:
                other = replace(self, direction=direction, axes=axes)
                found.append((other, f"use --cameras-convention {other.option}"))
        if self.hand_eye is not None:
            inverted = [
                (replace(c, hand_eye_inverted=True), f"{advice} and invert the hand-eye transform")
                for c, advice in found
            ]
            found += inverted
            for factor, unit in ((1000.0, "mm"), (0.001, "m")):
                found += [
                    (
                        replace(c, hand_eye_factor=factor),
                        f"{advice} and --cameras-unit {unit}, or the matching --hand-eye-unit",
                    )
                    for c, advice in found[: 2 * len(_AXES)]
                ]
        if filed is not None:
            swapped: QuaternionOrder = "xyzw" if filed.order == "wxyz" else "wxyz"
            turned = None if self.quaternion == swapped else swapped
            found += [
                (
                    replace(c, quaternion=turned),
                    f"use --cameras-quaternion {turned or filed.order}"
                    + ("" if c.option == self.option else advice.removeprefix("use")),
                )
                for c, advice in found[: 2 * len(_AXES)]
            ]
        return [(c, advice) for c, advice in found if c != self]


def _reordered(T: SE3, order: QuaternionOrder) -> SE3:
    """The pose whose quaternion was filed in an order, and was read as if in the other."""
    w, x, y, z = T.quat()
    return SE3.from_quat([x, y, z, w] if order == "wxyz" else [z, w, x, y], T.t)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownPoses:
    """Filed poses of the frames of a scene.

    Attributes:
        filed: the file.
        row: row of `filed.matrices` by frame id; frames without a pose are missing.
        convention: how they are read.
        options: options of the user.
    """

    filed: FiledCameras
    row: dict[int, int]
    convention: Convention
    options: KnownCameras

    def poses(self, convention: Convention | None = None) -> dict[int, SE3]:
        """T_world_cam by frame id, under another convention if one is given."""
        rows = list(self.row.values())
        applied = (convention or self.convention).apply(self.filed.matrices[rows])
        return dict(zip(self.row, applied, strict=True))

    def shifted(self, step: int) -> dict[int, SE3]:
        """T_world_cam by frame id if each frame has the pose `step` rows further in the list.

        The list is the file, or the poses of the frames where the file is in another order.
        """
        rows = list(self.row.values())
        if rows == sorted(rows):
            moved = {f: row + step for f, row in self.row.items()}
            moved = {f: row for f, row in moved.items() if 0 <= row < len(self.filed.matrices)}
        else:
            ends = (slice(None, -step), slice(step, None))
            ends = ends if step > 0 else (slice(-step, None), slice(None, step))
            moved = dict(zip(list(self.row)[ends[0]], rows[ends[1]], strict=True))
        return replace(self, row=moved).poses()

    @property
    def metric(self) -> bool:
        return self.convention.unit != "unknown"

    def digest(self) -> str:
        """Digest of everything that the file and the options determine."""
        return digest_of(
            [[k, T.flat()] for k, T in sorted(self.poses().items())],
            self.convention.unit,
            self.options.cameras_use,
            self.options.cameras_max_px,
            self.options.cameras_unchecked,
        )

    def note(self) -> str:
        """Sentence on the origin of the poses."""
        text = f"camera poses from {self.filed.path.name} ({self.filed.kind}), read as "
        text += f"{self.convention.title}, unit {self.convention.unit}"
        if self.options.hand_eye is not None:
            text += f", hand-eye transform {self.options.hand_eye.name}"
        order = self.filed.quaternion
        how = [] if order is None else [order.sentence(self.options.cameras_quaternion)]
        return "; ".join([text, *how, *self.filed.repairs])


def read_known_poses(options: KnownCameras, frames: Sequence[Frame]) -> KnownPoses:
    """Read the file of known cameras and find the frame of each pose.

    Args:
        options: options with `cameras` set.
        frames: frames of the scene.

    Raises:
        ToolkitError: unreadable, a unit or convention that must be named, or poses that belong
            to no frame.
    """
    assert options.cameras is not None
    filed = read_cameras(options.cameras)
    convention = convention_of(options, filed)
    for repair in filed.repairs:
        logger.warning("%s: %s", filed.path, repair)
    if filed.quaternion is not None:
        how = filed.quaternion.sentence(options.cameras_quaternion)
        logger.info("%s: %s", filed.path, how, extra={"doctor": "guessed"})
    row = match_frames(
        filed, frames, max_dt=options.cameras_max_dt, first_number=options.cameras_first
    )
    lost = [f.name for f in frames if f.id not in row]
    if lost:
        logger.warning(
            "%s has no pose for %d of %d frames: %s", filed.path, len(lost), len(frames),
            ", ".join(lost[:5]) + (" ..." if len(lost) > 5 else ""),
        )  # fmt: skip
    return KnownPoses(filed=filed, row=row, convention=convention, options=options)


def convention_of(options: KnownCameras, filed: FiledCameras) -> Convention:
    """Return the convention from the options, or else from the format.

    Raises:
        ToolkitError: the unit or the order of quaternions must be named, or the hand-eye transform
            cannot be read.
    """
    if options.cameras_unit is None and filed.unit_is_open:
        raise ToolkitError(
            f"the unit of a {filed.kind} file is not stated in it", path=filed.path,
            hint="give --cameras-unit m, cm or mm; unknown estimates the scale as without poses",
        )  # fmt: skip
    name = options.cameras_convention or filed.convention or "camera-to-world"
    given, order = options.cameras_quaternion, filed.quaternion
    if order is None and given is not None:
        raise ToolkitError(
            "the file has no quaternions whose order is open", path=filed.path,
            field="--cameras-quaternion", value=given, hint="leave it out",
        )  # fmt: skip
    if order is not None and not order.why and given is None:
        raise ToolkitError(
            "qx qy qz qw or qw qx qy qz? Time stamps in nanoseconds are EuRoC's, which has commas "
            "and wxyz, but spaces are TUM's, which has xyzw",
            path=filed.path, hint="give --cameras-quaternion wxyz or xyzw",
        )  # fmt: skip
    if options.hand_eye is not None and any(filed.lenses):
        raise ToolkitError(
            "these are poses of cameras, not of a robot's flange", path=filed.path,
            hint="leave out --hand-eye",
        )  # fmt: skip
    hand_eye = None
    if options.hand_eye is not None:
        hand_eye = read_transform(options.hand_eye, unit_in_m=_UNITS_IN_M[options.hand_eye_unit])
    axes = next((a for a in _AXES if a and name.endswith(a)), "")
    return Convention(
        direction=name.removesuffix(f"-{axes}"),
        axes=axes,
        unit=options.cameras_unit or filed.unit or "m",
        hand_eye=hand_eye,
        quaternion=given if order is not None and given != order.order else None,
    )
