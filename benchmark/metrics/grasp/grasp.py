"""Grasps of a parallel jaw in GraspNet's convention: batches, suppression, files.

GraspNet's files are arrays with rows of 17 numbers. A dump, the input of GraspNet's evaluation, is
`scene_<4 digits>/<camera>/<frame, 4 digits>.npy` with one row (`Grasps.from_array`) for each grasp,
in the camera frame of that image, in metres.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.atomic import write_bytes_atomic
from std_toolkit.io.foreign_files import read_npy

Floats = NDArray[np.float64]

UNKNOWN_OBJECT = -1

COLUMNS = 17

# Files hold float32, and networks compose rotations in it.
_ROTATION_TOLERANCE = 1e-3

# GraspNet's.
TRANSLATION_M = 0.03

ROTATION_RAD = math.radians(30)

CAMERAS = ("realsense", "kinect")


@dataclass(frozen=True, eq=False)
class Grasps:
    """N grasps in one frame, in GraspNet's convention.

    The axes of a grasp are the columns of its rotation: x is the direction of approach, out of
    the palm towards the object; y the direction in which the fingers close; z the height of the
    fingers. The fingertips reach `depth` beyond the translation, along x. Turning a grasp half a
    turn about x swaps the fingers and makes the same grasp.

    Attributes:
        scores: (N,) higher is better.
        widths: (N,) opening of the jaw before it closes, metres.
        heights: (N,) of the fingers, metres.
        depths: (N,) from the translation to the fingertips, metres.
        rotations: (N, 3, 3) gripper to the frame.
        translations: (N, 3) metres.
        object_ids: (N,) whole numbers of the objects that are grasped, -1 unknown.

    All are float64, ids int64, read-only.

    Raises:
        ToolkitError: arrays of other shapes, numbers that are not finite, or a matrix that is no
            rotation.
    """

    scores: Floats
    widths: Floats
    heights: Floats
    depths: Floats
    rotations: Floats
    translations: Floats
    object_ids: NDArray[np.int64]

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(np.asarray(self.scores)))
        shapes = {"rotations": (count, 3, 3), "translations": (count, 3)}
        for part in fields(self):
            kind = np.int64 if part.name == "object_ids" else np.float64
            array = np.array(getattr(self, part.name), dtype=kind)
            shape = shapes.get(part.name, (count,))
            if array.shape != shape:
                raise ToolkitError(
                    f"must have the shape {shape}", field=part.name, value=array.shape
                )
            if not np.isfinite(array).all():
                raise ToolkitError("holds a number that is not finite", field=part.name)
            array.flags.writeable = False
            object.__setattr__(self, part.name, array)
        R = self.rotations
        wrong = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0)
        bad = (wrong > _ROTATION_TOLERANCE) | (np.linalg.det(R) < 0)
        if bad.any():
            first = int(np.argmax(bad))
            raise ToolkitError(
                "is not a rotation matrix",
                field=f"rotations[{first}]",
                value=np.round(R[first], 6),
                hint="a rotation has orthonormal rows and determinant +1",
            )

    @classmethod
    def make(
        cls,
        rotations: ArrayLike,
        translations: ArrayLike,
        *,
        widths: ArrayLike,
        depths: ArrayLike,
        scores: ArrayLike = 0.0,
        heights: ArrayLike = 0.02,
        object_ids: ArrayLike = UNKNOWN_OBJECT,
    ) -> Grasps:
        """Grasps of which some numbers are the same for all; arguments as the attributes."""
        count = len(np.asarray(translations))

        def each(numbers: ArrayLike) -> Any:
            return np.broadcast_to(np.asarray(numbers), (count,))

        return cls(
            each(scores),
            each(widths),
            each(heights),
            each(depths),
            np.asarray(rotations),
            np.asarray(translations),
            each(object_ids),
        )

    @classmethod
    def empty(cls) -> Grasps:
        """No grasp."""
        return cls.make(np.zeros((0, 3, 3)), np.zeros((0, 3)), widths=0.0, depths=0.0)

    @classmethod
    def concatenated(cls, batches: Sequence[Grasps]) -> Grasps:
        """The grasps of all batches, one batch after the other."""
        if not batches:
            return cls.empty()
        parts: Any = (
            np.concatenate([getattr(b, part.name) for b in batches]) for part in fields(cls)
        )
        return cls(*parts)

    @classmethod
    def from_array(cls, array: ArrayLike) -> Grasps:
        """From GraspNet's rows of 17 numbers.

        Args:
            array: (N, 17): score, width, height, depth, rotation row by row (9), translation (3),
                object id.

        Raises:
            ToolkitError: another shape, or numbers that are no grasps.
        """
        rows = np.asarray(array, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != COLUMNS:
            raise ToolkitError(f"grasps are rows of {COLUMNS} numbers", value=rows.shape)
        if not np.isfinite(rows).all():
            raise ToolkitError("the grasps hold a number that is not finite")
        score, width, height, depth = rows[:, :4].T
        rotations = rows[:, 4:13].reshape(-1, 3, 3)
        ids = np.rint(rows[:, 16]).astype(np.int64)
        return cls(score, width, height, depth, rotations, rows[:, 13:16], ids)

    def to_array(self) -> Floats:
        """(N, 17) float64 rows, as `from_array` takes them."""
        head = np.stack([self.scores, self.widths, self.heights, self.depths], axis=1)
        flat = self.rotations.reshape(-1, 9)
        return np.concatenate([head, flat, self.translations, self.object_ids[:, None]], axis=1)

    def __len__(self) -> int:
        return len(self.scores)

    def __getitem__(
        self, which: int | slice | Sequence[int] | NDArray[np.integer] | NDArray[np.bool_]
    ) -> Grasps:
        """The grasps at an index (a batch of one), a slice, indices or a (N,) bool mask."""
        if isinstance(which, int | np.integer):
            which = [int(which)]
        return Grasps(*(getattr(self, part.name)[which] for part in fields(self)))

    def top(self, count: int) -> Grasps:
        """The best `count`, best first; equal scores stay in order."""
        return self[np.argsort(-self.scores, kind="stable")[:count]]

    def transformed(self, T: SE3 | ArrayLike) -> Grasps:
        """The same grasps in frame a, given T_a_b (4, 4) of their frame b.

        Raises:
            ToolkitError: T is no pose.
        """
        pose = T if isinstance(T, SE3) else SE3.from_matrix(T)
        return self.replaced(
            rotations=pose.R @ self.rotations, translations=pose @ self.translations
        )

    def replaced(self, **changes: ArrayLike) -> Grasps:
        """A copy with other arrays, such as `scores=`."""
        parts: Any = (changes.get(part.name, getattr(self, part.name)) for part in fields(self))
        return Grasps(*parts)

    @property
    def approaches(self) -> Floats:
        """(N, 3) unit vectors of approach."""
        return self.rotations[:, :, 0]

    @property
    def closings(self) -> Floats:
        """(N, 3) unit vectors from the finger at -y to the one at +y."""
        return self.rotations[:, :, 1]

    @property
    def tips(self) -> Floats:
        """(N, 3) points midway between the fingertips, metres."""
        return self.translations + self.depths[:, None] * self.approaches

    def poses(self) -> Floats:
        """(N, 4, 4) matrices, gripper to the frame."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.rotations, self.translations
        return T


