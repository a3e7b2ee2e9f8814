"""Hand-eye calibrations: one rigid transform, as the tools of robots file it.

Text or .npy of 4x4 or 3x4 numbers; JSON or YAML (also of OpenCV) with such a matrix, with a
quaternion and a translation (easy_handeye, MoveIt, `ros2 topic echo` of a transform), or with the R
and t of `cv2.calibrateHandEye`.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from std_toolkit.arrays import Array
from std_toolkit.errors import ToolkitError, located
from std_toolkit.geometry import SE3
from std_toolkit.io.camera_documents import read_camera_document
from std_toolkit.log import logger
from std_toolkit.poses.camera_file import read_cameras
from std_toolkit.poses.filed_matrices import CameraTableSettings, as_matrix

_LAYOUTS = (
    "4x4 numbers as text or .npy, a matrix in JSON or YAML, x y z qx qy qz qw of easy_handeye, "
    "rotation and translation of ROS, R and t of OpenCV"
)
# Names that state the other direction: camera from flange.
_INVERSE = re.compile(
    r"(gripper|flange|hand|ee|effector|tool0?)(2|to)(cam|camera|eye)|t_?(cam|camera)_?(gripper|"
    r"flange|hand|ee|tool)|(cam|camera)_t_(gripper|flange|hand|ee|tool)"
)
# Names of a camera that stands beside the robot.
_OF_BASE = re.compile(r"(base|world|robot)(_?link)?[_.]?(2|to|t|_)[_.]?(cam|camera|eye)|"
                      r"(cam|camera|eye)[_.]?(2|to|t|_)[_.]?(base|world|robot)")  # fmt: skip
_CAMERA = re.compile("cam|optical|rgb|color|depth")
_ROTATIONS = ("rotation", "orientation", "quaternion", "quat", "q")
_HAND_KEYS = ("eye_on_hand", "eye_in_hand")
_KIND_KEYS = ("calibration_type", "calib_type", "sensor_mount_type", "mount_type", "setup")
_MOVES = ("translation", "position", "trans", "t", "xyz")


def read_transform(path: Path, *, unit_in_m: float) -> SE3:
    """Read T_flange_cam; the result is in metres.

    A key that names the other direction (gripper2cam, T_cam_flange) is inverted, with a word.

    Args:
        path: the file.
        unit_in_m: metres per unit of its translation.

    Raises:
        ToolkitError: not found, or not one rigid transform.
    """
    if not path.is_file():
        raise ToolkitError("file not found", path=path)
    if path.suffix.lower() in (".pkl", ".pickle"):
        raise ToolkitError("pickled files are not read", path=path, hint="save it as text or JSON")
    document = None
    try:
        document = read_camera_document(path, None)
    except ToolkitError:
        if path.suffix.lower() in (".json", ".yaml", ".yml", ".xml"):
            raise
    is_mapping = isinstance(document, Mapping)
    M = _of_mapping(document, path) if is_mapping else _of_table(path, document)  # type: ignore[arg-type]
    T = SE3.from_matrix(M)
    far = float(np.linalg.norm(T.t)) * unit_in_m
    if far > CameraTableSettings.current().farthest_camera:
        raise ToolkitError(
            "the camera is implausibly far from the flange", path=path, value=f"{far:.4g} m",
            hint="millimetres? give --hand-eye-unit mm (or cm)",
        )  # fmt: skip
    return SE3(T.R, T.t * unit_in_m)


def _of_table(path: Path, numbers: Any) -> Array:
    if isinstance(numbers, list) and len(numbers) == 7:
        raise ToolkitError(
            "seven numbers do not state the order of their quaternion", path=path,
            hint="write x: y: z: qx: qy: qz: qw: with their names, or a 4x4 matrix",
        )  # fmt: skip
    try:
        filed = read_cameras(path)
    except ToolkitError as error:
        raise error.revised(
            problem=f"not a hand-eye calibration: {error.problem}", hint=f"known are {_LAYOUTS}"
        ) from error
    if len(filed.matrices) != 1:
        raise ToolkitError(
            "expected one 4x4 matrix", path=path, value=f"{len(filed.matrices)} matrices"
        )
    for repair in filed.repairs:
        logger.warning("%s: %s", path, repair)
    matrix: Array = filed.matrices[0]
    return matrix


def _of_mapping(document: Mapping[str, Any], path: Path) -> Array:
    for parameters in (document, *_mappings(document)):
        for key, value in parameters.items():
            plain, said = str(key).lower(), str(value).lower()
            if plain == "frame_id" and re.search("base|world", said):
                raise _beside(path, str(key), value)
            if (plain in _HAND_KEYS and said in ("false", "0")) or (
                plain in _KIND_KEYS and re.search("base|to_hand|world", said)
            ):
                raise _beside(path, str(key), value)
    found = list(_transforms(document, "", path))
    distinct = [
        f for i, f in enumerate(found) if not any(np.allclose(f[1], g[1]) for g in found[:i])
    ]
    if len(distinct) != 1:
        raise ToolkitError(
            "not a hand-eye calibration" if not distinct else "the file has several transforms",
            path=path, value=[n for n, _ in distinct] or sorted(map(str, document))[:8],
            hint=f"known are {_LAYOUTS}",
        )  # fmt: skip
    name, M = distinct[0]
    if _OF_BASE.search(name.lower()):
        raise _beside(path, name, None)
    with located(path, name or None):
        filed = SE3.from_matrix(as_matrix(M, path, name))
    parent, child = (_frame_name(document, key) for key in ("frame_id", "child_frame_id"))
    of_camera = _CAMERA.search(parent) and child and not _CAMERA.search(child)
    if _INVERSE.search(name.lower()) or of_camera:
        logger.info("%s: %s is read as T_cam_flange and inverted", path, name)
        filed = filed.inverse()
    return filed.matrix()


def _frame_name(document: Mapping[str, Any], key: str) -> str:
    """The name of a coordinate frame in a message of ROS; "" if it states none."""
    found = (m[key] for m in (document, *_mappings(document)) if key in m)
    return str(next(found, "")).lower()


def _beside(path: Path, key: str, value: Any) -> ToolkitError:
    return ToolkitError(
        "the camera of this calibration does not move with the flange", path=path,
        field=key, value=value, hint="--hand-eye is for a camera on the hand",
    )  # fmt: skip


def _mappings(document: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    for value in document.values():
        if isinstance(value, Mapping):
            yield value
            yield from _mappings(value)


def _transforms(data: Mapping[str, Any], name: str, path: Path) -> Iterator[tuple[str, Array]]:
    """Name and matrix of every transform in a document."""
    plain = {str(k).lower(): v for k, v in data.items()}
    flat = [_first(plain, (c,)) for c in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    if flat[0] is None:
        flat[:3] = [_first(plain, (c,)) for c in ("tx", "ty", "tz")]
    if all(isinstance(v, int | float) for v in flat):
        yield name, _of_quaternion(flat[3:], flat[:3], path)
        return
    wxyz = _first(plain, ("quaternion_wxyz",))
    xyzw = _first(plain, ("quaternion_xyzw",))
    move = _first(plain, (*_MOVES, *(k for k in plain if k.startswith(("translation", "t_")))))
    turn = _first(plain, (*_ROTATIONS, "r", *(k for k in plain if k.startswith("r_"))))
    t = _vector(move, ("x", "y", "z"))
    if t is not None and (wxyz is not None or xyzw is not None):
        q = _vector(wxyz if wxyz is not None else xyzw, ())
        if q is not None and len(q) == 4:
            yield name, _of_quaternion(np.roll(q, -1) if wxyz is not None else q, t, path)
            return
    if t is not None and isinstance(turn, Mapping) and {"x", "y", "z", "w"} <= set(turn):
        yield name, _of_quaternion([turn[c] for c in "xyzw"], t, path)
        return
    if t is not None and (R := _vector(turn, ())) is not None and len(R) == 9:
        key = next(k for k, v in data.items() if v is turn)
        yield f"{name}{key}", np.column_stack([R.reshape(3, 3), t])
        return
    if t is not None and (q := _vector(turn, ())) is not None and len(q) == 4:
        raise ToolkitError(
            "the order of the quaternion is not stated", path=path, field=name or None,
            hint="write rotation: {x:, y:, z:, w:}, quaternion_xyzw or quaternion_wxyz",
        )  # fmt: skip
    for key, value in data.items():
        if isinstance(value, Mapping) and "data" not in value:
            yield from _transforms(value, str(key), path)
        elif (numbers := _vector(value, ())) is not None and len(numbers) in (12, 16):
            yield str(key), numbers.reshape(-1, 4)


def _first(plain: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((plain[n] for n in names if plain.get(n) is not None), None)


def _vector(value: Any, names: tuple[str, ...]) -> Array | None:
    """Numbers of a list of any nesting, of OpenCV's matrix, or of named ones."""
    if isinstance(value, Mapping):
        if names and set(names) <= set(value):
            value = [value[n] for n in names]
        else:
            value = value.get("data")
    try:
        found = np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return found if found.size > 2 and np.isfinite(found).all() else None


def _of_quaternion(xyzw: Any, t: Any, path: Path) -> Array:
    x, y, z, w = (float(v) for v in xyzw)
    with located(path, "quaternion"):
        return SE3.from_quat([w, x, y, z], np.asarray(t, dtype=np.float64)).matrix()
