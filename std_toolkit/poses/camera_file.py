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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry import SE3
from std_toolkit.geometry.intrinsics import Intrinsics, named_lens
from std_toolkit.io.colmap_files import check_colmap_model
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import read_npy
from std_toolkit.log import logger
from std_toolkit.poses.camera_table import FiledCameras, as_matrix, read_table

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
        return FiledCameras(path=path, kind="matrices", matrices=_array(path))
    if suffix in (".bin", ".db"):
        raise ToolkitError("give the folder of the COLMAP model", path=path)
    if suffix == ".json":
        return _read_json(path, read_document(path, Any))
    with path.open("rb") as file:
        if file.read(64).lstrip().startswith(b"{"):
            return _read_json(path, read_document(path, Any))
    return read_table(path)


def read_transform(path: Path, *, unit_in_m: float) -> SE3:
    """Read one rigid transform, such as a hand-eye calibration; the result is in metres.

    Text or .npy of 4x4 or 3x4 numbers, JSON with such a matrix or with `quaternion_wxyz` or
    `quaternion_xyzw` and `translation`.

    Raises:
        ToolkitError: not found, or not one rigid transform.
    """
    if not path.is_file():
        raise ToolkitError("file not found", path=path)
    if path.suffix.lower() == ".json":
        document = read_document(path, Any)
        pose = _quaternion(path, document)
        filed = _read_json(path, document).rigid() if pose is None else None
        M = filed.matrices if filed is not None else np.asarray(pose)[None]
    else:
        filed = read_cameras(path)
        M = filed.matrices
    if len(M) != 1:
        raise ToolkitError("expected one 4x4 matrix", path=path, value=f"{len(M)} matrices")
    for repair in filed.repairs if filed is not None else ():
        logger.warning("%s: %s", path, repair)
    T = SE3.from_matrix(M[0])
    return SE3(T.R, T.t * unit_in_m)


def _quaternion(path: Path, document: Any) -> NDArray[np.float64] | None:
    if not isinstance(document, Mapping):
        return None
    orders = [k for k in ("quaternion_wxyz", "quaternion_xyzw") if k in document]
    moves = [k for k in document if k.startswith("translation")]
    if len(orders) != 1 or len(moves) != 1:
        return None
    try:
        q = np.asarray(document[orders[0]], dtype=np.float64).reshape(4)
        t = np.asarray(document[moves[0]], dtype=np.float64).reshape(3)
        return SE3.from_quat(np.roll(q, 1) if orders[0].endswith("xyzw") else q, t).matrix()
    except (TypeError, ValueError, ToolkitError) as error:
        raise ToolkitError("not a quaternion and a translation", path=path) from error


def _array(path: Path) -> NDArray[np.float64]:
    values = np.asarray(read_npy(path), dtype=np.float64)
    if values.ndim < 2 or values.shape[-2:] not in ((4, 4), (3, 4)) or values.ndim > 3:
        raise ToolkitError(
            "camera poses are an array of 4x4 (or 3x4) matrices", path=path, value=values.shape
        )
    values = values.reshape(-1, *values.shape[-2:])
    return np.array([as_matrix(m, path, f"[{i}]") for i, m in enumerate(values)])


@dataclass
class _Rows:
    """Poses in the order of a document."""

    path: Path
    keys: list[str] = field(default_factory=list)
    matrices: list[NDArray[np.float64]] = field(default_factory=list)
    lenses: list[Intrinsics | None] = field(default_factory=list)

    def add(self, key: str, value: Any, at: str, lens: Intrinsics | None = None) -> None:
        self.keys.append(key)
        self.matrices.append(as_matrix(value, self.path, at))
        self.lenses.append(lens)

    def filed(
        self, kind: str, *, convention: str | None = None, unit: str | None = None, **fields: Any
    ) -> FiledCameras:
        if not self.matrices:
            raise ToolkitError("the file has no camera poses", path=self.path)
        named = all(self.keys)
        return FiledCameras(
            path=self.path,
            kind=kind,
            matrices=np.array(self.matrices),
            keys=self.keys if named else None,
            lenses=self.lenses,
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
            if row[keys[0]] is not None:
                found.add(name, row[keys[0]], f"{at}.{keys[0]}")
        else:
            found.add("", row, at)
    convention = directions.pop() if len(directions) == 1 else None
    return found.filed("matrices", convention=convention)


def _read_transforms(path: Path, document: Mapping[str, Any]) -> FiledCameras:
    found = _Rows(path)
    for i, row in enumerate(document["frames"]):
        if not isinstance(row, Mapping) or "transform_matrix" not in row:
            raise ToolkitError("a frame without transform_matrix", path=path, field=f"frames[{i}]")
        lens = _transforms_lens(path, {**document, **row}, i)
        found.add(str(row.get("file_path", "")), row["transform_matrix"], f"frames[{i}]", lens)
    return found.filed("transforms", convention="camera-to-world-opengl", unit_is_open=True)


def _transforms_lens(path: Path, row: Mapping[str, Any], i: int) -> Intrinsics | None:
    if "fl_x" not in row:
        return None
    try:
        size = (int(row["w"]), int(row["h"])) if "w" in row and "h" in row else None
        model, k = named_lens(row, float)
        if model == "opencv" and k[4:] == (0.0,):
            k = k[:4]
        # The principal point starts at the corner of the first pixel.
        return Intrinsics(
            fx=float(row["fl_x"]),
            fy=float(row.get("fl_y", row["fl_x"])),
            cx=float(row["cx"]) - 0.5,
            cy=float(row["cy"]) - 0.5,
            distortion=k,
            size=size,
            model=model,
        )
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=error.field, value=error.value, hint=error.hint
        ) from error
    except (TypeError, ValueError, KeyError) as error:
        raise ToolkitError(
            "incomplete intrinsics: fl_x, fl_y, cx and cy are needed", path=path,
            field=f"frames[{i}]",
        ) from error  # fmt: skip


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
        one = _read(path)
        if len(one.matrices) != 1:
            raise ToolkitError(
                "in a folder, each file has the pose of one image", path=path,
                value=f"{len(one.matrices)} poses",
                hint="to read one file of many poses, name the file",
            )  # fmt: skip
        directions.add(one.convention)
        found.add(path.name, one.matrices[0], path.name)
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
        except ToolkitError as error:
            raise ToolkitError(error.problem, path=folder, value=error.value) from error
        pose = from_rigid3d(image.cam_from_world())
        found.add(image.name, pose.matrix(), image.name, lens)
    return found.filed("colmap", convention="world-to-camera", unit_is_open=True)
