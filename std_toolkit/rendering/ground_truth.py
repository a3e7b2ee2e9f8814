"""Rendered ground truth on disk: names and encoding of the files of a frame, reading and writing.

A frame is finished if `gt/info/NNNNNN.json` exists. It is written last and has the digests of the
inputs and of the files.

Encoding of the maps (data_spec.md is normative):

==========  ============================  =====================================================
map         file                          encoding
==========  ============================  =====================================================
depth       gt/depth/NNNNNN.exr           one float32 channel `Z`, metres, RLE: lossless
mask        gt/mask/NNNNNN.png            8 bit, object id, 0 = background
NOCS        gt/nocs/NNNNNN.png            3 x 16 bit RGB = XYZ, round(65535 n), background 0 0 0
normals     gt/normals/NNNNNN.png         3 x 16 bit RGB = XYZ, round(65535 (n + 1) / 2),
                                          background 0 0 0
==========  ============================  =====================================================

16 bits resolve 5 um of a 0.3 m object in NOCS and 0.001 degrees in normals. 0 0 0 encodes no valid
value of either: a NOCS point is within 0.5 of the centre of the cube, and (-1, -1, -1) is not a
unit vector.

Processor time and size per map, measured with a 1280x720 frame of six objects (155,000 object
pixels; `perf/render.py`):

- float32 EXR of depth: 14 ms and 0.62 MB with ZIP, 8 ms and 0.70 MB with RLE;
- 16-bit PNG with OpenCV's defaults: 60 ms and 0.75 MB;
- 16-bit PNG with the filter "up" and run-length matching: 18 ms and 0.68 MB;
- 16-bit PNG of `sparse_png`, which stores objects and deflates the background: 2 ms and 0.97 MB.
"""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io import atomic, documents, exr, images
from std_toolkit.jobs.artefact import Record
from std_toolkit.scene.model import Count, Document, ObjectId, Pose16, pose_from_list
from std_toolkit.scene.scene import Scene

Policy = Literal["models", "sensor", "fused"]

FOLDER = "gt"

_FILES = {"depth": "exr", "mask": "png", "nocs": "png", "normals": "png"}

# The filter "up" turns flat background and smooth ramps into runs, which run-length matching
# compresses. Trying every filter per row takes three times as long and saves 5 %.
_PNG_PARAMETERS = [cv2.IMWRITE_PNG_COMPRESSION, 1]

# Above this share of covered pixels a map is compressed as a whole.
_SPARSE = 0.5


class ObjectTruth(Document, frozen=True, kw_only=True):
    """Ground truth of one object in one frame.

    Boxes are [x_min, y_min, x_max, y_max]: the outermost pixels of the object (BOP's width is
    x_max - x_min, COCO's is one larger). Null if the object has no pixel.

    Attributes:
        object: object id, its value in the mask.
        T_cam_obj: mesh to camera as rendered, 16 numbers, row-major, metres.
        px_all: pixels of the amodal silhouette on a canvas of 3 x 3 images.
        px_valid: pixels of the amodal silhouette inside the image where the sensor measured depth
            (all inside the image if the frame has no sensor depth).
        px_visible: pixels in the mask.
        visible_fraction: px_visible / px_all, 0 if px_all is 0.
        bbox_amodal: box of the silhouette; may extend beyond the image, never beyond the canvas.
        bbox_visible: box of the pixels in the mask.
    """

    object: ObjectId
    T_cam_obj: Pose16
    px_all: Count
    px_valid: Count
    px_visible: Count
    visible_fraction: float
    bbox_amodal: list[int] | None
    bbox_visible: list[int] | None

    @property
    def pose(self) -> SE3:
        """`T_cam_obj` as SE3."""
        return pose_from_list(self.T_cam_obj)


