"""Camera poses from files of other tools, as they are filed.

Formats (detected from the content):

matrices    4x4 or 3x4 numbers: a folder with one file per image (text, .npy or JSON), or one file
            of all images (.npy, text with one matrix per line or four lines per matrix, JSON)
csv         a header line; columns are listed in `camera_table`
tum         `timestamp tx ty tz qx qy qz qw` per line; the first column may be an image name
transforms  `transforms.json` of NeRF and instant-ngp
colmap      folder of a COLMAP model, binary or text
par         `*_par.txt`: image name, K, R and t per line, P = K [R | t]

The convention of the file is applied by `known_cameras`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.filed_cameras import camera_of_fields
from std_toolkit.geometry.intrinsics import Intrinsics
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.io.foreign_files import read_json, read_npy, read_npz
from std_toolkit.log import logger
from std_toolkit.poses.camera_table import FiledCameras, read_table
from std_toolkit.poses.filed_matrices import poses_or_lost

# Keys of a JSON matrix, with the direction that the name states, if it states one.
_MATRIX_KEYS = {
    "T_world_cam": "camera-to-world",
    "T_cam_world": "world-to-camera",
    "cam_to_world": "camera-to-world",
    "world_to_cam": "world-to-camera",
    "c2w": "camera-to-world",
    "w2c": "world-to-camera",
    "transform_matrix": None,
    "pose": None,
    "matrix": None,
    "transform": None,
    "extrinsic": "world-to-camera",
}
_NAME_KEYS = ("name", "image", "file_path", "file", "filename", "frame", "timestamp", "id")
_LARGEST_FILE_BYTES = 256 * 1024 * 1024


def read_cameras(path: Path | str) -> FiledCameras:
    """Read a file or folder of camera poses.

    Args:
        path: see the module's table of formats.

    Raises:
        ToolkitError: not found, not a known format, or a matrix that is no pose.
    """
    return _read(Path(path)).rigid()


def _read(path: Path) -> FiledCameras:
    if not path.exists():
        raise ToolkitError("no such file or folder of camera poses", path=path)
    if path.is_dir():
        return _read_folder(path)
    if path.stat().st_size > _LARGEST_FILE_BYTES:
        raise ToolkitError("the file of camera poses is implausibly large", path=path)
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle", ".pt", ".pth"):
        raise ToolkitError("pickled files are not read", path=path, hint="save the poses as .npy")
    if suffix == ".npy":
        return _array(path, read_npy(path))
    if suffix == ".npz":
        arrays = read_npz(path)
        if len(arrays) != 1:
            raise ToolkitError(
                "the file has several arrays", path=path, value=sorted(arrays),
                hint="save the camera poses alone, as .npy",
            )  # fmt: skip
        return _array(path, next(iter(arrays.values())))
    if suffix in (".bin", ".db"):
        raise ToolkitError("give the folder of the COLMAP model", path=path)
    if suffix == ".json":
        return _read_json(path, read_json(path, largest_bytes=_LARGEST_FILE_BYTES))
    with path.open("rb") as file:
        if file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            return _read_json(path, read_json(path, largest_bytes=_LARGEST_FILE_BYTES))
    return read_table(path)


def _array(path: Path, filed: Array) -> FiledCameras:
    values = np.asarray(filed, dtype=np.float64)
    if values.ndim < 2 or values.shape[-2:] not in ((4, 4), (3, 4)) or values.ndim > 3:
        raise ToolkitError(
            "camera poses are an array of 4x4 (or 3x4) matrices", path=path, value=values.shape
        )
    values = values.reshape(-1, *values.shape[-2:])
    if not len(values):
        raise ToolkitError("the file has no camera poses", path=path)
    matrices, lost = poses_or_lost(values, path, lambda i: f"[{i}]")
    return FiledCameras(path=path, kind="matrices", matrices=matrices, lost=lost)


@dataclass
class _Rows:
    """Poses in the order of a document."""

    path: Path
    keys: list[str] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    lenses: list[Intrinsics | None] = field(default_factory=list)
    lens_problem: ToolkitError | None = None

    def add(self, key: str, value: Any, at: str, lens: Intrinsics | None = None) -> None:
        self.keys.append(key)
        self.values.append(value)
        self.places.append(at)
        self.lenses.append(lens)

    def filed(
        self, kind: str, *, convention: str | None = None, unit: str | None = None, **fields: Any
    ) -> FiledCameras:
        if not self.values:
            raise ToolkitError("the file has no camera poses", path=self.path)
        matrices, lost = poses_or_lost(self.values, self.path, self.places.__getitem__)
        return FiledCameras(
            path=self.path,
            kind=kind,
            matrices=matrices,
            keys=self.keys if all(self.keys) else None,
            lenses=self.lenses,
            lens_problem=self.lens_problem,
            lost=lost,
            convention=convention,
            unit=unit,
            **fields,
        )


def _read_json(path: Path, document: Any) -> FiledCameras:
    if isinstance(document, Mapping) and isinstance(document.get("frames"), list):
        rows = document["frames"]
        if any(isinstance(r, Mapping) and "transform_matrix" in r for r in rows):
            return _read_transforms(path, document)
        return _read_list(path, rows, "frames")
    if isinstance(document, Mapping):
        known = [k for k in _MATRIX_KEYS if k in document]
        if known:
            return _read_list(path, [document], "")
        items = [
            {"name": str(k), **(v if isinstance(v, Mapping) else {"matrix": v})}
            for k, v in document.items()
        ]
        return _read_list(path, items, "")
    if document is None:  # of an image that was lost
        return _read_list(path, [None], "")
    if isinstance(document, list):
        if _is_numbers(document):
            document = [document]
        return _read_list(path, document, "")
    raise ToolkitError("not a file of camera poses", path=path, hint=_KNOWN)


_KNOWN = "4x4 matrices, TUM, CSV with a header, transforms.json, a COLMAP model, or *_par.txt"


def _is_numbers(value: list[Any]) -> bool:
    try:
        size = np.asarray(value, dtype=np.float64).shape
    except (TypeError, ValueError):
        return False
    return size in ((4, 4), (3, 4), (16,), (12,))


def _read_list(path: Path, rows: list[Any], where: str) -> FiledCameras:
    found = _Rows(path)
    directions: set[str | None] = set()
    for i, row in enumerate(rows):
        at = f"{where}[{i}]"
        if isinstance(row, Mapping):
            keys = [k for k in _MATRIX_KEYS if k in row]
            name = next((str(row[k]) for k in _NAME_KEYS if k in row), "")
            if not keys and row.get("status") == "unregistered":
                continue
            if len(keys) != 1:
                raise ToolkitError(
                    "not a camera pose", path=path, field=name or at, value=sorted(row)[:8],
                    hint=f"give the matrix as one of {', '.join(_MATRIX_KEYS)}",
                )  # fmt: skip
            directions.add(_MATRIX_KEYS[keys[0]])
            found.add(name, row[keys[0]], f"{at}.{keys[0]}")
        else:
            found.add("", row, at)
    convention = directions.pop() if len(directions) == 1 else None
    return found.filed("matrices", convention=convention)


def _read_transforms(path: Path, document: Mapping[str, Any]) -> FiledCameras:
    found = _Rows(path)
    if (factor := document.get("applied_scale", 1)) != 1:
        logger.warning(
            "%s: applied_scale is %s: its positions are so many times those of the tracker; "
            "--cameras-unit is the unit of the numbers in the file", path, factor,
        )  # fmt: skip
    for i, row in enumerate(document["frames"]):
        if not isinstance(row, Mapping) or "transform_matrix" not in row:
            raise ToolkitError("a frame without transform_matrix", path=path, field=f"frames[{i}]")
        lens = None
        try:
            lens = _transforms_lens(path, {**document, **row}, i)
        except ToolkitError as error:  # of interest only where no other intrinsics are given
            found.lens_problem = found.lens_problem or error
        found.add(str(row.get("file_path", "")), row["transform_matrix"], f"frames[{i}]", lens)
    return found.filed("transforms", convention="camera-to-world-opengl", unit_is_open=True)


# Keys of transforms.json that speak of a lens.
_LENS_KEYS = ("fl_x", "fx", "K", "k1", "camera_model", "is_fisheye")


def _transforms_lens(path: Path, row: Mapping[str, Any], i: int) -> Intrinsics | None:
    if not any(key in row for key in _LENS_KEYS):
        return None
    if not any(key in row for key in _LENS_KEYS[:3]):
        raise ToolkitError(
            "incomplete intrinsics: fl_x, fl_y, cx and cy are needed", path=path,
            field=f"frames[{i}]",
        )  # fmt: skip
    fields = {k: v for k, v in row.items() if k not in ("frames", *_MATRIX_KEYS)}
    camera = camera_of_fields(fields, path, name=f"frames[{i}]")
    k = camera.intrinsics.distortion
    if camera.intrinsics.model == "opencv" and k[4:] == (0.0,):
        k = k[:4]
    return replace(camera.intrinsics, distortion=k, notes=(f"{path}: {camera.lens}",))


def _read_folder(folder: Path) -> FiledCameras:
    for model in (folder, folder / "sparse" / "0", folder / "sparse"):
        if any((model / f"images.{s}").is_file() for s in ("bin", "txt")) and any(
            (model / f"cameras.{s}").is_file() for s in ("bin", "txt")
        ):
            return _read_colmap(model)
    if (folder / "transforms.json").is_file():
        return _read(folder / "transforms.json")
    # Files without a number in their names are calibrations and notes.
    files = [p for p in sorted(folder.iterdir()) if p.is_file() and any(map(str.isdigit, p.stem))]
    kinds = {s: [p for p in files if p.suffix.lower() == s] for s in (".txt", ".npy", ".json")}
    suffix = max(kinds, key=lambda s: len(kinds[s]))
    if not kinds[suffix]:
        raise ToolkitError("no camera poses in this folder", path=folder, hint=_KNOWN)
    found = _Rows(folder)
    directions: set[str | None] = set()
    for path in kinds[suffix]:
        if not path.read_bytes()[:64].strip():
            found.add(path.name, None, path.name)
            continue
        one = _read(path)
        if len(one.matrices) != 1:
            raise ToolkitError(
                "in a folder, each file has the pose of one image", path=path,
                value=f"{len(one.matrices)} poses",
                hint="to read one file of many poses, name the file",
            )  # fmt: skip
        if not one.lost:
            directions.add(one.convention)
        found.add(path.name, None if one.lost else one.matrices[0], path.name)
    convention = directions.pop() if len(directions) == 1 else None
    return found.filed("matrices", convention=convention)


def _read_colmap(folder: Path) -> FiledCameras:
    import pycolmap

    from std_toolkit.poses.colmap import from_colmap_camera, from_rigid3d, quiet_colmap

    check_colmap_model(folder)
    try:
        with quiet_colmap():
            model = pycolmap.Reconstruction(folder)
    except Exception as error:
        raise ToolkitError("cannot read the COLMAP model", path=folder) from error
    found = _Rows(folder)
    for number in sorted(model.reg_image_ids()):
        image = model.image(number)
        try:
            lens = Intrinsics.of(from_colmap_camera(model.camera(image.camera_id)))
        except ToolkitError as error:  # of interest only where no other intrinsics are given
            lens = None
            found.lens_problem = found.lens_problem or error.revised(path=folder)
        pose = from_rigid3d(image.cam_from_world())
        found.add(image.name, pose.matrix(), image.name, lens)
    return found.filed("colmap", convention="world-to-camera", unit_is_open=True)
