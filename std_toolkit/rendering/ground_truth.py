"""Rendered ground truth on disk: what a frame's files are called, and how to read them.

A frame is finished when `gt/info/NNNNNN.json` is there; it is written last and names the digests
of the inputs it was made from and of the files it stands for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.rendering import encoding
from std_toolkit.scene.model import Count, Document, ObjectId, Pose16, pose_from_list
from std_toolkit.scene.scene import Scene

Policy = Literal["models", "sensor", "fused"]
FOLDER = "gt"
_FILES = {"depth": "exr", "mask": "png", "nocs": "png", "normals": "png"}


class ObjectTruth(Document, frozen=True, kw_only=True):
    """One object in one frame.

    Boxes are [x_min, y_min, x_max, y_max]: the outermost pixels that belong to the object (BOP's
    width is x_max - x_min, COCO's one more). Null when no pixel does.

    Attributes:
        object: object id, its value in the mask.
        T_cam_obj: mesh to camera as rendered, 16 numbers row-major, metres.
        px_all: pixels of the silhouette alone, hidden ones included, on a canvas of 3 x 3 images.
        px_valid: those inside the image where the sensor measured a depth (all inside the image
            when the frame has no sensor depth).
        px_visible: pixels in the mask.
        visible_fraction: px_visible / px_all, 0 when px_all is 0.
        bbox_amodal: box of the silhouette; may reach beyond the image, never beyond the canvas.
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
        """`T_cam_obj` as a transform."""
        return pose_from_list(self.T_cam_obj)


class FrameTruth(Document, frozen=True, kw_only=True):
    """gt/info/NNNNNN.json: how a frame's ground truth was made, and its numbers.

    Attributes:
        frame: frame id.
        policy: what occludes besides the labelled objects themselves: nothing ("models"), the
            frame's sensor depth ("sensor"), or geometry fused from many frames ("fused").
        delta_m: how far in front of an object the sensor depth or the fused geometry must lie to
            hide it, as a difference of distances from the camera; null for "models".
        renderer: "pyrender", "raycast" or a plug-in's name.
        smooth_normals: whether normals are interpolated within a triangle.
        objects: in order of object id.
        version: of the toolkit.
        inputs: digest of camera, meshes and depth scale: with other ones the maps are stale.
        digest: of everything that determines the files.
        outputs: path relative to the scene folder, to digest of the content.
    """

    frame: Count
    policy: Policy
    delta_m: float | None
    renderer: str
    smooth_normals: bool
    objects: list[ObjectTruth]
    version: str
    inputs: str
    digest: str
    outputs: dict[str, str]

    def of(self, object_id: int) -> ObjectTruth:
        """The row of an object.

        Raises:
            ToolkitError: it has none in this frame.
        """
        for row in self.objects:
            if row.object == object_id:
                return row
        raise ToolkitError("object has no ground truth in this frame", value=object_id)


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """The maps of one frame, each read when first asked for.

    Occluded pixels count as background in every map: ground truth covers what can be seen of the
    labelled objects and nothing else.

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
        return encoding.load_depth(self.paths["depth"], self.size)

    @cached_property
    def mask(self) -> np.ndarray:
        return encoding.load_mask(self.paths["mask"], self.size)

    @cached_property
    def nocs(self) -> np.ndarray:
        return encoding.load_nocs(self.paths["nocs"], self.size)

    @cached_property
    def normals(self) -> np.ndarray:
        return encoding.load_normals(self.paths["normals"], self.size)


def info_path(root: Path, frame_id: int) -> Path:
    """Where a frame's `FrameTruth` is."""
    return root / FOLDER / "info" / f"{frame_id:06d}.json"


def map_paths(root: Path, frame_id: int) -> dict[str, Path]:
    """Paths of a frame's maps by name: depth, mask, nocs, normals."""
    return {
        name: root / FOLDER / name / f"{frame_id:06d}.{suffix}" for name, suffix in _FILES.items()
    }


def rendered_frames(scene: Scene) -> list[int]:
    """Ids of the frames whose ground truth is finished, rising."""
    folder = scene.root / FOLDER / "info"
    known = {f.id for f in scene.frames}
    found = (int(p.stem) for p in folder.glob("*.json") if p.stem.isdigit())
    return sorted(i for i in found if i in known)


def read_frame_truth(scene: Scene, frame_id: int) -> FrameTruth:
    """The numbers of a frame, without its maps.

    Raises:
        ToolkitError: the frame was not rendered, or its record is damaged.
    """
    path = info_path(scene.root, frame_id)
    if not path.is_file():
        raise ToolkitError(
            "this frame has no ground truth", path=path, hint="run `std-curate render` first"
        )
    return read_document(path, FrameTruth)


def read_ground_truth(scene: Scene, frame_id: int) -> GroundTruth:
    """The ground truth of a frame.

    Raises:
        ToolkitError: the frame was not rendered or a file is missing; a damaged map is told when
            it is read.
    """
    info = read_frame_truth(scene, frame_id)
    paths = map_paths(scene.root, frame_id)
    for path in paths.values():
        if not path.is_file():
            raise ToolkitError("map is missing", path=path, hint="run `std-curate render` again")
    return GroundTruth(info, paths, scene.camera(scene.frame(frame_id)).size)
