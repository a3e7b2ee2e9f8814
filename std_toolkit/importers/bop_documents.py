"""The JSON documents of a BOP scene, checked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.scene.document import check_in_front

MM = 0.001
Nine = Annotated[list[float], msgspec.Meta(min_length=9, max_length=9)]
Three = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
_LARGEST_ID = 999_999
Row = TypeVar("Row")


class CameraRow(msgspec.Struct, frozen=True, kw_only=True):
    """An image's entry in scene_camera.json. Fields that the scene does not use are ignored."""

    cam_K: Nine
    depth_scale: Annotated[float, msgspec.Meta(gt=0, le=1000)] = 1.0
    cam_R_w2c: Nine | None = None
    cam_t_w2c: Three | None = None

    @property
    def intrinsics(self) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy."""
        return self.cam_K[0], self.cam_K[4], self.cam_K[2], self.cam_K[5]

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
    """A scene's documents by image id; `gt` lacks images without objects."""

    folder: Path
    cameras: dict[int, CameraRow]
    gt: dict[int, list[GtRow]]


def read_bop_scene(folder: Path) -> BopScene:
    """Read scene_camera.json and scene_gt.json (which test sets may lack).

    Raises:
        ToolkitError: a document breaks the format, a rotation is invalid, or ids do not match.
    """
    camera_path, gt_path = folder / "scene_camera.json", folder / "scene_gt.json"
    raw = read_document(camera_path, dict[str, dict[str, msgspec.Raw]])
    for key, fields in raw.items():
        if "cam_model" in fields:
            raise ToolkitError(
                "only pinhole cameras (cam_K) can be imported", path=camera_path, field=key
            )
    cameras = _by_id(read_document(camera_path, dict[str, CameraRow]), camera_path)
    gt = (
        _by_id(read_document(gt_path, dict[str, list[GtRow]]), gt_path) if gt_path.is_file() else {}
    )
    for im_id, row in cameras.items():
        with named(camera_path, f"{im_id}"):
            _plain_K(row)
            _ = row.T_cam_world
    for im_id, rows in gt.items():
        if im_id not in cameras:
            raise ToolkitError("no such image in scene_camera.json", path=gt_path, value=im_id)
        for i, entry in enumerate(rows):
            with named(gt_path, f"{im_id}[{i}]"):
                check_in_front(entry.T_cam_obj, unit_hint="BOP translations are in millimetres")
    return BopScene(folder, cameras, gt)


def pose_of(R: list[float], t_mm: list[float]) -> SE3:
    """A BOP pose in metres.

    Raises:
        ToolkitError: the rotation is invalid or a number is not finite.
    """
    M = np.eye(4)
    M[:3, :3] = np.asarray(R, dtype=np.float64).reshape(3, 3)
    M[:3, 3] = np.asarray(t_mm, dtype=np.float64) * MM
    return SE3.from_matrix(M)


def _by_id(table: dict[str, Row], path: Path) -> dict[int, Row]:
    for key in table:
        if not key.isdigit() or int(key) > _LARGEST_ID:
            raise ToolkitError("images are keyed by their number", path=path, value=key)
    found = {int(k): v for k, v in table.items()}
    if len(found) != len(table):
        raise ToolkitError("an image appears twice", path=path)
    return found


def _plain_K(row: CameraRow) -> None:
    K = row.cam_K
    if abs(K[1]) > 1e-6 * abs(K[0]) or K[3] or K[6:] != [0, 0, 1]:
        raise ToolkitError("K must be a camera matrix without skew", value=K)


@contextmanager
def named(path: Path, field: str) -> Iterator[None]:
    """Add the file and the field to errors of the block."""
    try:
        yield
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=field, value=error.value, hint=error.hint
        ) from error
