"""Intrinsics from flags and from the files of cameras and data sets."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from std_toolkit.errors import ToolkitError
from std_toolkit.geometry.intrinsics import (
    Intrinsics,
    listed_coefficients,
    model_of_file,
    named_lens,
)
from std_toolkit.io.foreign_files import read_json

_LARGEST_FILE = 1024 * 1024
# A key of YAML at the beginning of a line.
_KEY = re.compile(r"([ \t-]*)([A-Za-z_]\w*)[ \t]*:")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MATRIX_KEYS = ("K", "cam_K", "camera_matrix", "intrinsic_matrix", "intrinsics", "INTRINSICS")
_SCALAR_KEYS = {
    "fx": ("fx", "Fx", "fl_x", "focal_x"),
    "fy": ("fy", "Fy", "fl_y", "focal_y"),
    "cx": ("cx", "ppx", "PPX", "principal_x"),
    "cy": ("cy", "ppy", "PPY", "principal_y"),
}
_DISTORTION_KEYS = (
    "distortion", "distortion_coefficients", "coeffs", "Coeffs", "dist_coeffs", "dist_coeff",
    "distCoeffs", "distortion_coeffs", "dist", "D",
)  # fmt: skip
_SIZE_KEYS = (("width", "w", "xres", "image_width"), ("height", "h", "yres", "image_height"))


def read_intrinsics(text: str, *, size: tuple[int, int] | None = None) -> Intrinsics:
    """Intrinsics from "fx,fy,cx,cy" or from a file.

    Files: JSON with a matrix (`K`, `cam_K`, `camera_matrix`, Open3D's column-major
    `intrinsic_matrix`) or with `fx fy cx cy` / `fx fy ppx ppy coeffs` (RealSense); YAML of the
    same keys, flat or as ROS writes it; plain text with 3x3, 3x4, 4x4 or 4 numbers; the output of
    `rs-enumerate-devices -c` (the colour stream of the images' size is taken).

    Args:
        text: value of the flag.
        size: image size, to select among several sets.

    Raises:
        ToolkitError: unreadable or incomplete.
    """
    numbers = [p.strip() for p in text.split(",")]
    if len(numbers) == 4 and all(re.fullmatch(_NUMBER, p) for p in numbers):
        fx, fy, cx, cy = (float(p) for p in numbers)
        return Intrinsics(fx, fy, cx, cy)
    path = Path(text)
    if not path.is_file():
        raise ToolkitError(
            "no such intrinsics file",
            path=text,
            hint="give a file, or four numbers: --intrinsics fx,fy,cx,cy",
        )
    if path.stat().st_size > _LARGEST_FILE:
        raise ToolkitError("the intrinsics file is implausibly large", path=path)
    try:
        content = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ToolkitError("the intrinsics file is not text", path=path) from error
    if 'Intrinsic of "' in content:
        return _from_realsense_dump(content, path, size)
    if content.lstrip().startswith(("{", "[")):
        data = read_json(path)
        return _from_mapping(data if isinstance(data, dict) else {"K": data}, path)
    if any(_KEY.match(line) for line in content.splitlines()):
        return _from_mapping(_parse_flat_yaml(content, path), path)
    plain = [line.split("#")[0].replace(",", " ") for line in content.splitlines()]
    words = " ".join(plain).split()
    if words and all(re.fullmatch(_NUMBER + "|nan|inf", w, re.IGNORECASE) for w in words):
        return _from_matrix([float(w) for w in words], path, "K")
    raise ToolkitError(
        "no intrinsics found in the file",
        path=path,
        hint="JSON, YAML or plain text with K or fx fy cx cy",
    )


def parse_distortion(text: str) -> tuple[float, ...]:
    """Coefficients from "k1,k2,p1,p2[,k3[,k4,k5,k6]]".

    Raises:
        ToolkitError: not numbers.
    """
    try:
        return tuple(float(p) for p in text.split(","))
    except ValueError as error:
        raise ToolkitError(
            "distortion is k1,k2,p1,p2[,k3[,k4,k5,k6]]", field="--distortion", value=text
        ) from error


def with_distortion(intrinsics: Intrinsics, text: str | None) -> Intrinsics:
    """The intrinsics with the coefficients of --distortion, if they are given.

    Raises:
        ToolkitError: not numbers.
    """
    if text is None:
        return intrinsics
    return replace(intrinsics, distortion=parse_distortion(text), model="opencv")


def _from_mapping(data: dict[str, Any], path: Path) -> Intrinsics:
    for section in ("color", "colour", "rgb", "intrinsics", "camera", "color_intrinsics"):
        inner = data.get(section)
        if isinstance(inner, dict) and not any(k in data for k in ("K", "fx", "cam_K")):
            return _from_mapping(inner, path)
    model, distortion = _lens(data, path)
    size = _size(data, path)
    for key in _MATRIX_KEYS:
        if key in data:
            values = _flatten(data[key], path, key)
            if key == "intrinsic_matrix" and len(values) == 9 and values[2] == values[5] == 0:
                # Open3D writes its matrix column-major.
                values = [values[i] for i in (0, 3, 6, 1, 4, 7, 2, 5, 8)]
            found = _from_matrix(values, path, key)
            return replace(found, distortion=distortion, size=size, model=model)
    scalars = []
    for name, aliases in _SCALAR_KEYS.items():
        alias = next((a for a in aliases if a in data), None)
        if alias is None:
            raise ToolkitError(
                "intrinsics are incomplete", path=path, field=name, hint="K, or fx fy cx cy"
            )
        scalars.append(_number(data[alias], path, alias))
    fx, fy, cx, cy = scalars
    if "fl_x" in data:  # as in transforms.json, pixels count from the corner of the first one
        cx, cy = cx - 0.5, cy - 0.5
    return Intrinsics(fx, fy, cx, cy, distortion, size, model)


def _from_matrix(values: list[float], path: Path, field: str) -> Intrinsics:
    if len(values) == 4:
        fx, fy, cx, cy = (_number(v, path, field) for v in values)
        return Intrinsics(fx, fy, cx, cy)
    width = {9: 3, 12: 4, 16: 4}.get(len(values))
    if width is None:
        raise ToolkitError("K needs 9 numbers (3x3)", path=path, field=field, value=len(values))
    K = [[_number(v, path, field) for v in values[r * width :][:3]] for r in range(3)]
    if K[2] != [0, 0, 1] or K[1][0] != 0:
        raise ToolkitError(
            "this is not a camera matrix (its last row is 0 0 1)", path=path, field=field, value=K
        )
    if abs(K[0][1]) > 1e-6 * abs(K[0][0]):
        raise ToolkitError("a skewed K is not supported", path=path, field=field, value=K[0][1])
    return Intrinsics(K[0][0], K[1][1], K[0][2], K[1][2])


def _lens(data: dict[str, Any], path: Path) -> tuple[str, tuple[float, ...]]:
    """Lens model and its coefficients."""
    key = next((k for k in _DISTORTION_KEYS if k in data), None)
    try:
        if key is None:
            return named_lens(data, lambda value: _number(value, path, "k1..k6"))
        values = _flatten(data[key], path, key)
        model = model_of_file(data, has_coefficients=any(values))
        if model == "opencv" and not any(values):
            return model, ()
        return model, listed_coefficients(values, model)
    except ToolkitError as error:
        raise ToolkitError(
            error.problem, path=path, field=error.field or key, value=error.value, hint=error.hint
        ) from error


def _size(data: dict[str, Any], path: Path) -> tuple[int, int] | None:
    keys = [next((a for a in aliases if a in data), None) for aliases in _SIZE_KEYS]
    if keys[0] is None or keys[1] is None:
        return None
    width, height = (_number(data[k], path, k) for k in keys if k is not None)
    return int(width), int(height)


def _flatten(value: Any, path: Path, field: str) -> list[float]:
    if isinstance(value, dict) and "data" in value:
        value = value["data"]
    if not isinstance(value, list):
        raise ToolkitError("must be a list of numbers", path=path, field=field, value=value)
    flat: list[float] = []
    for item in value:
        flat.extend(
            _flatten(item, path, field) if isinstance(item, list) else [_number(item, path, field)]
        )
    return flat


def _number(value: Any, path: Path, field: str | None) -> float:
    if not isinstance(value, bool) and isinstance(value, int | float):
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            number = math.inf
        if math.isfinite(number):
            return number
    shown = str(value)[:40] if isinstance(value, int) else value
    raise ToolkitError("must be a finite number", path=path, field=field, value=shown)


def _parse_flat_yaml(content: str, path: Path) -> dict[str, Any]:
    """`key: number`, `key: text` and `key: [numbers]` (also over several lines); a `data:` list
    belongs to the key of its section, as in ROS camera files.

    The files have tags of OpenCV and directives without a space that readers of YAML refuse.
    """
    found: dict[str, Any] = {}
    section = name = ""
    parts: list[str] | None = None  # of a list that is still open
    for line in content.splitlines():
        text = line.split(" #")[0].split("\t#")[0]
        if text.startswith("#"):
            continue
        if parts is None:
            match = _KEY.match(text)
            if match is None:
                continue
            indent, key = match.group(1), match.group(2)
            value = text[match.end() :].strip()
            if not indent:
                section = key
            if not value.startswith("["):
                if re.fullmatch(_NUMBER, value):
                    found.setdefault(key, float(value))
                elif value:
                    found.setdefault(key, value.strip("'\""))
                continue
            name, parts, text = section if key == "data" else key, [], value
        before, bracket, _ = text.partition("]")
        parts.append(before)
        if bracket:
            numbers = re.findall(_NUMBER + r"|\.?nan|\.?inf", " ".join(parts), re.IGNORECASE)
            found[name] = [float(n.lstrip(".") if n[-1].isalpha() else n) for n in numbers]
            parts = None
    if parts is not None:
        raise ToolkitError("a list has no closing bracket", path=path, field=name)
    return found


def _from_realsense_dump(content: str, path: Path, size: tuple[int, int] | None) -> Intrinsics:
    blocks: list[tuple[tuple[int, int], list[str]]] = []
    inside = False
    for line in content.splitlines():
        head = re.search(r'Intrinsic of "([^"]*)" / (\d{1,6})x(\d{1,6}) /', line)
        if head:
            inside = head.group(1) == "Color"
            if inside:
                blocks.append(((int(head.group(2)), int(head.group(3))), []))
        elif not line.strip():
            inside = False
        elif inside:
            blocks[-1][1].append(line)
    sizes = [found for found, _ in blocks]
    chosen = [body for found, body in blocks if found == size]
    if not chosen:
        raise ToolkitError(
            "no intrinsics of the colour stream for this image size",
            path=path,
            value=None if size is None else f"{size[0]}x{size[1]}",
            hint="sizes in the file: " + ", ".join(f"{w}x{h}" for w, h in dict.fromkeys(sizes)),
        )
    fields: dict[str, Any] = {}
    for line in chosen[0]:
        key, _, value = line.partition(":")
        numbers = value.split()
        if key.strip() == "Distortion":
            fields["model"] = value.strip()
        elif numbers and all(re.fullmatch(_NUMBER, n) for n in numbers):
            plain = [float(n) for n in numbers]
            fields[key.strip()] = plain if len(plain) > 1 else plain[0]
    return _from_mapping(fields, path)
