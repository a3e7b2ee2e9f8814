"""Syn-TODD: simulated glass vessels, as published in pickles.

<root>/synthetic_test_pkl/UID.pickle.zstd           UID is scene * 100 + camera

The pickles hold objects of the authors' programs: their fields are read, nothing is run. No sensor
was simulated: there is no raw depth. True depth is exact, in half precision, and cut at 3 m. The
right images are not read: their users call them invalid.

Boxes are filed so that K alone mirrors the columns of their projections: the frame has Blender's
axes (x right, y up, looking along -z), and the image's principal point is W - cx. Poses are turned
to OpenCV's axes. Pickles do not say which pixels are whose: each pose goes to the object whose
pixels fill its box best, and to none if that is not clear.

Source: `dataloaders/` of github.com/ac-rad/MVTrans; for the bad frames `data/` of
github.com/songlin/d3roma. Not checked on the authors' files.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.data.field.places import camera_of, pose_of
from benchmark.data.field.source import COLOR, MASK, TRUTH, FieldFrames, Files, Maps, known_ids
from benchmark.data.frame import BACKGROUND, Instance, Material
from benchmark.data.loading import FrameIndex, SceneFolder, check_same_size
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3, Camera
from std_toolkit.importers.foreign_files import natural_key
from std_toolkit.io.images import decode_color
from std_toolkit.io.plain_pickle import array_in, read_pickle

Part = Literal["train", "val", "test"]

FARTHEST_M = 3.0
BAD_FRAMES = ("16346", "131150", "133800", "146643")
_PICKLE = re.compile(r"([0-9]{1,9})\.pickle\.zstd")
_MODULES = ("dataloaders.template", "src.lib.datapoint", "simnet.lib.datapoint")
RECORDS = tuple(
    (module, name)
    for module in _MODULES
    for name in ("Panoptic", "Stereo", "OBB", "Detection", "Pose", "Keypoint")
)
_FIRST_OBJECT = 2  # after nothing and the table
_CLEAR = 0.4  # share of box and box of pixels that a pose's own object has at least
_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SynTodd(FieldFrames):
    """Frames in pickles; mask ids are the set's."""

    def paths(self, scene: SceneFolder, stem: str) -> Files:
        path = Path(scene.path) / f"{stem}.pickle.zstd"
        return dict.fromkeys((COLOR, TRUTH, MASK), path)

    def color(self, path: Path) -> NDArray[np.uint8]:
        """See `FieldFrames`; the left image."""
        left = field_of(self._record(path), path, "stereo", "left_color")
        if isinstance(left, bytes):
            return decode_color(left, path)
        image = array_in(left, path, "left_color")
        if image.ndim != 3 or image.shape[2] != 3:
            raise ToolkitError("no colour image", path=path, field="left_color", value=image.shape)
        if not ((image >= 0) & (image <= 255) & (image % 1 == 0)).all():
            raise ToolkitError(
                "a colour image holds whole numbers from 0 to 255", path=path, field="left_color",
                value=[float(image.min()), float(image.max())],
            )  # fmt: skip
        return image.astype(np.uint8)

    def maps(self, scene: SceneFolder, stem: str, files: Mapping[str, Path]) -> Maps:  # noqa: ARG002
        path = files[TRUTH]
        record = self._record(path)
        true = true_depth(array_in(field_of(record, path, "depth"), path, "depth"), path)
        ids = _ids(record, path)
        check_same_size(path, ids, true, "instance_segmentation")
        camera = image_camera(field_of(record, path, "camera_params"), true.shape, path)
        names = {i: name for i, (name, _) in _linked(record, ids, path).items()}
        found = [int(i) for i in np.unique(ids) if i >= _FIRST_OBJECT]
        instances = tuple(
            Instance(i, 0, Material.TRANSPARENT, model=names.get(i, "")) for i in found
        )
        return Maps(true, known_ids(ids, found), camera, instances)

    def poses(self, index: int) -> dict[int, SE3]:
        """See `FieldFrames`; only of objects whose pixels are clear."""
        path = self.paths(*self.index.at(index))[TRUTH]
        record = self._record(path)
        linked = _linked(record, _ids(record, path), path)
        return {i: opencv_pose(T, path, name) for i, (name, T) in linked.items()}

    def camera_pose(self, index: int) -> SE3 | None:
        """See `FieldFrames`."""
        path = self.paths(*self.index.at(index))[TRUTH]
        return world_pose(field_of(self._record(path), path, "camera_params"), path)

    def notes(self) -> Sequence[str]:
        """See `FieldFrames`."""
        bad = [s for _, s in self.index if s in BAD_FRAMES]
        return [f"frames that other users call bad: {', '.join(bad)}"] if bad else []

    def _record(self, path: Path) -> Any:
        if str(path) not in self._kept:
            record = read_pickle(path, records=RECORDS)
            self._kept.clear()
            self._kept[str(path)] = record
        return self._kept[str(path)]


