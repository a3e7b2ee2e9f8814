"""TODD: glass vessels by a D435i on an arm.

<root>/test/FRAME/image.jpg, depth.exr, detph_GroundTruth.exr (sic)      metres
<root>/test/FRAME/instance_segment.png            red: 10, 20, ... for the objects 0, 1, ...
<root>/test/FRAME/pose_type.json                  by object: "pose", 3x4

Frames are named by their time. The camera is that of the authors' loader. Zero and 255 of the mask
are no object. That `pose` maps the object to the camera is not verified; its unit is told by how
far the objects are.

Source: `dataloaders/dataset_TODD.py` of github.com/ac-rad/MVTrans, and
`saic_depth_completion/data/datasets/franka_scan.py` and `grnet_point_cloud_completion/datasets/` of
github.com/pairlab/TranspareNet. Not checked on the authors' files.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import pose_of, unit_of_place, whole_number
from benchmark.data.field.source import (
    COLOR,
    MASK,
    RAW,
    TRUTH,
    FieldFrames,
    Files,
    Maps,
    known_ids,
    read_ids,
)
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.loading import FrameIndex, SceneFolder, check_same_size, read_depth_map
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.documents import read_document

Part = Literal["train", "val", "test"]

_CAMERA = Camera(640, 480, 613.9624633789062, 613.75634765625, 324.4471435546875, 239.1712188720703)
_POSES = "pose_type.json"
_FILES = {
    COLOR: "image.jpg", RAW: "depth.exr", TRUTH: "detph_GroundTruth.exr",
    MASK: "instance_segment.png",
}  # fmt: skip
_STEP = 10  # between the mask's numbers of two objects

_Row = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]
_Rows = Annotated[list[_Row], msgspec.Meta(min_length=3, max_length=4)]


class _Object(msgspec.Struct, frozen=True):
    pose: _Rows


@dataclass(frozen=True)
class Todd(FieldFrames):
    """Frames of a part; mask ids are the numbers in the mask."""

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        return {what: Path(scene.path) / stem / name for what, name in _FILES.items()}

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        true, ids = read_depth_map(files[TRUTH]), read_ids(files[MASK], channel=0)
        check_same_size(files[MASK], ids, true, "mask")
        width, height = true.shape[1], true.shape[0]
        if width * _CAMERA.height != height * _CAMERA.width:
            raise ToolkitError(
                f"the camera of TODD is known at {_CAMERA.width}x{_CAMERA.height}",
                path=files[TRUTH], value=f"{width}x{height}",
            )  # fmt: skip
        camera = _CAMERA if _CAMERA.size == (width, height) else _CAMERA.resized(width, height)
        found = [int(i) for i in np.unique(ids) if i not in (0, BACKGROUND)]
        instances = tuple(Instance(i, 0, Material.TRANSPARENT) for i in found)
        return Maps(true, known_ids(ids, found), camera, instances)

    def raw(self, scene: SceneFolder, stem: str, path: Path) -> NDArray[np.float32]:  # noqa: ARG002
        """See `FieldFrames`."""
        return read_depth_map(path)

    def poses(self, index: int) -> dict[int, SE3]:
        """Return `pose` as filed, in metres, by mask id; none without the file."""
        scene, stem = self.index.at(index)
        path = Path(scene.path) / stem / _POSES
        if not path.is_file():
            return {}
        found = {}
        for key, item in read_document(path, dict[str, _Object]).items():
            mask_id = (whole_number(key) + 1) * _STEP
            if not 0 < mask_id < BACKGROUND:
                raise ToolkitError("expected the number of an object", path=path, field=key)
            T = np.array(item.pose)
            t = T[:3, 3] * unit_of_place(T[:3, 3], path, Path(scene.path))
            found[mask_id] = pose_of(T[:3, :3], t, path)
        return dict(sorted(found.items()))


def open_todd(name: str, root: Path, part: Part) -> Todd:
    """List the frames of a part.

    Args:
        name: of the split.
        root: folder of `train`, `val` and `test`, or one above it.
        part: of the set; archives unpack to `test/test` as well.
    """
    places = (root, *(root / a / part for a in ("", part)), *sorted(root.glob(f"*/{part}")))
    for top in places:
        stems = {p.parent.name for n in _FILES.values() for p in top.glob(f"*/{n}")}
        if top.name == part and stems:
            ordered = tuple(sorted(stems, key=natural_key))
            return Todd(name, FrameIndex((SceneFolder(part, str(top), ordered),)))
    return Todd(name, FrameIndex(()))