def suppress_similar(
    grasps: Grasps,
    *,
    translation: float = TRANSLATION_M,
    rotation: float = ROTATION_RAD,
    swapped_fingers: bool = False,
) -> Grasps:
    """Keep the best of similar grasps, best first.

    From the best down, a grasp is kept unless one that is kept lies nearer than `translation`
    and is turned by less than `rotation` against it.

    Args:
        grasps: N grasps.
        translation: metres.
        rotation: radians, of the whole rotation between the two.
        swapped_fingers: count half a turn about the approach as no turn. GraspNet's evaluation
            does not, though both are the same grasp.

    Returns:
        The grasps that are kept.

    >>> places = [[0, 0, 0], [0, 0, 0.01], [0, 0, 0.1]]
    >>> same = np.stack([np.eye(3)] * 3)
    >>> grasps = Grasps.make(same, places, widths=0.05, depths=0.02, scores=[0.1, 0.9, 0.5])
    >>> suppress_similar(grasps).scores.tolist()
    [0.9, 0.5]
    """
    ordered = grasps.top(len(grasps))
    if not len(ordered):
        return ordered
    R, t = ordered.rotations, ordered.translations
    # The angle of A^T B is below the limit where its trace is above this.
    least_trace = 1 + 2 * math.cos(rotation)
    swapped = R * np.array([1.0, -1.0, -1.0])
    standing = np.ones(len(ordered), dtype=bool)
    for first in range(len(ordered)):
        if not standing[first]:
            continue
        rest = first + 1 + np.flatnonzero(standing[first + 1 :])
        rest = rest[((t[rest] - t[first]) ** 2).sum(axis=1) < translation**2]
        alike = np.einsum("nij,ij->n", R[rest], R[first]) > least_trace
        if swapped_fingers:
            alike |= np.einsum("nij,ij->n", swapped[rest], R[first]) > least_trace
        standing[rest[alike]] = False
    return ordered[standing]