def true_depth(depth: NDArray[Any], path: Path) -> NDArray[np.float32]:
    """Return exact depth below 3 m, 0 elsewhere, where the authors' loader writes 3.

    Raises:
        ToolkitError: no map, or nothing in it is so near.
    """
    if depth.ndim != 2:
        raise ToolkitError("no depth map", path=path, value=depth.shape)
    near = (depth > 0) & (depth < FARTHEST_M)  # comparisons with NaN are false
    if not near.any():
        raise ToolkitError(f"no depth below {FARTHEST_M:g} m: not in metres?", path=path)
    return np.where(near, depth, 0).astype(np.float32)


def image_camera(filed: Any, shape: tuple[int, ...], path: Path) -> Camera:
    """Return the camera of the image from fields of the set.

    Args:
        filed: camera_intrinsic, and resolution_x and resolution_y.
        shape: of the true depth.
        path: of the file, for errors.

    Raises:
        ToolkitError: not such fields, or another shape.
    """
    K = array_in(field_of(filed, path, "camera_intrinsic"), path, "camera_intrinsic")
    sizes = [array_in(field_of(filed, path, f"resolution_{a}"), path, "resolution") for a in "xy"]
    if K.shape != (3, 3) or any(s.size != 1 or not 1 <= s < 2**15 for s in sizes):
        raise ToolkitError("no camera", path=path, field="camera_intrinsic", value=K.shape)
    width, height = (int(s.ravel()[0]) for s in sizes)
    K = K.copy()
    K[0, 2] = width - K[0, 2]  # columns of the filed projection run the other way
    camera = camera_of(K, (width, height), path)
    if shape[1] * height != shape[0] * width:
        raise ToolkitError(
            f"depth has other proportions than its camera, {width}x{height}", path=path,
            value=f"{shape[1]}x{shape[0]}",
        )  # fmt: skip
    return camera if camera.size == shape[::-1] else camera.resized(shape[1], shape[0])


def opencv_pose(T: NDArray[np.float64], path: Path, name: str) -> SE3:
    """Return `T_cam_obj` of a 4x4 matrix in Blender's axes.

    Raises:
        ToolkitError: no pose, or behind the camera.
    """
    if T.shape != (4, 4):
        raise ToolkitError("must be 4x4", path=path, field=name, value=T.shape)
    if T[2, 3] >= 0:
        raise ToolkitError(
            "lies behind the camera in Blender's axes, which this set is read in", path=path,
            field=name, value=f"z = {T[2, 3]:g}",
        )  # fmt: skip
    turned = _OPENCV @ T
    return pose_of(turned[:3, :3], turned[:3, 3], path)


def world_pose(filed: Any, path: Path) -> SE3 | None:
    """Return `T_world_cam` from location and quaternion of a camera of Blender; None without."""
    if not isinstance(filed, dict):
        return None
    place, turn = filed.get("camera_location"), filed.get("quaternion_WXYZ")
    if place is None or turn is None:
        return None
    t = array_in(place, path, "camera_location").ravel()
    q = array_in(turn, path, "quaternion_WXYZ").ravel()
    if (
        t.shape != (3,)
        or not np.isfinite(t).all()
        or q.shape != (4,)
        or not abs(np.linalg.norm(q) - 1) < 1e-3
    ):
        raise ToolkitError("no pose of the camera", path=path, field="quaternion_WXYZ")
    return SE3.from_quat(q / np.linalg.norm(q), t) @ SE3.from_matrix(_OPENCV)


