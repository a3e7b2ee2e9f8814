"""Packed scenes of grasps on disk: memory-mapped arrays.

<pack>/grasps.json                  what was packed, and how
<pack>/objects/NAME.npz             labels of an object
<pack>/scene-00000/points.npy       (n, 3) of all frames, concatenated
                   /object.npy      (n,) number of the point's object, -1 table
                   /row.npy         (n,) row of its grasps, -1 unknown
                   /friction.npy ..widths.npy, tolerances.npy   the rows
                   /meshes.npz      the objects
<pack>/scene-00000.json             poses; written last, when the scene is complete
"""

import hashlib
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera import Camera
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import mapped_npy

PACK = "grasps.json"
_FX_640 = 446.31  # of DREDS at a width of 640 pixels


class GraspPackSetup(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides what is in a pack; scenes may be added.

    Attributes:
        seed: scene k is drawn from seed + k.
        assets, assets_root, split, objects, sizes: as in `TableOptions`.
        frames: views of a scene.
        size: (width, height) of the depth images.
        depth: `exact`, or `sensor` as a stereo camera errs.
        points: of a frame that are kept, at most.
        gripper: what must not hit anything.
        spacing: metres between the points of an object that have labels.
        views, angles, depths: of the grasps of a point.
    """

    seed: int
    assets: str
    assets_root: str | None
    split: Literal["train", "test", "all"]
    objects: tuple[int, int]
    sizes: tuple[float, float]
    frames: int
    size: tuple[int, int]
    depth: Literal["exact", "sensor"]
    points: int
    gripper: str
    spacing: float
    views: int
    angles: int
    depths: tuple[float, ...]
    format: int = 1

    @property
    def camera(self) -> Camera:
        """That of the frames: its angle of view is that of DREDS."""
        w, h = self.size
        f = _FX_640 * w / 640
        return Camera(w, h, f, f, (w - 1) / 2, (h - 1) / 2)


class PackedObject(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An object of a scene; `T_world_obj` is row by row."""

    name: str
    surface: Literal["diffuse", "transparent", "specular"]
    T_world_obj: list[float]


class PackedView(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A frame of a scene: its points are [begin, end) of the scene's; of their bytes a digest."""

    begin: int
    end: int
    T_world_cam: list[float]
    digest: str


class SceneIndex(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is in a scene.

    Attributes:
        seed: that it was drawn from.
        objects, frames: its.
        rows: of known grasps.
        known: share of the points on objects whose grasps are known.
        graspable: share of the rows that have a grasp.
    """

    seed: int
    objects: list[PackedObject]
    frames: list[PackedView]
    rows: int
    known: float
    graspable: float


def scene_folder(folder: Path, number: int) -> Path:
    return folder / f"scene-{number:05d}"


def index_path(folder: Path, number: int) -> Path:
    return folder / f"scene-{number:05d}.json"


def read_setup(folder: Path) -> GraspPackSetup:
    """What a folder of packed grasps holds.

    Raises:
        ToolkitError: it is none.
    """
    if not (folder / PACK).is_file():
        raise ToolkitError(
            "is no folder of packed grasps",
            path=folder,
            hint=f"make one: std-train pack-grasps {folder} --scenes N",
        )
    return read_document(folder / PACK, GraspPackSetup)


def digest_of_points(points: np.ndarray) -> str:
    """Digest of the points of a frame."""
    return hashlib.blake2b(points.tobytes(), digest_size=8).hexdigest()


def open_array(folder: Path, number: int, name: str) -> np.ndarray:
    """An array of a scene, mapped into memory.

    Raises:
        ToolkitError: the file is missing or cut off.
    """
    path = scene_folder(folder, number) / f"{name}.npy"
    try:
        return mapped_npy(path)
    except ToolkitError as error:
        raise error.revised(
            problem=f"the packed scene cannot be read: {error.problem}",
            hint=f"delete {index_path(folder, number).name} and run `std-train pack-grasps` again",
        ) from error
