"""Files that describe cameras, as plain values: JSON, YAML, XML, INI, lines of text, NumPy.

What the values mean is told by `std_toolkit.geometry.filed_cameras`.
"""

import configparser
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from std_toolkit.errors import ToolkitError
from std_toolkit.io.foreign_files import bounded_yaml_loader, read_json, read_npy, read_npz
from std_toolkit.io.regular import read_text

_LARGEST_FILE = 1024 * 1024
# Real files of cameras have below 10 levels.
_DEEPEST = 40
# No pattern has two neighbours that match the same text: a long file would take quadratic time.
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_WORD = re.compile(rf"{_NUMBER}|[-+]?\.?nan|[-+]?\.?inf", re.IGNORECASE)
# `key:value` without a space, as old files of OpenCV have it; the readers of YAML need one.
_TIGHT = re.compile(r"^([ \t]*(?:- )?[A-Za-z_][\w.]*):(?=[-+.\d\[\"'])", re.MULTILINE)
_YAML_KEY = re.compile(r"^[ \t]*(?:- )?[\"']?[A-Za-z_][\w.]*[\"']?[ \t]*:", re.MULTILINE)
_EQUATION = re.compile(r"^[ \t]*[A-Za-z_][\w .\t]*=", re.MULTILINE)
_SECTION = re.compile(r"^[ \t]*\[[^\]\n]+\][ \t]*$", re.MULTILINE)
# Of arrays of NumPy; those of OpenCV's calibration with all corners of 100 images have fewer.
_MOST_NUMBERS = 100_000
# `print(intrinsics)` of librealsense.
_REALSENSE_LINE = re.compile(
    r"(\d{1,6})x(\d{1,6}) {1,9}p\[([^\]]{0,99})\] {1,9}f\[([^\]]{0,99})\] {1,9}"
    r"([A-Za-z0-9 \-]{1,50}?) {0,9}\[([^\]]{0,199})\]"
)


def read_camera_document(path: Path, size: tuple[int, int] | None) -> Any:
    """The plain values of a file: mappings and lists; a list of numbers for a bare matrix.

    Args:
        path: the file.
        size: image size, to select a stream of `rs-enumerate-devices -c`.

    Raises:
        ToolkitError: unreadable, or of no known syntax.
    """
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        arrays = read_npz(path) if suffix == ".npz" else {"": read_npy(path)}
        if sum(values.size for values in arrays.values()) > _MOST_NUMBERS:
            raise ToolkitError(
                "holds more numbers than a calibration", path=path, value=sorted(arrays)[:8],
                hint="save the camera matrix and the distortion alone",
            )  # fmt: skip
        found = {name: values.tolist() for name, values in arrays.items()}
        return found if suffix == ".npz" else found[""]
    if suffix in (".pkl", ".pickle", ".p", ".mat"):
        raise ToolkitError(
            "files of pickle and MATLAB are not read", path=path,
            hint="save the numbers as JSON, YAML or .npz, or give --intrinsics fx,fy,cx,cy",
        )  # fmt: skip
    text = read_text(path, "intrinsics file", _LARGEST_FILE)
    if 'Intrinsic of "' in text:
        return _realsense_dump(text, path, size)
    start = text.lstrip()
    if line := _REALSENSE_LINE.search(text):
        return _realsense_line(line)
    if start.startswith("<"):
        return _xml(text, path)
    # A matrix as Python prints it is no JSON.
    if words := _bare_numbers(text):
        return words
    if start.startswith("{") or _is_json_list(start):
        return _numbered(read_json(path))
    if (rows := _colmap_rows(text)) is not None:
        return rows
    if blocks := _titled(text):
        return blocks
    if _YAML_KEY.search(text):
        return _yaml(text, path)
    if _SECTION.search(text) or _EQUATION.search(text):
        return _ini(text, path)
    if pairs := _labelled(text):
        return pairs
    raise ToolkitError(
        "no intrinsics found in the file",
        path=path,
        hint="JSON, YAML, XML, INI or plain text with K or fx fy cx cy",
    )


def _is_json_list(text: str) -> bool:
    # "[LEFT_CAM_HD]" is a section of an INI file.
    return re.match(r"\[\s*[\[{\d.\-\"]", text) is not None