def field_of(record: Any, path: Path, *names: str) -> Any:
    """Return a field of a field of a record.

    Raises:
        ToolkitError: it is missing.
    """
    for name in names:
        if not isinstance(record, dict) or name not in record:
            raise ToolkitError("the field is missing", path=path, field=name)
        record = record[name]
    return record


def _ids(record: Any, path: Path) -> NDArray[np.int64]:
    field = "instance_segmentation"
    values = array_in(field_of(record, path, field), path, field)
    if values.ndim != 2 or not ((values >= 0) & (values < BACKGROUND) & (values % 1 == 0)).all():
        raise ToolkitError("must be ids below 255", path=path, field=field, value=values.shape)
    return values.astype(np.int64)


def _linked(
    record: Any, ids: NDArray[np.int64], path: Path
) -> dict[int, tuple[str, NDArray[np.float64]]]:
    """Name and matrix of the objects by mask id, where box and pixels belong together."""
    named, boxes = [], []
    listed = field_of(record, path, "detections") or []
    if not isinstance(listed, list | tuple) or len(listed) > BACKGROUND:
        raise ToolkitError(f"expected a list of at most {BACKGROUND}", path=path,
                           field="detections")  # fmt: skip
    for item in listed:
        name = item.get("object_name") if isinstance(item, dict) else None
        if not name or item.get("bbox") is None:  # the table has no name
            continue
        box = array_in(item["bbox"], path, "bbox").ravel()
        if box.shape == (4,):
            matrix = array_in(field_of(item, path, "camera_T_object"), path, "camera_T_object")
            named.append((str(name), matrix))
            boxes.append(box)
    masks = [int(i) for i in np.unique(ids) if i >= _FIRST_OBJECT]
    if not (named and masks):
        return {}
    extents = np.array([_extent(ids == i) for i in masks])
    filed = np.array(boxes)
    mirrored = filed[:, [2, 1, 0, 3]] * [-1, 1, -1, 1] + ids.shape[1] * np.array([1, 0, 1, 0])
    # Whether columns of boxes are mirrored too is not known: all of a frame are, or none.
    shares = max(
        (_shares(found, extents) for found in (filed, mirrored)),
        key=lambda table: float(table.max(axis=1).sum()),
    )
    linked = {}
    for k, row in enumerate(shares):
        i = int(row.argmax())
        if row[i] >= _CLEAR and shares[:, i].argmax() == k:
            linked[masks[i]] = named[k]
    return linked


def _extent(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    rows, columns = (np.flatnonzero(inside.any(axis=a)) for a in (1, 0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _shares(boxes: NDArray[np.float64], others: NDArray[Any]) -> NDArray[np.float64]:
    """Intersection over union of each box (x1, y1, x2, y2) with each other one."""
    a, b = boxes[:, None], others[None]
    sides = np.minimum(a[..., 2:], b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    common = np.clip(sides, 0, None).prod(axis=-1)
    areas = [np.clip(x[..., 2:] - x[..., :2], 0, None).prod(axis=-1) for x in (a, b)]
    found: NDArray[np.float64] = common / np.maximum(areas[0] + areas[1] - common, 1e-9)
    return found


def open_syn_todd(name: str, root: Path, part: Part) -> SynTodd:
    """List the pickles of a part by scene.

    Args:
        name: of the split.
        root: folder of `synthetic_train_pkl` and the like, or one above it.
        part: `train`, `val` or `test`.
    """
    wanted = (f"synthetic_{part}_pkl", part)
    places = (root, *(p for top in (root, *folders_in(root)) for p in folders_in(top)))
    top = next((p for p in places if p.name in wanted and any(p.glob("*.pickle.zstd"))), None)
    scenes: dict[int, list[str]] = {}
    for path in () if top is None else top.glob("*.pickle.zstd"):
        if match := _PICKLE.fullmatch(path.name):
            scenes.setdefault(int(match[1]) // 100, []).append(match[1])
    listed = tuple(
        SceneFolder(str(scene), str(top), tuple(sorted(scenes[scene], key=natural_key)))
        for scene in sorted(scenes)
    )
    return SynTodd(name, FrameIndex(listed))


def folders_in(folder: Path) -> Iterator[Path]:
    """Folders of a folder, in order."""
    return iter(sorted(p for p in folder.iterdir() if p.is_dir()))