def write_grasps(path: Path | str, grasps: Grasps) -> None:
    """Write grasps as (N, 17) float64 `.npy`, atomically.

    Args:
        path: file to write.
        grasps: N grasps.

    Raises:
        ToolkitError: the file cannot be written.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_grasps(Path(folder) / "grasps.npy", Grasps.empty())
    ...     len(read_grasps(Path(folder) / "grasps.npy"))
    0
    """
    buffer = io.BytesIO()
    np.save(buffer, grasps.to_array(), allow_pickle=False)
    write_bytes_atomic(path, buffer.getvalue())


def read_grasps(path: Path | str) -> Grasps:
    """Read grasps of a `.npy` file.

    Args:
        path: file of (N, 17) numbers, as `write_grasps` and GraspNet write them.

    Returns:
        N grasps.

    Raises:
        ToolkitError: no such file, not an array of numbers, or not grasps.

    >>> import tempfile
    >>> with tempfile.NamedTemporaryFile(suffix=".npy") as file:
    ...     np.save(file.name, Grasps.empty().to_array())
    ...     len(read_grasps(file.name))
    0
    """
    path = Path(path)
    array = read_npy(path)
    try:
        return Grasps.from_array(array)
    except ToolkitError as error:
        raise error.revised(path=path) from None


@dataclass(frozen=True, order=True)
class DumpKey:
    """One image of a dump.

    Attributes:
        scene: its number.
        camera: `realsense` or `kinect`.
        frame: number of the image.
    """

    scene: int
    camera: str
    frame: int

    def path(self, root: Path) -> Path:
        """Its file below a dump."""
        return root / f"scene_{self.scene:04d}" / self.camera / f"{self.frame:04d}.npy"

    def found(self, root: Path) -> Path:
        """Its file, also without a folder of the camera; that of `path` if there is none."""
        plain = root / f"scene_{self.scene:04d}" / f"{self.frame:04d}.npy"
        return plain if plain.is_file() and not self.path(root).is_file() else self.path(root)


def dumped(root: Path, *, camera: str) -> Iterator[DumpKey]:
    """The images that a dump has grasps of.

    Args:
        root: folder of the dump.
        camera: `realsense` or `kinect`.

    Returns:
        Their keys, in order.

    Raises:
        ToolkitError: no such folder or camera.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     list(dumped(Path(folder), camera="kinect"))
    []
    """
    if camera not in CAMERAS:
        raise ToolkitError(f"one of {', '.join(CAMERAS)}", field="camera", value=camera)
    if not root.is_dir():
        raise ToolkitError("the folder of grasps is not there", path=root)
    digit = "[0-9]"
    for path in sorted(root.glob(f"scene_{digit * 4}/{camera}/{digit * 4}.npy")):
        yield DumpKey(int(path.parent.parent.name[-4:]), camera, int(path.stem))
