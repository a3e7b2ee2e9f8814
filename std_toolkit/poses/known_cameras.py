"""Known camera poses: their convention, and the frame that each belongs to."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.io.documents import digest_of
from std_toolkit.log import logger
from std_toolkit.options import KnownCameras
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.camera_table import FiledCameras
from std_toolkit.poses.hand_eye import read_transform
from std_toolkit.scene import Frame

_UNITS_IN_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "unknown": 1.0}
# OpenGL camera axes (x right, y up, z backward) to OpenCV's.
_CV_FROM_GL = SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
# Words of a file name that describe its content, not the frame.
_ROLE_WORDS = frozenset(
    [
        "color",
        "colour",
        "rgb",
        "image",
        "img",
        "frame",
        "pose",
        "poses",
        "cam",
        "camera",
        "extrinsic",
        "extrinsics",
        "matrix",
    ]
)
_IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".ppm", ".txt", ".npy", ".json")
)


@dataclass(frozen=True, kw_only=True)
class Convention:
    """How filed poses become T_world_cam.

    Attributes:
        direction: "camera-to-world" or "world-to-camera"; with a hand-eye transform, of the
            flange instead of the camera.
        opengl: whether the camera axes are x right, y up, z backward.
        unit: unit of the positions.
        hand_eye: T_flange_cam, metres.
        hand_eye_inverted: whether `hand_eye` is T_cam_flange instead.
        hand_eye_factor: further factor of its translation.
        quaternion_first: whether the four numbers of a quaternion begin with the real part,
            although the format (TUM) has it last.
    """

    direction: str = "camera-to-world"
    opengl: bool = False
    unit: str = "m"
    hand_eye: SE3 | None = None
    hand_eye_inverted: bool = False
    hand_eye_factor: float = 1.0
    quaternion_first: bool = False

    @property
    def title(self) -> str:
        """What is read, in words."""
        axes = "OpenGL" if self.opengl else "OpenCV"
        title = f"{self.direction} in {axes} axes"
        if self.hand_eye is not None:
            to_base = self.direction == "camera-to-world"
            title = f"{'flange-to-base' if to_base else 'base-to-flange'}, camera in {axes} axes"
        if self.hand_eye_inverted:
            title += ", with the inverse hand-eye transform"
        if self.hand_eye_factor != 1:
            title += ", with another unit of the hand-eye transform or of the log"
        if self.quaternion_first:
            title += ", with the quaternion as qw qx qy qz"
        return title

    @property
    def option(self) -> str:
        return self.direction + ("-opengl" if self.opengl else "")

    def apply(self, matrices: NDArray[np.float64]) -> list[SE3]:
        """Return T_world_cam in metres (or the unknown unit) of filed matrices (N, 4, 4)."""
        factor = _UNITS_IN_M[self.unit]
        poses = [SE3(M[:3, :3], M[:3, 3] * factor) for M in matrices]
        if self.quaternion_first:
            poses = [_reordered(T) for T in poses]
        if self.direction == "world-to-camera":
            poses = [T.inverse() for T in poses]
        if self.hand_eye is not None:
            hand_eye = SE3(self.hand_eye.R, self.hand_eye.t * self.hand_eye_factor)
            hand_eye = hand_eye.inverse() if self.hand_eye_inverted else hand_eye
            poses = [T @ hand_eye for T in poses]
        return [T @ _CV_FROM_GL for T in poses] if self.opengl else poses

    def alternatives(self, kind: str) -> list[tuple[Convention, str]]:
        """Other conventions in use, with the advice that selects each."""
        found = []
        for direction in ("camera-to-world", "world-to-camera"):
            for opengl in (False, True):
                other = replace(self, direction=direction, opengl=opengl)
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
                    for c, advice in found[:4]
                ]
        if kind == "tum":
            found += [
                (
                    replace(c, quaternion_first=True),
                    "write the quaternion as qx qy qz qw"
                    + ("" if c.option == self.option else f", {advice}"),
                )
                for c, advice in found[:4]
            ]
        return [(c, advice) for c, advice in found if c != self]


def _reordered(T: SE3) -> SE3:
    w, x, y, z = T.quat()
    return SE3.from_quat([x, y, z, w], T.t)


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
        return "; ".join([text, *self.filed.repairs])


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
    for repair in filed.repairs:
        logger.warning("%s: %s", filed.path, repair)
    row = match_frames(
        filed, frames, max_dt=options.cameras_max_dt, first_number=options.cameras_first
    )
    lost = [f.name for f in frames if f.id not in row]
    if lost:
        logger.warning(
            "%s has no pose for %d of %d frames: %s", filed.path, len(lost), len(frames),
            ", ".join(lost[:5]) + (" ..." if len(lost) > 5 else ""),
        )  # fmt: skip
    return KnownPoses(
        filed=filed, row=row, convention=convention_of(options, filed), options=options
    )


def convention_of(options: KnownCameras, filed: FiledCameras) -> Convention:
    """Return the convention from the options, or else from the format.

    Raises:
        ToolkitError: the unit must be named, or the hand-eye transform cannot be read.
    """
    if options.cameras_unit is None and filed.unit_is_open:
        raise ToolkitError(
            f"the unit of a {filed.kind} file is not stated in it", path=filed.path,
            hint="give --cameras-unit m, cm or mm; unknown estimates the scale as without poses",
        )  # fmt: skip
    name = options.cameras_convention or filed.convention or "camera-to-world"
    if options.hand_eye is not None and any(filed.lenses):
        raise ToolkitError(
            "these are poses of cameras, not of a robot's flange", path=filed.path,
            hint="leave out --hand-eye",
        )  # fmt: skip
    hand_eye = None
    if options.hand_eye is not None:
        hand_eye = read_transform(options.hand_eye, unit_in_m=_UNITS_IN_M[options.hand_eye_unit])
    return Convention(
        direction=name.removesuffix("-opengl"),
        opengl=name.endswith("-opengl"),
        unit=options.cameras_unit or filed.unit or "m",
        hand_eye=hand_eye,
    )


def match_frames(
    filed: FiledCameras,
    frames: Sequence[Frame],
    *,
    max_dt: float = 0.02,
    first_number: int | None = None,
) -> dict[int, int]:
    """Find the pose of each frame: by name, else time stamp, number in the name, or frame id.

    The way that finds most frames is used. Poses without keys are in the order of the frames.

    Args:
        filed: poses as filed.
        frames: frames of the scene.
        max_dt: largest difference of time stamps in seconds.
        first_number: number of the pose of the first image, if the user states it.

    Returns:
        Row of `filed.matrices` by frame id, in the order of the frames.

    Raises:
        ToolkitError: two poses of one image, no pose of any, or another number of poses than
            frames where only the order could tell.
    """
    keys = filed.keys
    if keys is None:
        if len(filed.matrices) != len(frames):
            raise ToolkitError(
                f"{len(filed.matrices)} poses without image names for {len(frames)} images",
                path=filed.path,
                hint="one pose per image, or write the image's name before each pose",
            )
        return {f.id: i for i, f in enumerate(frames) if i not in filed.lost}
    if len(set(keys)) < len(keys):
        twice = next(k for k in keys if keys.count(k) > 1)
        raise ToolkitError("two poses of one image", path=filed.path, value=twice)
    ways: list[dict[int, int]] = [
        _joined(frames, keys, lambda f: f.color.rsplit("/")[-1], lambda k: Path(k).name),
        _joined(frames, keys, lambda f: f.name, _stem),
        _joined(frames, keys, lambda f: _bare(f.name), lambda k: _bare(_stem(k))),
        _by_time(frames, keys, max_dt),
        _by_number(frames, keys, first_number),
        _joined(frames, keys, lambda f: str(f.id), lambda k: k),
    ]
    best = max(ways, key=len) if first_number is None else ways[4]
    if not best:
        raise ToolkitError(
            "no pose of this file belongs to an image of the scene", path=filed.path,
            value=keys[0],
            hint=f"poses are found by file name or time stamp; the first image is {frames[0].name}",
        )  # fmt: skip
    first = next(iter(best))
    shown = next(f.color for f in frames if f.id == first)
    logger.info("camera poses: pose %r belongs to %s", keys[best[first]], shown)
    _refuse_from_one(filed, frames, best, first_number)
    best = {frame: row for frame, row in best.items() if row not in filed.lost}
    if not best:
        raise ToolkitError("no image of the scene has a pose in this file", path=filed.path)
    return best


def _refuse_from_one(
    filed: FiledCameras, frames: Sequence[Frame], found: dict[int, int], first: int | None
) -> None:
    """Refuse poses that count from 1 for images that count from 0, joined by their numbers.

    Raises:
        ToolkitError: one pose per image, and each number but the last has an image.
    """
    if first is not None or filed.keys is None or len(filed.keys) != len(frames):
        return
    poses = {_number(key) for key in filed.keys}
    images = {_number(f.name) for f in frames}
    if "" in poses | images or len(poses) < len(frames) or len(images) < len(frames):
        return
    lowest, highest = (min(map(int, images)), max(map(int, images)))
    by_number = all(
        _number(filed.keys[row]) == _number(_name_of(frames, f)) for f, row in found.items()
    )
    if by_number and {int(n) for n in poses} == {int(n) + 1 for n in images}:
        raise ToolkitError(
            f"the pose of the last number, {highest + 1}, has no image, and image {lowest} has no "
            "pose: counted from 1?",
            path=filed.path,
            value=filed.keys[0],
            hint=f"--cameras-first {lowest + 1} takes pose {lowest + 1} for the first image, "
            f"--cameras-first {lowest} takes the numbers as they are",
        )


def _name_of(frames: Sequence[Frame], frame: int) -> str:
    return next(f.name for f in frames if f.id == frame)


def _by_number(frames: Sequence[Frame], keys: Sequence[str], first: int | None) -> dict[int, int]:
    """Join numbers in names; with `first`, the number of the pose of the first image."""
    if first is None:
        return _joined(frames, keys, lambda f: _number(f.name), _number)
    numbers = [_number(f.name) for f in frames]
    if "" in numbers:
        return {}
    step = first - min(map(int, numbers))
    return _joined(frames, keys, lambda f: str(int(_number(f.name)) + step), _number)


def _joined(
    frames: Sequence[Frame],
    keys: Sequence[str],
    of_frame: Callable[[Frame], str],
    of_key: Callable[[str], str],
) -> dict[int, int]:
    """Join frames and keys by equal text; empty unless the texts are unique on both sides."""
    rows: dict[str, int] = {}
    for i, key in enumerate(keys):
        if text := of_key(key):
            if text in rows:
                return {}
            rows[text] = i
    texts = [of_frame(f) for f in frames]
    if len(set(texts)) < len(texts):
        return {}
    return {f.id: rows[t] for f, t in zip(frames, texts, strict=True) if t in rows}


def _by_time(frames: Sequence[Frame], keys: Sequence[str], max_dt: float) -> dict[int, int]:
    times = np.array([_time(k) for k in keys])
    stamps = [f.timestamp if f.timestamp is not None else _time(f.name) for f in frames]
    if not np.isfinite(times).all() or not any(np.isfinite(s) for s in stamps):
        return {}
    found = {}
    for frame, stamp in zip(frames, stamps, strict=True):
        if np.isfinite(stamp):
            nearest = int(np.abs(times - stamp).argmin())
            if abs(times[nearest] - stamp) <= max_dt:
                found[frame.id] = nearest
    # Frames without a pose of their own would share that of a neighbour.
    return found if len(set(found.values())) == len(found) else {}


def _time(text: str) -> float:
    stem = _stem(text)
    return float(stem) if re.fullmatch(r"\d+\.\d+", stem) else float("nan")


def _stem(key: str) -> str:
    path = Path(key)
    return path.stem if path.suffix.lower() in _IMAGE_SUFFIXES else path.name


def _bare(stem: str) -> str:
    words = [w for w in re.split(r"[-_. ]+", stem.lower()) if w and w not in _ROLE_WORDS]
    return "-".join(words)


def _number(key: str) -> str:
    numbers = re.findall(r"\d+", _stem(key))
    return str(int(numbers[-1])) if numbers and _time(key) != _time(key) else ""
