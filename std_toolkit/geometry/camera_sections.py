"""Where the cameras of a foreign document are: its mappings with a focal length.

What encloses a camera, and the sections beside and within it, add what they say of its lens.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from std_toolkit.geometry.filed_lens import plain_key, states_lens

MATRIX = (
    "k", "camk", "cameramatrix", "intrinsicmatrix", "intrinsicsmatrix", "intrinsics", "intrinsic",
    "mtx", "kmat", "kmatrix", "matrixk", "matk", "cameraintrinsics", "cameraintrinsic",
    "intrinsicmat", "rgbintrinsic", "rgbintrinsics", "colorintrinsic", "colorintrinsics", "m",
)  # fmt: skip
SCALARS = {
    "fx": ("fx", "flx", "focalx", "focallengthx", "mu", "alphax"),
    "fy": ("fy", "fly", "focaly", "focallengthy", "mv", "alphay"),
    "cx": ("cx", "ppx", "principalx", "principalpointx", "mx", "u0", "centerx"),
    "cy": ("cy", "ppy", "principaly", "principalpointy", "my", "v0", "centery"),
}
FOCAL = ("focallength", "focal", "f", "focallengths", "focals", "fl")
CENTRE = ("principalpoint", "center", "centre", "pp", "c", "opticalcenter")
# What tells the rows of a list apart.
_NAME_KEYS = ("name", "cameraname", "cameraid", "label", "serial", "serialnumber", "id")
# Sections of a lens that belong to another camera than that of colour, or to no recorded image.
_OF_OTHERS = re.compile(r"depth|infra|^ir|undist")
# Sections beside a camera that may speak of its lens.
_OF_LENS = re.compile(r"dist|lens|camera|param|resolution|model|fisheye|mirror|size|rgbd|viewer")
# Keys of Android's Camera2, such as android.lens.radialDistortion.
_ANDROID = re.compile(r"(?:^|\.)lens\.((?:radialD|d)istortion\w*)$")
_SUFFIXED = re.compile(r"^(fx|fy|cx|cy|mx|my|ppx|ppy|k[1-6]|p[12])_([a-z]\w*)$")
_PREFIXED = re.compile(r"^(\w*[a-z0-9])_(fx|fy|cx|cy|ppx|ppy|k[1-6]|p[12])$")
# info.txt of ScanNet's sensor files and of BundleFusion.
_OF_SENSOR_FILE = re.compile(
    r"^m_(?:calibration(Color|Depth)(Intrinsic)|(color|depth)(Width|Height))$"
)
_NUMBERED = re.compile(
    r"^(K|M|D|mtx|[cC]amera_?[mM]atrix|CM|dist|[dD]ist_?[cC]oeffs?|distortion)_?"
    r"([0-9]|left|right|Left|Right|L|R|l|r|color|rgb|depth|ir)$"
)


def expanded(data: Mapping[str, Any]) -> dict[str, Any]:
    """Keys such as Camera.fx, color_fx, fx_color and K1 become sections."""
    found: dict[str, Any] = {}
    groups: dict[str, dict[str, Any]] = {}
    for key, value in data.items():
        key = str(key)
        flat = not isinstance(value, Mapping | list) and value is not None
        if match := _ANDROID.search(key):
            found[f"lens{match.group(1)[0].upper()}{match.group(1)[1:]}"] = value
        elif match := _OF_SENSOR_FILE.match(key):
            group, field = (match.group(1) or match.group(3)).lower(), match.group(2)
            groups.setdefault(group, {})[field or match.group(4)] = value
        elif "." in key:
            group, _, last = key.rpartition(".")
            groups.setdefault(group, {})[last] = value
        elif match := (_SUFFIXED if flat else _NUMBERED).match(key):
            groups.setdefault(match.group(2), {})[match.group(1)] = value
        elif (match := _PREFIXED.match(key)) and flat:
            groups.setdefault(match.group(1), {})[match.group(2)] = value
        else:
            found[key] = value
    for group, values in groups.items():
        inner = found.get(group)
        found[group] = {**inner, **values} if isinstance(inner, Mapping) else values
    return found


def _is_camera(data: Mapping[str, Any]) -> bool:
    plain = {plain_key(k): v for k, v in data.items()}
    if any(k in plain and is_filled(plain[k]) for k in MATRIX):
        return True
    if "params" in plain and "model" in plain:
        return True
    if any(k in plain and isinstance(plain[k], int | float | str) for k in SCALARS["fx"]):
        return True
    has_centre = any(k in plain for k in (*CENTRE, *SCALARS["cx"]))
    return "cameraanglex" in plain or (has_centre and any(k in plain for k in FOCAL))


def is_filled(value: Any) -> bool:
    if isinstance(value, Mapping):
        inner = {plain_key(k): v for k, v in value.items()}
        return isinstance(inner.get("data"), list)
    return isinstance(value, list) and not _mappings(value)


def _is_whole(key: str, value: Mapping[str, Any]) -> bool:
    """Whether a section is a value of its camera: a matrix, or ROS's region of interest."""
    return is_filled(value) or plain_key(key) == "roi"


