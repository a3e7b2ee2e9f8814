"""Input of the writers: one record per scene and one per frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera, Symmetry
from std_toolkit.geometry.mesh import LARGEST_EXTENT_M, SMALLEST_EXTENT_M, nocs_frame
from std_toolkit.io.documents import document_bytes
from std_toolkit.scene.document import check_name
from std_toolkit.scene.model import CATEGORY_CLASS_IDS, MATERIAL_IDS, Material

if TYPE_CHECKING:
    import trimesh

Image8 = NDArray[np.uint8]
Map = NDArray[np.float32]
# Beyond the range of any such sensor and any room; larger values have another unit or are sky.
LARGEST_DEPTH_M = 1000.0
# Tolerance of unit normals in float32, interpolated within a triangle and normalised.
_UNIT = 1e-3
# Tolerance from the rounding of float32 mesh files.
_CANONICAL = 1e-5
# Tolerance of a canonical coordinate computed from float32 depth.
_ROUNDING = 1e-4
# Fraction of object pixels that may lack a normal: degenerate triangles have none.
_NO_NORMAL = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedObject:
    """An object of a simulated scene.

    Attributes:
        instance_id: 1..254, its value in masks.
        asset_id: of the asset; a safe name. Two objects with the same id have the same mesh.
        category: such as "mug".
        class_id: of the category in the DREDS and STD layouts, 0 for any other.
        material_class: raw, diffuse, transparent or specular.
        scale_m: factor from the canonical mesh to metres; the diagonal of the bounding box.
        T_world_obj: canonical frame, scaled to metres, to world.
        mesh: canonical: bounding box centred, its diagonal 1, y up.
        symmetry: in the canonical frame.

    Raises:
        ToolkitError: an id, name or size out of range, or a mesh outside the canonical frame.
    """

    instance_id: int
    asset_id: str
    category: str
    class_id: int
    material_class: Material
    scale_m: float
    T_world_obj: SE3
    mesh: trimesh.Trimesh
    symmetry: Symmetry = field(default_factory=Symmetry)

    def __post_init__(self) -> None:
        check_name(self.asset_id, field="asset_id")
        check_name(self.category, field="category")
        if not 1 <= self.instance_id <= 254:
            raise ToolkitError("must lie in 1..254", field="instance_id", value=self.instance_id)
        if self.class_id != CATEGORY_CLASS_IDS.get(self.category, 0):
            raise ToolkitError(
                f"is not the class of {self.category}", field="class_id", value=self.class_id
            )
        if self.material_class not in MATERIAL_IDS:
            raise ToolkitError(
                "unknown material class",
                field="material_class",
                value=self.material_class,
                hint=f"one of {tuple(MATERIAL_IDS)}",
            )
        if not SMALLEST_EXTENT_M <= self.scale_m <= LARGEST_EXTENT_M:
            raise ToolkitError("implausible in metres", field="scale_m", value=self.scale_m)
        if len(self.mesh.faces) == 0:
            raise ToolkitError("the mesh has no faces", field="mesh", value=self.asset_id)
        centre, diagonal = nocs_frame(self.mesh)
        if np.abs(centre).max() > _CANONICAL or abs(diagonal - 1) > 10 * _CANONICAL:
            raise ToolkitError(
                "the mesh is not centred with a bounding-box diagonal of 1",
                field="mesh",
                value=(self.asset_id, centre.tolist(), diagonal),
            )
        _check_poses(self.T_world_obj)


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedScene:
    """Properties shared by all frames of a simulated scene.

    Attributes:
        name: safe name; the public DREDS has five digits, as "00017".
        seed: seed of the scene.
        sensor: name of the sensor specification.
        frames: number of frames.
        objects: by increasing instance id.
        parameters: everything that the scene was generated from, JSON-serialisable.
        baseline_m: from the left infrared camera to the right one; None with one camera.
        indices: of the frames, ascending; empty for 0, 1, ...

    Raises:
        ToolkitError: ids that do not increase, one asset with two meshes, or parameters that
            cannot be written as JSON.
    """

    name: str
    seed: int
    sensor: str
    frames: int
    objects: Sequence[SimulatedObject]
    parameters: Mapping[str, Any]
    baseline_m: float | None = None
    indices: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name)
        if self.seed < 0:
            raise ToolkitError("must not be negative", field="seed", value=self.seed)
        if self.frames < 1:
            raise ToolkitError("must be at least 1", field="frames", value=self.frames)
        ids = [o.instance_id for o in self.objects]
        if ids != sorted(set(ids)):
            raise ToolkitError("instance ids increase", field="objects", value=ids)
        if self.indices and len(self.indices) != self.frames:
            raise ToolkitError("one for each frame", field="indices", value=len(self.indices))
        shapes: dict[str, trimesh.Trimesh] = {}
        for item in self.objects:
            mesh = shapes.setdefault(item.asset_id, item.mesh)
            if mesh is not item.mesh and not (
                np.array_equal(mesh.vertices, item.mesh.vertices)
                and np.array_equal(mesh.faces, item.mesh.faces)
            ):
                raise ToolkitError(
                    "two objects of one asset have different meshes",
                    field="asset_id",
                    value=item.asset_id,
                )
        document_bytes(dict(self.parameters))

    @property
    def frame_indices(self) -> tuple[int, ...]:
        """Indices of all frames."""
        return self.indices or tuple(range(self.frames))


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedFrame:
    """One view of a simulated scene with its ground truth.

    Colour is H x W, infrared h x w. The label maps share one size, that of colour or another of the
    same aspect ratio (the public data sets have labels of half the size); their camera is
    `label_camera`. The maps in the left infrared camera also share one size, that of
    `depth_camera`.

    Attributes:
        index: of the frame in its scene.
        color: (H, W, 3) uint8 RGB.
        infrared_left, infrared_right: (h, w) uint8, the rectified pair; a camera with one infrared
            imager has no right image.
        depth_sensor: float32 z-depth in metres as measured by the sensor, left infrared camera; 0 =
            no measurement, as in every depth map here.
        depth_exact_infrared: float32 exact z-depth, left infrared camera; 0 = no surface.
        mask_infrared: uint8 instance ids, left infrared camera.
        depth_aligned: float32 label map: the sensor's depth aligned to the colour camera.
        depth_exact: float32 label map: exact z-depth of everything, table and floor included.
        mask: uint8 label map of instance ids, 0 = background.
        nocs: (., ., 3) float32 label map: canonical coordinates + 0.5, 0 in the background.
        normals: (., ., 3) float32 label map: unit normals in the colour camera's frame, towards the
            camera; 0 where there is no surface.
        T_world_cam, T_world_ir: poses of the colour and of the left infrared camera.
        color_camera, infrared_camera: intrinsics of the images.

    Raises:
        ToolkitError: an array of wrong shape or type, or an invalid value.
    """

    index: int
    color: Image8
    infrared_left: Image8
    infrared_right: Image8 | None
    depth_sensor: Map
    depth_exact_infrared: Map
    mask_infrared: Image8
    depth_aligned: Map
    depth_exact: Map
    mask: Image8
    nocs: Map
    normals: Map
    T_world_cam: SE3
    T_world_ir: SE3
    color_camera: Camera
    infrared_camera: Camera

    def __post_init__(self) -> None:
        if self.index < 0:
            raise ToolkitError("must not be negative", field="index", value=self.index)
        color, infrared = _shape(self.color_camera), _shape(self.infrared_camera)
        _check_array("color", self.color, np.uint8, (*color, 3))
        for name in ("infrared_left", "infrared_right"):
            if name == "infrared_left" or self.infrared_right is not None:
                _check_array(name, getattr(self, name), np.uint8, infrared)
        _check_proportions("mask", self.mask, self.color_camera)
        _check_proportions("depth_sensor", self.depth_sensor, self.infrared_camera)
        labels, sensor = self.mask.shape[:2], self.depth_sensor.shape[:2]
        for name, kind, shape in (
            ("depth_aligned", np.float32, labels),
            ("depth_exact", np.float32, labels),
            ("mask", np.uint8, labels),
            ("nocs", np.float32, (*labels, 3)),
            ("normals", np.float32, (*labels, 3)),
            ("depth_sensor", np.float32, sensor),
            ("depth_exact_infrared", np.float32, sensor),
            ("mask_infrared", np.uint8, sensor),
        ):
            _check_array(name, getattr(self, name), kind, shape)
        for name in ("depth_aligned", "depth_exact", "depth_sensor", "depth_exact_infrared"):
            _check_depth(name, getattr(self, name))
        _check_surfaces(self.mask, self.depth_exact, self.nocs, self.normals)
        _check_poses(self.T_world_cam, self.T_world_ir)

    @property
    def label_camera(self) -> Camera:
        """Intrinsics of the label maps."""
        height, width = self.mask.shape
        return _at_size(self.color_camera, width, height)

    @property
    def depth_camera(self) -> Camera:
        """Intrinsics of the maps in the left infrared camera."""
        height, width = self.depth_sensor.shape
        return _at_size(self.infrared_camera, width, height)

    @property
    def instances(self) -> tuple[int, ...]:
        """Increasing ids of the objects visible in either mask."""
        ids = np.flatnonzero(
            np.bincount(self.mask.ravel(), minlength=256)
            + np.bincount(self.mask_infrared.ravel(), minlength=256)
        )
        return tuple(int(i) for i in ids if i > 0)


def _shape(camera: Camera) -> tuple[int, int]:
    return camera.height, camera.width


def _at_size(camera: Camera, width: int, height: int) -> Camera:
    return camera if camera.size == (width, height) else camera.resized(width, height)


def _check_array(name: str, array: Any, kind: type, shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != kind or array.shape != shape:
        found = (
            f"{array.dtype} {array.shape}"
            if isinstance(array, np.ndarray)
            else type(array).__name__
        )
        raise ToolkitError(f"must be {np.dtype(kind)} {shape}", field=name, value=found)


def _check_proportions(name: str, array: Any, camera: Camera) -> None:
    if not isinstance(array, np.ndarray) or array.ndim != 2 or 0 in array.shape:
        raise ToolkitError("must be an (H, W) map", field=name, value=np.shape(array))
    height, width = array.shape
    if width * camera.height != height * camera.width:
        raise ToolkitError(
            f"has other proportions than the camera's {camera.width}x{camera.height}",
            field=name,
            value=f"{width}x{height}",
        )


def _check_depth(name: str, depth: Map) -> None:
    low, high = float(depth.min()), float(depth.max())
    # Written so that NaN, for which every comparison is false, is refused.
    if not (low >= 0 and high < LARGEST_DEPTH_M):
        raise ToolkitError(
            "z-depth is finite, in metres, and 0 where there is none",
            field=name,
            value=(low, high),
        )


def _check_surfaces(mask: Image8, depth: Map, nocs: Map, normals: Map) -> None:
    seen = mask > 0
    if not (depth[seen] > 0).all():
        raise ToolkitError("an object's pixels have a depth", field="depth_exact", value=0.0)
    low, high = float(nocs.min()), float(nocs.max())
    if not (low >= -_ROUNDING and high <= 1 + _ROUNDING) or nocs[~seen].any():
        raise ToolkitError(
            "NOCS lies in 0..1 on objects and is 0 in the background",
            field="nocs",
            value=(low, high),
        )
    length = np.einsum("ijk,ijk->ij", normals, normals)
    none = length == 0
    wrong = ~(none | (np.abs(length - 1) < 2 * _UNIT))
    if wrong.any() or np.count_nonzero(none & seen) > _NO_NORMAL * np.count_nonzero(seen):
        raise ToolkitError(
            "normals are unit vectors on objects, and 0 where nothing is",
            field="normals",
            value=float(np.sqrt(length[wrong].max())) if wrong.any() else 0.0,
        )


def _check_poses(*poses: SE3) -> None:
    for pose in poses:
        SE3.from_matrix(pose.matrix())
