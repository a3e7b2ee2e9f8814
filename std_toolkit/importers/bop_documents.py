"""The JSON documents of a BOP scene, checked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry.se3 import ROTATION_TOLERANCE, SE3, nearest_rotation
from std_toolkit.io.documents import read_document
from std_toolkit.scene.document import check_in_front

MM = 0.001
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
Nine = Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)]
Three = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
_LARGEST_ID = 999_999
# Published rotations are rounded, and refined as plain matrices: LM-O's are up to 9.6e-3 off.
LARGEST_DEVIATION = 0.05
Row = TypeVar("Row")


class CameraModelRow(msgspec.Struct, frozen=True, kw_only=True):
    """`cam_model` of an image, in place of `cam_K`: HOT3D's cameras."""

    projection_model_type: str = ""
    projection_params: Annotated[list[float], msgspec.Meta(max_length=16)] = []
    image_width: Annotated[int, msgspec.Meta(gt=0)] | None = None
    image_height: Annotated[int, msgspec.Meta(gt=0)] | None = None

    @property
    def is_pinhole(self) -> bool:
        """Whether the model has no distortion."""
        return "pinhole" in self.projection_model_type.lower()

    @property
    def numbers(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """(fx, fy, cx, cy) in pixels, and the 12 coefficients of Fisheye624 or none.

        Raises:
            ToolkitError: the model is unknown, or has another number of parameters.
        """
        kind, values = self.projection_model_type, self.projection_params
        if not self.is_pinhole and "624" not in kind:
            raise ToolkitError(
                "unknown camera model",
                field="projection_model_type",
                value=kind,
                hint="supported are FISHEYE624 and pinhole models",
            )
        extra = 0 if self.is_pinhole else 12
        # One focal length (Aria) or two.
        values = [values[0], *values] if len(values) == extra + 3 else values
        if len(values) != extra + 4:
            raise ToolkitError(
                f"the model has {extra + 3} or {extra + 4} parameters",
                field="projection_params",
                value=len(self.projection_params),
            )
        return tuple(values[:4]), tuple(values[4:])


class CameraRow(msgspec.Struct, frozen=True, kw_only=True):
    """An image's entry in scene_camera.json. Fields that the scene does not use are ignored."""

    cam_K: Nine | None = None
    cam_model: CameraModelRow | None = None
    depth_scale: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 1.0
    cam_R_w2c: Nine | None = None
    cam_t_w2c: Three | None = None

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy, pixels.

        Raises:
            ToolkitError: the entry has no usable camera.
        """
        if self.cam_K is not None:
            return self.cam_K[0], self.cam_K[4], self.cam_K[2], self.cam_K[5]
        if self.cam_model is None:
            raise ToolkitError("needs cam_K or cam_model")
        fx, fy, cx, cy = self.cam_model.numbers[0]
        return fx, fy, cx, cy

    @property
    def fisheye(self) -> tuple[float, ...]:
        """The 12 coefficients of Fisheye624; empty for a pinhole camera."""
        return () if self.cam_K or self.cam_model is None else self.cam_model.numbers[1]

    @property
    def depth_scale_m(self) -> float:
        """Metres per unit of the depth image."""
        return float(f"{self.depth_scale * MM:.12g}")

    @property
    def T_cam_world(self) -> SE3 | None:
        """World to camera, metres."""
        if self.cam_R_w2c is None or self.cam_t_w2c is None:
            return None
        return pose_of(self.cam_R_w2c, self.cam_t_w2c)


class GtRow(msgspec.Struct, frozen=True, kw_only=True):
    """An object's entry in scene_gt.json."""

    obj_id: Annotated[int, msgspec.Meta(ge=0, le=_LARGEST_ID)]
    cam_R_m2c: Nine
    cam_t_m2c: Three

    @property
    def T_cam_obj(self) -> SE3:
        """Model (origin as in the BOP mesh) to camera, metres."""
        return pose_of(self.cam_R_m2c, self.cam_t_m2c)

    @property
    def filed_pose(self) -> SE3:
        """The same with the rotation as filed, which need not be exactly orthonormal."""
        return filed_pose(self.cam_R_m2c, self.cam_t_m2c)


class ContinuousRow(msgspec.Struct, frozen=True, kw_only=True):
    """A continuous symmetry in models_info.json."""

    axis: Three
    offset: Three = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class ModelInfo(msgspec.Struct, frozen=True, kw_only=True):
    """A model's entry in models_info.json; millimetres."""

    diameter: float | None = None
    symmetries_discrete: list[
        Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
    ] = []
    symmetries_continuous: list[ContinuousRow] = []


@dataclass(frozen=True)
class BopScene:
    """A scene's documents by image id; `gt` lacks images without objects.

    Attributes:
        sensor: of a data set with several.
    """

    folder: Path
    cameras: dict[int, CameraRow]
    gt: dict[int, list[GtRow]]
    sensor: str = ""

    def pictures(self, kind: str) -> Path:
        """Folder of a kind of pictures, such as depth/ or depth_photoneo/."""
        return self.folder / f"{kind}{'_' if self.sensor else ''}{self.sensor}"

    def picture(self, kind: str, im_id: int) -> Path | None:
        """A picture of an image, if it is there."""
        folder = self.pictures(kind)
        found = (folder / f"{im_id:06d}{suffix}" for suffix in PICTURE_SUFFIXES)
        return next((path for path in found if path.is_file()), None)


def read_bop_scene(folder: Path, sensor: str = "", *, for_import: bool = True) -> BopScene:
    """Read scene_camera.json and scene_gt.json (which test sets may lack).

    Args:
        folder: of the scene.
        sensor: of a data set with several: `photoneo` for scene_camera_photoneo.json.
        for_import: refuse what a scene cannot hold: fisheye cameras, and objects out of view.

    Raises:
        ToolkitError: a document breaks the format, a rotation is invalid, or ids do not match.
    """
    camera_path, gt_path = (scene_file(folder, name, sensor) for name in ("camera", "gt"))
    cameras = _by_id(read_document(camera_path, dict[str, CameraRow]), camera_path)
    gt = (
        _by_id(read_document(gt_path, dict[str, list[GtRow]]), gt_path) if gt_path.is_file() else {}
    )
    for im_id, row in cameras.items():
        with located(camera_path, f"{im_id}"):
            if for_import and row.cam_model is not None and not row.cam_model.is_pinhole:
                raise ToolkitError("only pinhole cameras (cam_K) can be imported")
            _ = row.intrinsics
            if row.cam_K is not None:
                _plain_K(row.cam_K)
            _ = row.T_cam_world
    for im_id in gt:
        if im_id not in cameras:
            raise ToolkitError("no such image in scene_camera.json", path=gt_path, value=im_id)
    entries = [(im_id, i, row) for im_id, rows in gt.items() for i, row in enumerate(rows)]
    bad = first_bad_pose(
        [row.cam_R_m2c for *_, row in entries], [row.cam_t_m2c for *_, row in entries]
    )
    for k, (im_id, i, entry) in enumerate(entries):
        if for_import or k == bad:
            with located(gt_path, f"{im_id}[{i}]"):
                check_in_front(entry.filed_pose, unit_hint="BOP translations are in millimetres")
    return BopScene(folder, cameras, gt, sensor)


def sensors_of(folder: Path) -> list[str]:
    """Names of the sensors of a scene; "" of the only one of most data sets."""
    names = (p.stem.removeprefix("scene_camera") for p in folder.glob("scene_camera*.json"))
    return sorted(name.removeprefix("_") for name in names if not name or name[0] == "_")


def scene_file(folder: Path, name: str, sensor: str = "") -> Path:
    """Path of a scene's document, such as scene_gt.json or scene_gt_photoneo.json.

    >>> scene_file(Path("test/000001"), "gt", "photoneo").name
    'scene_gt_photoneo.json'
    """
    return folder / f"scene_{name}{'_' if sensor else ''}{sensor}.json"


def pose_of(R: list[float], t_mm: list[float]) -> SE3:
    """A BOP pose in metres, with the nearest exact rotation.

    Raises:
        ToolkitError: the rotation is invalid or a number is not finite.
    """
    filed = filed_pose(R, t_mm)
    return SE3(nearest_rotation(filed.R, tolerance=2 * LARGEST_DEVIATION), filed.t)


def filed_pose(R: ArrayLike, t_mm: ArrayLike) -> SE3:
    """A BOP pose in metres, with R as filed: BOP's scores are those of the published numbers.

    Raises:
        ToolkitError: a number is not finite, the determinant of R is negative, or R is more than
            5 % off a rotation.
    """
    pose = unchecked_pose(R, t_mm)
    if not (np.isfinite(pose.R).all() and np.isfinite(pose.t).all()):
        raise ToolkitError("a pose contains a number that is not finite", value=pose.flat())
    if first_bad_pose([pose.R], [pose.t]) is not None:
        raise ToolkitError(
            "this is not a rotation matrix",
            value=np.round(pose.R, 6).tolist(),
            hint="R R^T may differ from the identity by 0.05, and the determinant is +1",
        )
    return pose


def unchecked_pose(R: ArrayLike, t_mm: ArrayLike) -> SE3:
    """The same of numbers that were checked before."""
    return SE3(np.reshape(R, (3, 3)), np.ravel(t_mm) * MM)


def first_bad_pose(R: Sequence[ArrayLike], t: Sequence[ArrayLike]) -> int | None:
    """Index of the first pose that `filed_pose` refuses; None if it accepts all."""
    if not R:
        return None
    rotations = np.reshape(np.asarray(R, dtype=np.float64), (-1, 3, 3))
    finite = np.isfinite(np.asarray(t, dtype=np.float64)).all(axis=1)
    finite &= np.isfinite(rotations).all(axis=(1, 2))
    safe = np.where(np.reshape(finite, (-1, 1, 1)), rotations, np.eye(3))
    good = finite & (np.linalg.det(safe) > 0) & (deviations(safe) <= LARGEST_DEVIATION)
    return None if good.all() else int(np.argmin(good))


def deviations(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) largest entries of `R R^T - I` of rotations (N, 3, 3)."""
    return np.asarray(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)))


def count_rough(poses: Sequence[SE3]) -> tuple[int, float]:
    """How many rotations are off by more than rounding, and the largest deviation."""
    if not poses:
        return 0, 0.0
    off = deviations(np.stack([T.R for T in poses]))
    return int((off > ROTATION_TOLERANCE).sum()), float(off.max())


def _by_id(table: dict[str, Row], path: Path) -> dict[int, Row]:
    for key in table:
        if not key.isdigit() or int(key) > _LARGEST_ID:
            raise ToolkitError("images are keyed by their number", path=path, value=key)
    found = {int(k): v for k, v in table.items()}
    if len(found) != len(table):
        raise ToolkitError("an image appears twice", path=path)
    return found


def _plain_K(K: list[float]) -> None:
    if abs(K[1]) > 1e-6 * abs(K[0]) or K[3] or K[6:] != [0, 0, 1]:
        raise ToolkitError("K must be a camera matrix without skew", value=K)