def _bare_numbers(text: str) -> list[float]:
    """All numbers of a text that has nothing else; otherwise empty."""
    lines = [line.split("#")[0].replace(",", " ").replace(";", " ") for line in text.splitlines()]
    words = re.sub(r"[\[\]]", " ", " ".join(lines)).split()
    if not words or not all(_WORD.fullmatch(w) for w in words):
        return []
    return [_number(w) for w in words]


def _colmap_rows(text: str) -> list[dict[str, Any]] | None:
    """Rows of a cameras.txt of COLMAP: id, model, width, height, parameters."""
    rows = []
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words:
            continue
        if (
            len(words) < 6
            or not all(w.isdigit() for w in (words[0], *words[2:4]))
            or not re.fullmatch(r"[A-Z][A-Z0-9_]+", words[1])
            or not all(_WORD.fullmatch(w) for w in words[4:])
        ):
            return None
        rows.append(
            {
                "camera_name": words[0],
                "model": words[1],
                "width": int(words[2]),
                "height": int(words[3]),
                "params": [float(w) for w in words[4:]],
            }
        )
    return rows or None


def _labelled(text: str) -> dict[str, Any]:
    """`fx 640.9` line by line; empty if a line is something else."""
    found: dict[str, Any] = {}
    for line in text.splitlines():
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) < 2 or not re.fullmatch(r"[A-Za-z_]\w*", words[0]):
            return {}
        if not all(_WORD.fullmatch(w) for w in words[1:]):
            return {}
        found[words[0]] = _values(words[1:])
    return found


def _titled(text: str) -> dict[str, Any]:
    """Titles with lines of numbers below, as ROS's camera_calibration writes ost.txt.

    Sections become one; empty if a line is something else, or no matrix is among them.
    """
    found: dict[str, list[float]] = {}
    title = ""
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words or _SECTION.fullmatch(line.split("#")[0].strip()):
            continue
        if all(_WORD.fullmatch(w) for w in words):
            if not title:
                return {}
            found[title] += map(_number, words)
        elif re.fullmatch(r"[A-Za-z_ ]+", " ".join(words)) and title != " ".join(words):
            title = " ".join(words)
            if title in found:  # of a second camera
                return {}
            found[title] = []
        else:
            return {}
    if len(found.get("camera matrix", ())) != 9:
        return {}
    return {k: v[0] if len(v) == 1 else v for k, v in found.items()}


def _number(word: str) -> float:
    """The number of a `_WORD`: YAML has `.nan` and `-.inf` for NaN and infinity."""
    return float(word.lower().replace(".n", "n").replace(".i", "i"))


def _values(words: list[str]) -> float | list[float]:
    numbers = [_number(w) for w in words]
    return numbers if len(numbers) > 1 else numbers[0]


