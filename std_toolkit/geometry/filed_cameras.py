"""Cameras in the documents of other programs: intrinsics files, transforms.json, ROS, Kalibr, ...

A document is plain values, whatever syntax it had. Every mapping in it with a focal length is a
camera; what encloses it, and its sections, add the lens and the image size.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.camera_models import MODELS
from std_toolkit.geometry.camera_sections import (
    CENTRE,
    FOCAL,
    MATRIX,
    SCALARS,
    camera_sections,
    expanded,
    is_filled,
    joined,
    leaves,
)
from std_toolkit.geometry.filed_lens import (
    LIST_KEYS,
    NAMED_KEYS,
    FiledLens,
    model_of_fields,
    plain_key,
)
from std_toolkit.geometry.filed_numbers import (
    filed_depth_unit,
    filed_size,
    number,
    of_region,
    y_down,
)
from std_toolkit.geometry.intrinsics import Intrinsics

_COLOR = re.compile(r"(?<![a-z])(color|colour|rgb)(?![a-z])|^(color|colour|rgb)")


@dataclass(frozen=True, kw_only=True)
class FiledCamera:
    """A camera of a document.

    Attributes:
        name: the keys that lead to it; "" for that of the whole document.
        intrinsics: as read, pixel centres at integers.
        lens: sentence on the lens that was read.
        depth_unit: metres per unit of depth images, and the key that states it.
    """

    name: str
    intrinsics: Intrinsics
    lens: str
    depth_unit: tuple[float, str] | None = None


def filed_cameras(
    document: Any, path: Path, *, size: tuple[int, int] | None = None, wanted: str | None = None
) -> list[FiledCamera]:
    """All cameras of a document; equal ones once, unless their names matter.

    Args:
        document: plain values: mappings and lists, or the numbers of a matrix.
        path: its file, for errors.
        size: image size, for documents that state only an angle of view.
        wanted: name of the camera that will be chosen; others may be of any lens.

    Raises:
        ToolkitError: no camera, or one that is incomplete or has a lens that is not supported.
    """
    if isinstance(document, list) and not any(isinstance(x, Mapping) for x in document):
        document = {"K": document}
    found: list[FiledCamera] = []
    failed: list[ToolkitError] = []
    units: list[tuple[float, str]] = []
    is_there = False
    for name, fields in camera_sections(document, "", {}):
        is_wanted = wanted is not None and (wanted == name or wanted in name.split("."))
        try:
            one = _camera(name, fields, size)
        except ToolkitError as error:
            failed.append(error.revised(path=path, field=joined(name, error.field)))
            if is_wanted:
                raise failed[-1] from error
            continue
        is_there |= is_wanted
        if one.depth_unit is not None and "depth" in name.lower():
            units.append(one.depth_unit)
        if is_wanted or one.intrinsics not in [f.intrinsics for f in found]:
            found.append(one)
    if failed and not is_there and not any(_COLOR.search(f.name) for f in found):
        raise (
            failed[0]
            if found or "incomplete" not in failed[0].problem
            else _incomplete(document, path, failed[0].field)
        )
    if not found:
        raise _incomplete(document, path)
    # A unit that the depth camera states is that of the recording.
    if len(units) == 1:
        found = [replace(f, depth_unit=f.depth_unit or units[0]) for f in found]
    return found


def _incomplete(document: Any, path: Path, field: str | None = "fx") -> ToolkitError:
    """The error of a document without a camera: its lens model, or what it has instead."""
    values = leaves(document) if isinstance(document, Mapping) else {}
    try:
        model_of_fields(values, has_coefficients=True)
    except ToolkitError as error:
        return error.revised(path=path)
    names = list(map(str, document))[:8] if isinstance(document, Mapping) else None
    return ToolkitError(
        "intrinsics are incomplete", path=path, field=field, value=names,
        hint="K, or fx fy cx cy in pixels; or give --intrinsics fx,fy,cx,cy",
    )  # fmt: skip


def chosen_camera(found: Sequence[FiledCamera], path: Path, name: str | None) -> FiledCamera:
    """The camera that a name selects; without one the only camera, or the only one of colour.

    Raises:
        ToolkitError: no such camera, or several could be meant.
    """
    names = [f.name or "file" for f in found]
    if name is not None:
        exact = [f for f, n in zip(found, names, strict=True) if n == name]
        parts = [f for f, n in zip(found, names, strict=True) if name in n.split(".")]
        if len(exact or parts) != 1:
            raise ToolkitError(
                "no such camera" if not (exact or parts) else "several cameras have this name",
                path=path, field="--camera", value=name, hint=_some(names),
            )  # fmt: skip
        return (exact or parts)[0]
    color = [f for f in found if _COLOR.search(f.name.lower())]
    if len(found) > 1 and len(color) != 1:
        raise ToolkitError(
            f"the file has {len(found)} cameras", path=path,
            hint=f"choose one with --camera NAME: {_some(names)}",
        )  # fmt: skip
    return found[0] if len(found) == 1 else color[0]


def camera_of_fields(
    fields: Mapping[str, Any], path: Path, *, name: str = "", size: tuple[int, int] | None = None
) -> FiledCamera:
    """The camera of one mapping, such as a frame of transforms.json with what encloses it.

    Raises:
        ToolkitError: as `filed_cameras`.
    """
    try:
        return _camera(name, expanded(fields), size)
    except ToolkitError as error:
        raise error.revised(path=path, field=joined(name, error.field)) from error


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (f" ... ({len(names)})" if len(names) > 12 else "")


def _camera(name: str, fields: Mapping[str, Any], size: tuple[int, int] | None) -> FiledCamera:
    plain: dict[str, tuple[str, Any]] = {}
    for key, value in fields.items():
        first, before = plain.setdefault(plain_key(key), (key, value))
        if before != value and plain_key(key) in (*MATRIX, *LIST_KEYS, *NAMED_KEYS):
            raise ToolkitError(
                f"{first} and {key} differ only in their spelling", field=key, value=value,
                hint="remove one, or give --intrinsics fx,fy,cx,cy and --distortion",
            )  # fmt: skip
    if "params" in plain and "model" in plain:
        return _of_colmap(name, plain)
    lens_fields = _renamed_kannala(fields, plain)
    # First: models with further parameters, such as Kalibr's omni, are refused by name.
    lens = FiledLens(lens_fields, number)
    stated_size = filed_size(plain)
    found = _numbers(plain, stated_size or size)
    intrinsics = replace(
        found, distortion=lens.coefficients, size=filed_size(plain, found), model=lens.model
    )
    intrinsics, region = of_region(intrinsics, plain, size)
    intrinsics, axes = y_down(intrinsics)
    return FiledCamera(
        name=name,
        intrinsics=intrinsics,
        lens="; ".join(filter(None, (lens_sentence(intrinsics, lens.sources), region, axes))),
        depth_unit=filed_depth_unit(plain, of_depth="depth" in name.lower()),
    )


def lens_sentence(intrinsics: Intrinsics, keys: Sequence[str]) -> str:
    """What was read of a lens, for the user."""
    if not any(intrinsics.distortion) and intrinsics.model == "opencv":
        return "it states no distortion" if not keys else f"no distortion ({', '.join(keys)} is 0)"
    values = " ".join(f"{k:.6g}" for k in intrinsics.distortion)
    return f"{intrinsics.model} lens {values} (from {', '.join(keys)})"


def _numbers(plain: Mapping[str, tuple[str, Any]], size: tuple[int, int] | None) -> Intrinsics:
    for name in MATRIX:
        if name in plain and is_filled(plain[name][1]):
            key, value = plain[name]
            entries = _list(value, key)
            if len(entries) < 9 and any(a in plain for a in SCALARS["fx"]):
                raise ToolkitError(
                    "is no camera matrix beside fx: a lens?", field=key, value=value,
                    hint="write them as k1 k2 p1 p2 k3, or as `distortion`",
                )  # fmt: skip
            found = _of_matrix(entries, key)
            return _from_zero(found) if _is_matlab(plain, entries) else found
    values: dict[str, float] = {}
    used: dict[str, str] = {}
    for name, aliases in SCALARS.items():
        alias = next((a for a in aliases if a in plain), None)
        if alias is not None:
            key, value = plain[alias]
            values[name], used[name] = number(value, key), alias
    for both, names in ((FOCAL, ("fx", "fy")), (CENTRE, ("cx", "cy"))):
        alias = next((a for a in both if a in plain), None)
        if alias is None or any(n in values for n in names):
            continue
        key, value = plain[alias]
        pair = _list(value, key) if isinstance(value, list | Mapping) else [number(value, key)]
        if (both is CENTRE and len(pair) != 2) or len(pair) > 2:
            raise ToolkitError("must be two numbers", field=key, value=value)
        values |= zip(names, (pair * 2)[:2], strict=True)
        used |= dict.fromkeys(names, alias)
    if "fx" not in values and "cameraanglex" in plain:
        return _of_angle(plain, size, values)
    if used.get("fx") == "flx" and "fy" not in values:
        values["fy"] = values["fx"]
    for name in SCALARS:
        if name not in values:
            raise ToolkitError("intrinsics are incomplete", field=name, hint="K, or fx fy cx cy")
    # As in transforms.json, pixels count from the corner of the first one.
    half = 0.5 if used["fx"] == "flx" else 0.0
    found = Intrinsics(values["fx"], values["fy"], values["cx"] - half, values["cy"] - half)
    return _from_zero(found) if _is_matlab(plain) else found


def _of_angle(
    plain: Mapping[str, tuple[str, Any]], size: tuple[int, int] | None, values: dict[str, float]
) -> Intrinsics:
    key, value = plain["cameraanglex"]
    angle = number(value, key)
    if size is None or not 0 < angle < math.pi:
        raise ToolkitError(
            "an angle of view, radians, needs the size of the image", field=key, value=value,
            hint="give --intrinsics fx,fy,cx,cy",
        )  # fmt: skip
    f = size[0] / 2 / math.tan(angle / 2)
    fy = f
    if "cameraangley" in plain:
        key, value = plain["cameraangley"]
        angle = number(value, key)
        if not 0 < angle < math.pi:
            raise ToolkitError("must be an angle of view, radians", field=key, value=value)
        fy = size[1] / 2 / math.tan(angle / 2)
    cx, cy = values.get("cx", size[0] / 2), values.get("cy", size[1] / 2)
    return Intrinsics(f, fy, cx - 0.5, cy - 0.5)


def _of_colmap(name: str, plain: Mapping[str, tuple[str, Any]]) -> FiledCamera:
    model = str(plain["model"][1]).upper()
    params = _list(plain["params"][1], plain["params"][0])
    kind = next((k for k, m in MODELS.items() if model in m.colmap), None)
    table = {**{m: n for x in MODELS.values() for m, n in x.colmap.items()}}
    table |= {"SIMPLE_PINHOLE": (1, 0), "PINHOLE": (2, 0)}
    if model not in table:
        raise ToolkitError(
            "this model of COLMAP is not supported", field="model", value=model,
            hint=f"one of {', '.join(table)}",
        )  # fmt: skip
    focals, count = table[model]
    if len(params) != focals + 2 + count:
        raise ToolkitError(
            f"{model} has {focals + 2 + count} parameters", field="params", value=len(params)
        )
    k = list(params[focals + 2 :])
    if kind == "fisheye" or k:
        k += [0.0] * (4 - len(k))
    lens = tuple(k) if kind == "fisheye" or any(k) else ()
    found = Intrinsics(
        params[0], params[focals - 1], params[focals] - 0.5, params[focals + 1] - 0.5,
        lens, filed_size(plain), kind or "opencv",
    )  # fmt: skip
    return FiledCamera(
        name=str(plain["cameraname"][1]) if "cameraname" in plain else name,
        intrinsics=found,
        lens=lens_sentence(found, [model]),
        depth_unit=filed_depth_unit(plain),
    )


def _renamed_kannala(
    fields: Mapping[str, Any], plain: Mapping[str, tuple[str, Any]]
) -> Mapping[str, Any]:
    """VINS-Fusion counts the coefficients of its KANNALA_BRANDT from k2 to k5."""
    if "mu" not in plain or "k5" not in plain or "k1" in plain:
        return fields
    other = {f"k{i}": plain[f"k{i + 1}"][1] for i in range(1, 5) if f"k{i + 1}" in plain}
    return {
        **{k: v for k, v in fields.items() if not re.fullmatch("k[2-5]", plain_key(k))},
        **other,
    }


def _is_matlab(plain: Mapping[str, tuple[str, Any]], K: Sequence[float] = ()) -> bool:
    """Whether numbers are of MATLAB's cameraParameters or cameraIntrinsics, which count pixels
    from 1."""
    if {"FocalLength", "PrincipalPoint", "ImageSize"} <= {key for key, _ in plain.values()}:
        return True
    if "worldpoints" in plain or "numradialdistortioncoefficients" in plain:
        return True
    transposed = len(K) == 9 and K[2] == K[5] == 0
    return "intrinsicmatrix" in plain and "radialdistortion" in plain and transposed


def _from_zero(found: Intrinsics) -> Intrinsics:
    return replace(found, cx=found.cx - 1, cy=found.cy - 1)


def _of_matrix(values: list[float], field: str) -> Intrinsics:
    if len(values) == 4:
        fx, fy, cx, cy = values
        return Intrinsics(fx, fy, cx, cy)
    width = {9: 3, 12: 4, 16: 4}.get(len(values))
    if width is None:
        raise ToolkitError("K needs 9 numbers (3x3)", field=field, value=len(values))
    K = [values[r * width :][:3] for r in range(3)]
    if K[0][2] == K[1][2] == 0 and K[2][2] == 1 and K[2][0] and K[2][1]:
        # Column by column, as Open3D and Record3D write it.
        K = [list(row) for row in zip(*K, strict=True)]
    if K[2] != [0, 0, 1] or K[1][0] != 0:
        raise ToolkitError(
            "this is not a camera matrix (its last row is 0 0 1)", field=field, value=K
        )
    if abs(K[0][1]) > 1e-6 * abs(K[0][0]):
        raise ToolkitError("a skewed K is not supported", field=field, value=K[0][1])
    return Intrinsics(K[0][0], K[1][1], K[0][2], K[1][2])


def _list(value: Any, field: str) -> list[float]:
    if isinstance(value, Mapping):
        value = next((v for k, v in value.items() if plain_key(k) == "data"), None)
    if not isinstance(value, list):
        raise ToolkitError("must be a list of numbers", field=field, value=value)
    flat: list[float] = []
    for item in value:
        flat.extend(_list(item, field) if isinstance(item, list) else [number(item, field)])
    return flat
