"""Arrangements of real objects from GraspNet-1Billion: object models and their poses on the table.

Layout below the data set's folder, as the authors' reader and evaluation use it
(github.com/graspnet/graspnetAPI: utils/xmlhandler.py, utils/utils.py, graspnet_eval.py):

- `models/<object, 3 digits>/textured.obj`, `nontextured.ply`: scanned models in metres.
- `scenes/scene_<4 digits>/<realsense|kinect>/annotations/<image, 4 digits>.xml`: a list of `obj`
  with `obj_id`, `obj_name`, `obj_path`, `pos_in_world` (x y z, metres) and `ori_in_world`
  (w x y z). Despite their names they map the model to the camera of that image.
- `.../camera_poses.npy`: (N, 4, 4), camera of image i to camera of image 0.
- `.../cam0_wrt_table.npy`: (4, 4), camera of image 0 to the table, whose top is z = 0, z up.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors.assets.asset import Asset
from sensors.assets.mesh_file import read_asset
from sensors.physics.convex import convex_parts
from sensors.physics.rigid_bodies import PhysicalObject, settle_from
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import load_mesh, nocs_frame
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.foreign_files import read_npy

CAMERAS = ("realsense", "kinect")
_MODELS = ("textured.obj", "nontextured.ply")


@dataclass(frozen=True)
class PlacedModel:
    """A model at its annotated pose.

    Attributes:
        model: object number.
        T_world_model: model file's frame to the world: z up, the table at z = 0, metres.
    """

    model: int
    T_world_model: SE3


class GraspNetScenes:
    """Arrangements below a GraspNet-1Billion folder.

    Args:
        root: folder that contains `scenes` and `models`.
        camera: camera of the annotations, "realsense" or "kinect".

    Raises:
        ToolkitError: no such folder, or an unknown camera.
    """

    def __init__(self, root: Path, *, camera: str = "realsense") -> None:
        if camera not in CAMERAS:
            raise ToolkitError(f"one of {CAMERAS}", field="camera", value=camera)
        if not (root / "scenes").is_dir():
            raise ToolkitError(
                "not a GraspNet-1Billion folder: it holds no folder `scenes`", path=root
            )
        self._root, self._camera = root, camera

    def scenes(self) -> list[int]:
        """Numbers of the scenes that have an annotation."""
        found = self._root.glob(f"scenes/scene_[0-9][0-9][0-9][0-9]/{self._camera}/annotations")
        return sorted(int(p.parent.parent.name[-4:]) for p in found)

    def images(self, scene: int) -> list[int]:
        """Numbers of the annotated images of a scene."""
        found = self._folder(scene).glob("annotations/[0-9][0-9][0-9][0-9].xml")
        return sorted(int(path.stem) for path in found)

    def camera_pose(self, scene: int, *, image: int = 0) -> SE3:
        """T_world_cam of an image; the world is that of `placed`.

        Raises:
            ToolkitError: a file is missing or malformed.
        """
        folder = self._folder(scene)
        T_world_cam0 = _pose(_array(folder / "cam0_wrt_table.npy"), folder / "cam0_wrt_table.npy")
        path = folder / "camera_poses.npy"
        cameras = _array(path)
        if cameras.ndim != 3 or not 0 <= image < len(cameras):
            raise ToolkitError("no camera pose for this image", path=path, value=image)
        return T_world_cam0 @ _pose(cameras[image], path)

    def in_camera(self, scene: int, *, image: int = 0) -> list[tuple[int, SE3]]:
        """Object numbers and T_cam_model of an image, as annotated.

        Raises:
            ToolkitError: the annotation is missing or malformed.
        """
        return _annotated(self._folder(scene) / "annotations" / f"{image:04d}.xml")

    def intrinsics(self, scene: int) -> tuple[float, float, float, float]:
        """fx, fy, cx, cy of the camera, pixels.

        Raises:
            ToolkitError: the file is missing or malformed.
        """
        path = self._folder(scene) / "camK.npy"
        K = _array(path)
        if K.shape != (3, 3):
            raise ToolkitError("needs a camera matrix", path=path, value=K.shape)
        return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])

    def picture(self, scene: int, *, image: int = 0) -> Path:
        """The colour image."""
        return self._folder(scene) / "rgb" / f"{image:04d}.png"

    def mesh_path(self, number: int) -> Path:
        """The file of a model.

        Raises:
            ToolkitError: no such model.
        """
        folder = self._root / "models" / f"{number:03d}"
        path = next((folder / m for m in _MODELS if (folder / m).is_file()), None)
        if path is None:
            raise ToolkitError(f"the model has none of {_MODELS}", path=folder)
        return path

    def placed(self, scene: int, *, image: int = 0) -> list[PlacedModel]:
        """Poses of the models of a scene, as annotated in one of its images.

        Raises:
            ToolkitError: a file is missing or malformed.
        """
        T_world_cam = self.camera_pose(scene, image=image)
        return [PlacedModel(k, T_world_cam @ T) for k, T in self.in_camera(scene, image=image)]

    def _folder(self, scene: int) -> Path:
        return self._root / "scenes" / f"scene_{scene:04d}" / self._camera

    def model(self, number: int) -> tuple[Asset, NDArray[np.float64]]:
        """A scanned model as an asset of its real size, and its centre (3,) in the model's frame.

        Raises:
            ToolkitError: no such model, or its file cannot be used.
        """
        path = self.mesh_path(number)
        centre, _ = nocs_frame(load_mesh(path))
        asset = read_asset(path, asset_id=f"graspnet-{number:03d}", category="other", unit="m")
        return asset, centre

    def arrangement(
        self, scene: int, *, image: int = 0, cache: Path | None = None
    ) -> tuple[list[PhysicalObject], list[SE3]]:
        """The objects of a scene and their poses at rest: T_world_obj of centred objects.

        The annotated poses overlap or float by some millimetres; the objects are dropped to rest.

        Args:
            cache: folder of convex parts, see `convex_parts`.

        Raises:
            ToolkitError: as `placed` and `model`; or they do not come to rest.
        """
        objects, poses = [], []
        for placed in self.placed(scene, image=image):
            asset, centre = self.model(placed.model)
            assert asset.diagonal_m is not None
            parts = convex_parts(asset, cache)
            objects.append(PhysicalObject(asset, asset.diagonal_m, parts))
            poses.append(SE3(placed.T_world_model.R, placed.T_world_model @ centre))
        return objects, settle_from(objects, poses)


def _array(path: Path) -> NDArray[np.float64]:
    return np.asarray(read_npy(path), dtype=np.float64)


def _pose(matrix: NDArray[np.float64], path: Path) -> SE3:
    try:
        return SE3.from_matrix(matrix)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, value=error.value) from error


def _annotated(path: Path) -> list[tuple[int, SE3]]:
    """Object numbers and T_cam_model of an annotation."""
    try:
        rows = ET.parse(path).getroot().findall("obj")
    except FileNotFoundError as error:
        raise ToolkitError("no annotation of this image", path=path) from error
    except (OSError, ET.ParseError) as error:
        raise ToolkitError(f"not an annotation: {error}", path=path) from error
    if not rows:
        raise ToolkitError("the annotation names no object", path=path)
    return [_row(row, path, f"obj[{k}]") for k, row in enumerate(rows)]


def _row(row: ET.Element, path: Path, field: str) -> tuple[int, SE3]:
    (number,) = _numbers(row, "obj_id", 1, path, field)
    if number < 0 or number != int(number):
        raise ToolkitError("not an object number", path=path, field=f"{field}.obj_id", value=number)
    t = _numbers(row, "pos_in_world", 3, path, field)
    wxyz = _numbers(row, "ori_in_world", 4, path, field)
    try:
        return int(number), SE3.from_quat(wxyz, t)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, field=field, value=error.value) from error


def _numbers(row: ET.Element, tag: str, count: int, path: Path, field: str) -> Sequence[float]:
    text = row.findtext(tag, default="").split()
    try:
        values = [float(word) for word in text]
    except ValueError:
        values = []
    if len(values) != count or not np.isfinite(values).all():
        raise ToolkitError(
            f"{count} numbers expected", path=path, field=f"{field}.{tag}", value=" ".join(text)
        )
    return values