def _numbered(value: Any) -> Any:
    """The value with lists of numbers where it has text of several numbers."""
    if isinstance(value, dict):
        return {k: _numbered(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_numbered(v) for v in value]
    found = _plain(value) if isinstance(value, str) else value
    return found if isinstance(found, list) and len(found) > 3 else value


def _plain(text: str) -> Any:
    """A number, a list of numbers, or the text, also where commas may be decimal ones."""
    parts = [part.strip(",;[]") for part in text.split()]
    if (
        "." not in text
        and any(re.search(r"\d,\d", p) for p in parts)
        and all(p.count(",") < 2 for p in parts)
    ):
        return text.strip().strip("\"'")
    words = re.sub(r"[\[\],;]", " ", text).split()
    if words and all(_WORD.fullmatch(w) for w in words):
        return _values(words)
    return text.strip().strip("\"'")


def _ini(text: str, path: Path) -> dict[str, Any]:
    parser = configparser.ConfigParser(
        interpolation=None, strict=True, delimiters=("=",), inline_comment_prefixes=("#", ";")
    )
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    lines = [line.split("#")[0].rstrip() for line in text.splitlines()]
    first = next((line for line in lines if line.strip()), "")
    if not first.lstrip().startswith("["):
        lines = ["[file]", *lines]
    # Lines without a value, such as a title, say nothing of a camera.
    lines = [
        line.strip() for line in lines if "=" in line or re.fullmatch(r"\s*\[[^\]]+\]\s*", line)
    ]
    try:
        parser.read_string("\n".join(lines))
    except configparser.Error as error:
        shown = " ".join(str(error).split())[:200]
        raise ToolkitError(f"not a readable INI file: {shown}", path=path) from error
    sections = {
        name: {key: _plain(value) for key, value in parser[name].items()}
        for name in parser.sections()
    }
    return sections["file"] if list(sections) == ["file"] else sections


def _xml(text: str, path: Path) -> dict[str, Any]:
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ToolkitError("an XML file with a DOCTYPE is not read", path=path)
    try:
        root = ElementTree.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
        found = _element(root, path, 0)
    except (ElementTree.ParseError, RecursionError) as error:
        raise ToolkitError(f"not valid XML: {error}", path=path) from error
    return found if isinstance(found, dict) else {}


def _element(node: ElementTree.Element, path: Path, depth: int) -> Any:
    if depth > _DEEPEST:
        raise ToolkitError(f"nested deeper than {_DEEPEST} levels", path=path, field=node.tag)
    if not len(node):
        return _plain(node.text or "")
    found: dict[str, Any] = {}
    for child in node:
        value = _element(child, path, depth + 1)
        if child.tag in found:
            number = 2
            while f"{child.tag}_{number}" in found:
                number += 1
            found[f"{child.tag}_{number}"] = value
        else:
            found[child.tag] = value
    return found


def _yaml(text: str, path: Path) -> Any:
    """The first document of a YAML file; tags such as OpenCV's are passed over.

    Values are not constructed by the library: numbers are read as Python reads them (1e-05 is a
    number here, a text in YAML 1.1), everything else is text.
    """
    import yaml  # type: ignore[import-untyped]

    text = re.sub(r"^%YAML.*$", "", text, flags=re.MULTILINE)
    text = _TIGHT.sub(r"\1: ", text)
    if "\t" in text:
        text = "\n".join(line.expandtabs(2) for line in text.splitlines()) + "\n"
    try:
        loader = bounded_yaml_loader(text, path)
        nodes = [n for n in yaml.compose_all(text, Loader=loader) if n is not None]
        documents = [_yaml_value(n, path) for n in nodes]
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = " ".join(str(error).split())
        raise ToolkitError(f"not valid YAML: {line[:200]}", path=path) from error
    # `ros2 topic echo` writes a document for each message.
    return documents[0] if len(documents) == 1 else documents


def _yaml_value(node: Any, path: Path) -> Any:
    import yaml

    if isinstance(node, yaml.SequenceNode):
        return [_yaml_value(item, path) for item in node.value]
    if isinstance(node, yaml.MappingNode):
        found: dict[str, Any] = {}
        for key, value in node.value:
            name = str(key.value) if isinstance(key, yaml.ScalarNode) else ""
            item = _yaml_value(value, path)
            if name in found and found[name] != item:
                raise ToolkitError(
                    "a key appears twice",
                    path=path,
                    field=f"line {key.start_mark.line + 1}",
                    value=name[:80],
                )
            found[name] = item
        return found
    text = str(node.value).strip()
    if node.style:  # in quotes
        return _numbered(text)
    if _WORD.fullmatch(text):
        return _number(text)
    if text.lower() in ("null", "~", ""):
        return None
    return {"true": True, "false": False}.get(text.lower(), text)


def _realsense_line(match: re.Match[str]) -> dict[str, Any]:
    numbers = [[float(w) for w in match.group(i).split()] for i in (3, 4, 6)]
    return {
        "width": int(match.group(1)),
        "height": int(match.group(2)),
        "principal_point": numbers[0],
        "focal_length": numbers[1],
        "model": match.group(5),
        "coeffs": numbers[2],
    }


def _realsense_dump(content: str, path: Path, size: tuple[int, int] | None) -> dict[str, Any]:
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
        if key.strip() == "Distortion":
            fields["model"] = value.strip()
        elif isinstance(found := _plain(value), float | list):
            fields[key.strip()] = found
    return fields
