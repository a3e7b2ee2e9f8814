"""A BOP data set: true poses, cameras, depth and models."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.metrics.bop.bop_distances import Project, fisheye624, pinhole
from benchmark.metrics.bop.bop_model import BopModel, model_paths, read_model
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers import bop_documents, depth_files
from std_toolkit.importers.bop_documents import unchecked_pose
from std_toolkit.io.documents import read_document
from std_toolkit.io.images import image_size
from std_toolkit.io.tiff import TIFF_SUFFIXES, tiff_size

_ID = Annotated[int, msgspec.Meta(ge=0, le=999_999)]
_PICTURES = ("rgb", "gray", "depth")
_SUFFIXES = (".png", ".jpg", ".tif")


class BopTarget(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of test_targets_bop19.json: number of instances of an object in an image."""

    scene_id: _ID
    im_id: _ID
    obj_id: _ID
    inst_count: Annotated[int, msgspec.Meta(ge=1)]


class ImageTarget(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of test_targets_bop24.json: an image."""

    scene_id: _ID
    im_id: _ID


class ViewGroup(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of test_targets_multiview_bop25.json: views of a scene to be used together.

    Attributes:
        scene_id: number of the scene.
        im_id: images, each with the name of its sensor where the scene has several.
    """

    scene_id: _ID
    # Plain numbers: msgspec 0.22 loses its memory over a tuple with a limited number in a union.
    im_id: Annotated[list[int | tuple[str, int]], msgspec.Meta(min_length=1)]

    def images(self, sensor: str) -> list[int]:
        """Return the images of a sensor; those without a name are of any."""
        named = [(sensor, view) if isinstance(view, int) else view for view in self.im_id]
        return [im_id for name, im_id in named if name == sensor]


class _GlobalCamera(msgspec.Struct, frozen=True, kw_only=True):
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class BopImage:
    """An image's camera and depth.

    Attributes:
        size: (width, height), pixels.
        project: camera frame to pixels, see `bop_distances`.
        camera: pinhole camera; None for a fisheye.
        depth: (H, W) metres; None if it was not asked for or cannot be had.
        why_no_depth: the error; empty otherwise.
    """

    size: tuple[int, int]
    project: Project
    camera: Camera | None
    depth: NDArray[np.float32] | None = None
    why_no_depth: str = ""


@dataclass(frozen=True, eq=False)
class BopDataset:
    """A split of a data set, opened.

    Attributes:
        root: of the data set.
        split: such as "test".
        sensors: of data sets with several, by scene; empty otherwise.
        targets: what is to be found, for average recalls.
        images: scene and image for detection, where all objects count.
        scenes: their documents by number.
        visible: visible shares by scene and image, in the order of scene_gt.json.
        symmetry_steps: samples of a turn about a continuous axis; None for the exact minimum.
        groups: views that a method may use together; empty without multi-view targets.
    """

    root: Path
    split: str
    sensors: dict[int, str]
    targets: tuple[BopTarget, ...]
    images: tuple[tuple[int, int], ...]
    scenes: dict[int, bop_documents.BopScene]
    visible: dict[int, dict[int, list[float]]]
    symmetry_steps: int | None = None
    groups: tuple[ViewGroup, ...] = ()

    def truths(self, scene_id: int, im_id: int, obj_id: int) -> tuple[list[SE3], list[float]]:
        """All true poses of an object in an image as filed, and their visible shares."""
        rows = self.scenes[scene_id].gt.get(im_id, [])
        index = [i for i, row in enumerate(rows) if row.obj_id == obj_id]
        shares = self.visible[scene_id].get(im_id, [])
        return [unchecked_pose(rows[i].cam_R_m2c, rows[i].cam_t_m2c) for i in index], [
            shares[i] for i in index
        ]

    def valid(self, target: BopTarget, shares: list[float]) -> NDArray[np.bool_]:
        """Which true poses of a target are to be found: the most visible ones, as many as it says.

        Raises:
            ToolkitError: fewer poses than the target says.
        """
        if len(shares) < target.inst_count:
            raise ToolkitError(
                "fewer true poses than the targets say",
                path=self.file(target.scene_id, "gt"),
                field=f"{target.im_id}, obj_id {target.obj_id}",
                value=len(shares),
            )
        order = sorted(range(len(shares)), key=lambda k: -shares[k])
        valid = np.zeros(len(shares), dtype=bool)
        valid[order[: target.inst_count]] = True
        return valid

    def poses(self) -> list[SE3]:
        """All true poses as filed."""
        scenes = self.scenes.values()
        rows = [row for s in scenes for rows in s.gt.values() for row in rows]
        return [unchecked_pose(row.cam_R_m2c, row.cam_t_m2c) for row in rows]

    def objects(self, scene_id: int, im_id: int) -> list[int]:
        """Numbers of the objects in an image, in order."""
        return sorted({row.obj_id for row in self.scenes[scene_id].gt.get(im_id, [])})

    def folder(self, scene_id: int) -> Path:
        """Of a scene."""
        return self.root / self.split / f"{scene_id:06d}"

    def file(self, scene_id: int, name: str) -> Path:
        """A scene's document, such as scene_gt.json."""
        return bop_documents.scene_file(self.folder(scene_id), name, self.sensors[scene_id])

    def pictures(self, scene_id: int, kind: str) -> Path:
        """A scene's folder of pictures, such as depth/ or depth_photoneo/."""
        folder, sensor = self.folder(scene_id), self.sensors[scene_id]
        named = folder / (f"{kind}_{sensor}" if sensor else kind)
        # Where each modality is a sensor of its own (HOT3D), its folder has the sensor's name.
        return folder / sensor if kind == sensor and not named.is_dir() else named

    @cached_property
    def _picture_folders(self) -> dict[int, list[Path]]:
        """Folders of pictures that are there, by scene."""
        kinds = {n: (*_PICTURES, *filter(None, [s])) for n, s in self.sensors.items()}
        found = {n: [self.pictures(n, kind) for kind in each] for n, each in kinds.items()}
        return {n: [f for f in folders if f.is_dir()] for n, folders in found.items()}

    @cached_property
    def has_depth(self) -> bool:
        """Whether any scene has depth and a pinhole camera: without, there is no VSD."""
        return any(
            self.pictures(number, "depth").is_dir()
            and not any(row.fisheye for row in scene.cameras.values())
            for number, scene in self.scenes.items()
        )

    def image(self, scene_id: int, im_id: int, *, depth: bool = True) -> BopImage:
        """Camera of an image, and its depth.

        Args:
            depth: read it; what is wrong with it is in the result.

        Raises:
            ToolkitError: no such image, or no way to know its size.
        """
        row = self.scenes[scene_id].cameras.get(im_id)
        if row is None:
            path = self.file(scene_id, "camera")
            raise ToolkitError("no such image", path=path, value=im_id)
        fx, fy, cx, cy = row.intrinsics
        size = self._size(scene_id, im_id, row)
        if row.fisheye:
            return BopImage(size, fisheye624((fx, fy), row.fisheye), None, None, "fisheye camera")
        camera = Camera(*size, fx, fy, cx, cy)
        if not depth:
            return BopImage(size, pinhole(camera), camera)
        try:
            values = self._depth(scene_id, im_id, size) * np.float32(row.depth_scale_m)
        except ToolkitError as error:
            return BopImage(size, pinhole(camera), camera, None, str(error))
        return BopImage(size, pinhole(camera), camera, values)

    def _size(self, scene_id: int, im_id: int, row: bop_documents.CameraRow) -> tuple[int, int]:
        model = row.cam_model
        if model is not None and model.image_width and model.image_height:
            return model.image_width, model.image_height
        sensor = self.sensors[scene_id]
        for folder in self._picture_folders[scene_id]:
            for suffix in _SUFFIXES:
                path = folder / f"{im_id:06d}{suffix}"
                if path.is_file():
                    return _size_of(path)
        named = self.root / f"camera_{sensor}.json"
        path = named if sensor and named.is_file() else self.root / "camera.json"
        if not path.is_file():
            found = (p for f in self._picture_folders[scene_id] for p in sorted(f.iterdir()))
            other = next((p for p in found if p.suffix.lower() in _SUFFIXES), None)
            if other is not None:
                return _size_of(other)
            raise ToolkitError(
                "cannot tell the size of the image",
                path=self.folder(scene_id),
                field=str(im_id),
                hint="an image in rgb/, gray/ or depth/, or camera.json of the data set gives it",
            )
        camera = read_document(path, _GlobalCamera)
        return camera.width, camera.height

    def files(self, scene_id: int, im_id: int, objects: Iterable[int]) -> dict[str, Path]:
        """Files that the truth of an image and of these objects comes from, by their names.

        Args:
            scene_id, im_id: of the image.
            objects: numbers of the objects.
        """
        paths = [self.file(scene_id, name) for name in ("gt", "gt_info", "camera")]
        paths += sorted(self.root.glob(f"{self.split.partition('_')[0]}_targets_*bop*.json"))
        models = model_paths(self.root, objects)
        found = {path.name: path for path in (*paths, *models) if path.is_file()}
        return found | {"depth": self._depth_file(scene_id, im_id)}

    def _depth_file(self, scene_id: int, im_id: int) -> Path:
        path = self.pictures(scene_id, "depth") / f"{im_id:06d}.png"
        tiff = path.with_suffix(".tif")  # ITODD
        return tiff if not path.is_file() and tiff.is_file() else path

    def _depth(self, scene_id: int, im_id: int, size: tuple[int, int]) -> NDArray[np.float32]:
        path = self._depth_file(scene_id, im_id)
        if not path.is_file():
            raise ToolkitError("VSD needs the image's depth", path=path)
        return depth_files.read_foreign_depth(path, size=size).values.astype(np.float32)

    def model(self, obj_id: int) -> BopModel:
        """A model, from models_eval/ where there is one, else models/.

        Raises:
            ToolkitError: the model is missing or damaged.
        """
        return read_model(self.root, obj_id, symmetry_steps=self.symmetry_steps)


def _size_of(path: Path) -> tuple[int, int]:
    return tiff_size(path) if path.suffix.lower() in TIFF_SUFFIXES else image_size(path)