class FrameTruth(Record, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """gt/info/NNNNNN.json: record and measurements of the ground truth of a frame.

    Attributes:
        frame: frame id.
        policy: what occludes besides the labelled objects: nothing ("models"), the sensor depth of
            the frame ("sensor"), or geometry fused from many frames ("fused").
        delta_m: how far in front of an object the sensor depth or the fused geometry must be to
            hide it, as a difference of distances from the camera, metres; null for "models".
        renderer: "pyrender", "raycast" or the name of a plug-in.
        smooth_normals: whether normals are interpolated within a triangle.
        objects: rows in order of object id.
    """

    frame: Count
    policy: Policy
    delta_m: float | None
    renderer: str
    smooth_normals: bool
    objects: list[ObjectTruth]

    def of(self, object_id: int) -> ObjectTruth:
        """Return the row of an object.

        Raises:
            ToolkitError: the object has no row in this frame.
        """
        for row in self.objects:
            if row.object == object_id:
                return row
        raise ToolkitError("object has no ground truth in this frame", value=object_id)


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The maps of one frame, each read on first access.

    Occluded pixels are background in every map: ground truth covers the visible parts of the
    labelled objects only.

    Attributes:
        info: poses, visible fractions, boxes, policy.
        depth: (H,W) float32 z-depth in metres, 0 = background.
        mask: (H,W) uint8 object id, 0 = background.
        nocs: (H,W,3) float32 in 0..1, 0 in the background.
        normals: (H,W,3) float32 unit normals, camera frame, OpenCV axes; 0 in the background.
    """

    info: FrameTruth
    paths: dict[str, Path]
    size: tuple[int, int]

    @cached_property
    def depth(self) -> np.ndarray:
        return load_depth(self.paths["depth"], self.size)

    @cached_property
    def mask(self) -> np.ndarray:
        return load_mask(self.paths["mask"], self.size)

    @cached_property
    def nocs(self) -> np.ndarray:
        return load_nocs(self.paths["nocs"], self.size)

    @cached_property
    def normals(self) -> np.ndarray:
        return load_normals(self.paths["normals"], self.size)


def info_path(root: Path, frame_id: int) -> Path:
    """Return the path of a frame's `FrameTruth`."""
    return Path(info_name(str(root), frame_id))


def info_name(root: str, frame_id: int) -> str:
    """Return `info_path` as text, which is quicker for thousands of frames."""
    return f"{root}/{FOLDER}/info/{frame_id:06d}.json"


def map_paths(root: Path, frame_id: int) -> dict[str, Path]:
    """Return the paths of a frame's maps by name: depth, mask, nocs, normals."""
    return {
        name: root / FOLDER / name / f"{frame_id:06d}.{suffix}" for name, suffix in _FILES.items()
    }


def rendered_frames(scene: Scene) -> list[int]:
    """Return the ids of the frames with finished ground truth, in ascending order."""
    try:
        names = os.listdir(scene.root / FOLDER / "info")  # noqa: PTH208 - only names
    except OSError:
        return []
    known = {f.id for f in scene.frames}
    stems = (name.removesuffix(".json") for name in names if name.endswith(".json"))
    return sorted(i for i in (int(stem) for stem in stems if stem.isdecimal()) if i in known)


def read_frame_truth(scene: Scene, frame_id: int) -> FrameTruth:
    """Read the measurements of a frame, without its maps.

    Raises:
        ToolkitError: the frame was not rendered, or its record is damaged.
    """
    path = info_path(scene.root, frame_id)
    if not path.is_file():
        raise ToolkitError(
            "this frame has no ground truth", path=path, hint="run `std-curate render` first"
        )
    try:
        return documents.read_document(path, FrameTruth)
    except ToolkitError as error:
        hint = "damaged, or of another version of the toolkit: run `std-curate render` again"
        raise ToolkitError(
            error.problem, path=path, field=error.field, value=error.value, hint=hint
        ) from error


def read_ground_truth(scene: Scene, frame_id: int) -> GroundTruth:
    """Return the ground truth of a frame.

    Raises:
        ToolkitError: the frame was not rendered or a file is missing. A damaged map raises on
            first access.
    """
    info = read_frame_truth(scene, frame_id)
    paths = map_paths(scene.root, frame_id)
    for path in paths.values():
        if not path.is_file():
            raise ToolkitError("map is missing", path=path, hint="run `std-curate render` again")
    return GroundTruth(info, paths, scene.camera(scene.frame(frame_id)).size)


if hasattr(cv2, "IMWRITE_PNG_FILTER"):
    _PNG_PARAMETERS += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]


_PNG_PARAMETERS += [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]


def write_depth(path: Path, depth: np.ndarray) -> None:
    """Write (H,W) float32 z-depth in metres, 0 = background, lossless."""
    exr.write_exr(path, {"Z": np.ascontiguousarray(depth, np.float32)}, compression="rle")


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write an (H,W) uint8 mask of object ids, 0 = background."""
    _write_png(path, np.ascontiguousarray(mask, np.uint8))


def write_nocs(path: Path, nocs: np.ndarray, mask: np.ndarray) -> None:
    """Write (H,W,3) float32 NOCS coordinates in 0..1 of the pixels where `mask` is not 0."""
    _write_triples(path, _scaled(nocs, 65535.0, 0.0), mask)


def write_normals(path: Path, normals: np.ndarray, mask: np.ndarray) -> None:
    """Write (H,W,3) float32 unit normals of the pixels where `mask` is not 0."""
    _write_triples(path, _scaled(normals, 32767.5, 32767.5), mask)


def load_depth(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read (H,W) float32 z-depth in metres."""
    return images.read_depth(path, scale=None, size=size)


def load_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read an (H,W) uint8 mask of object ids."""
    return images.read_mask(path, size=size)


def load_nocs(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read (H,W,3) float32 NOCS coordinates in 0..1, 0 in the background."""
    return _load_triples(path, size).astype(np.float32) / np.float32(65535)


def load_normals(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Read (H,W,3) float32 unit normals, 0 in the background."""
    stored = _load_triples(path, size)
    normals = stored.astype(np.float32) / np.float32(32767.5) - np.float32(1)
    normals[~stored.any(axis=2)] = 0
    return normals


def _load_triples(path: Path, size: tuple[int, int]) -> np.ndarray:
    image = images.read_png(path, size=size)
    if image.ndim != 3 or image.dtype != np.uint16:
        raise ToolkitError(
            "expected a 16-bit RGB image", path=path, value=f"{image.dtype} {image.shape}"
        )
    return image


def _scaled(values: np.ndarray, factor: float, offset: float) -> np.ndarray:
    """round(factor x + offset) within 0..65535, as uint16."""
    values = np.ascontiguousarray(values, np.float32)
    return np.asarray(cv2.addWeighted(values, factor, values, 0, offset, dtype=cv2.CV_16U))


def _write_triples(path: Path, stored: np.ndarray, mask: np.ndarray) -> None:
    covered = np.ascontiguousarray(mask != 0, np.uint8)
    if cv2.countNonZero(covered) > _SPARSE * covered.size:
        _write_png(path, np.asarray(cv2.bitwise_and(stored, stored, mask=covered)))
    else:
        from std_toolkit.io.sparse_png import sparse_png  # loads numba

        atomic.write_bytes_atomic(path, sparse_png(stored, covered))


def _write_png(path: Path, image: np.ndarray) -> None:
    pixels = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, data = cv2.imencode(".png", pixels, _PNG_PARAMETERS)
    if not done:
        raise ToolkitError("cannot encode the image", path=path)
    atomic.write_bytes_atomic(path, data.data)