def _children(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for key, value in data.items():
        if isinstance(value, Mapping) and not _is_whole(key, value):
            yield key, value
        elif rows := _mappings(value):
            names = _row_names(rows)
            for name, row in zip(names, rows, strict=True):
                yield f"{key}{name}" if len(rows) > 1 else key, row


def _row_names(rows: list[Mapping[str, Any]]) -> list[str]:
    """Their names with a dot, if each has one of its own; else their numbers in brackets."""
    for key in _NAME_KEYS:
        found = [{plain_key(k): v for k, v in row.items()}.get(key) for row in rows]
        if all(isinstance(v, str) and v for v in found) and len(set(found)) == len(rows):
            return [f".{name}" for name in found]
    return [f"[{i}]" for i in range(len(rows))]


def camera_sections(
    document: Any, trail: str, above: Mapping[str, Any], depth: int = 0
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and fields of every camera in a document."""
    if isinstance(document, list):
        document = {f"[{i}]": v for i, v in enumerate(_mappings(document))}
    if not isinstance(document, Mapping) or depth > 12:
        return
    data = expanded(document)
    inner = [(name, expanded(child)) for name, child in _children(data)]
    own = {**above, **{k: v for k, v in data.items() if not isinstance(v, Mapping)}}
    own |= {k: v for k, v in data.items() if isinstance(v, Mapping) and _is_whole(k, v)}
    own = {k: v for k, v in own.items() if not _is_rows(v)}
    within = {name: list(camera_sections(child, "", {}, depth + 1)) for name, child in inner}
    own = _with_lens({name: child for name, child in inner if not within[name]}, own)
    if _is_camera(data) or _is_camera(own):
        rows = [c for n, c in inner if n.startswith("frames") and _speaks_of_lens(c)]
        if rows:
            for i, row in enumerate(rows):
                yield joined(trail, f"frames[{i}]") or "", {**own, **row}
        else:
            yield trail, own
        return
    for name, child in inner:
        if within[name]:
            yield from camera_sections(
                child, joined(trail, name) or "", _with_own_lens(name, own), depth + 1
            )


def _with_lens(sections: Mapping[str, Mapping[str, Any]], own: dict[str, Any]) -> dict[str, Any]:
    """The fields of a camera with those of the sections beside it that speak of its lens.

    A section that may belong to another camera, or is not understood, stays one: the reader of the
    lens refuses it by name.
    """
    of_lens = [n for n in sections if _OF_LENS.search(plain_key(n))]
    of_lens = [n for n in of_lens if not _OF_OTHERS.search(plain_key(n))]
    filed = {n: leaves(sections[n]) for n in of_lens}
    clear = not _contradict([filed[n] for n in of_lens if states_lens(sections[n])])
    for name, child in sections.items():
        is_lens = states_lens(child)
        if name in of_lens and (clear or not is_lens):
            own = {**filed[name], **own}
            if is_lens or not re.search("dist|radial|tangential", plain_key(name)):
                continue
            # Coefficients under names that are not known.
            is_lens = any(isinstance(v, int | float | list) for v in filed[name].values())
        if is_lens:
            own.setdefault(name, child)
    return own


def _with_own_lens(name: str, above: dict[str, Any]) -> dict[str, Any]:
    """What encloses a camera, with the one lens of its name: LEFT_DISTO for LEFT_CAM_HD."""
    lenses = {k: v for k, v in above.items() if isinstance(v, Mapping) and states_lens(v)}
    mates = [k for k in lenses if re.split("[ _.-]", k)[0] == re.split("[ _.-]", name)[0]]
    if len(mates) != 1:
        return above
    return {**{k: v for k, v in above.items() if k not in lenses}, **leaves(lenses[mates[0]])}


def _contradict(sections: list[dict[str, Any]]) -> bool:
    seen: dict[str, Any] = {}
    pairs = [(plain_key(k), v) for fields in sections for k, v in fields.items()]
    return any(seen.setdefault(k, v) != v for k, v in pairs if states_lens({k: v}))


def _is_rows(value: Any) -> bool:
    return bool(_mappings(value))


def _mappings(value: Any) -> list[Mapping[str, Any]]:
    """Sections in a list, or in its pairs of a number and a section, as OAK's cameras have it."""
    rows = value if isinstance(value, list) else []
    pairs = [r[1] if isinstance(r, list) and len(r) == 2 else r for r in rows]
    return [r for r in pairs if isinstance(r, Mapping)]


def leaves(data: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a section and of its own sections."""
    found: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, Mapping) and not is_filled(value):
            found = {**leaves(value), **found}
        elif not _is_rows(value):
            found[key] = value
    return found


def _speaks_of_lens(row: Mapping[str, Any]) -> bool:
    plain = {plain_key(k) for k in row}
    return bool(plain & {*SCALARS["fx"], *SCALARS["cx"], *MATRIX, "k1", "camera_model"})


def joined(name: str, field: str | None) -> str | None:
    """Names of nested sections with dots; None if there is none."""
    return ".".join(filter(None, (name, field))) or None
