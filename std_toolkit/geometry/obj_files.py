"""OBJ files with their materials and textures, as one self-contained set of files.

What trimesh would lose without a word is put right in the text: byte order marks, options of
texture lines, textures of one name in several folders, faces without `usemtl`.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from PIL import Image

from std_toolkit.errors import ToolkitError
from std_toolkit.log import logger

_LARGEST_MATERIAL_BYTES = 16 * 1024 * 1024
_LARGEST_TEXTURE_BYTES = 512 * 1024 * 1024
# As of images of cameras, `io.image_header`.
_LARGEST_PIXEL_COUNT = 64_000_000
_MARK = b"\xef\xbb\xbf"
# Whole lines, which are stripped afterwards: patterns that find the end of a name themselves take
# time with the square of its length.
_MTLLIB = re.compile(rb"^mtllib[ \t]+([^\n]*)", re.MULTILINE)
_USEMTL = re.compile(rb"^usemtl(?!\S)([^\n]*)", re.MULTILINE)
_NEWMTL = re.compile(r"^newmtl[ \t]+([^\n]*)", re.MULTILINE)
_VERTEX = re.compile(rb"^v[ \t]([^\n]*)", re.MULTILINE)
_FACE = re.compile(rb"^f[ \t]", re.MULTILINE)
_FACE_FROM_ZERO = re.compile(rb"^f[ \t][^\n]*(?<=[ \t])0(?![^/ \t\r\n])", re.MULTILINE)
# What other programs write, and the parsers pass over without a word.
_INDENTED = re.compile(rb"^[ \t]+", re.MULTILINE)
_TABBED = re.compile(rb"^(?:v|vt|vn|f)\t[^\n]*|^(?:v|vt|vn|f) [^\n\t]*\t[^\n]*", re.MULTILINE)
_COMMENTED = re.compile(rb"^((?:v|vt|vn|f)[ \t][^\n#]*)#[^\n]*", re.MULTILINE)
_FACE_WITH_UV = re.compile(rb"^f[ \t]+-?\d+/-?\d", re.MULTILINE)
_MAP = re.compile(r"^[ \t]*(map_K[ade])\b", re.MULTILINE | re.IGNORECASE)
_TEXTURE_KEYS = ("bump", "disp", "decal", "norm", "refl")
# Options of texture lines, with their number of arguments; those of three may have fewer.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1,
    "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip
_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?")
_STORED = {"PNG": ".png", "JPEG": ".jpg"}
# Other formats of textures, which are stored as PNG.
_CONVERTED = ("BMP", "TGA", "TIFF", "WEBP", "GIF", "PPM")


@dataclass(frozen=True)
class ObjFiles:
    """An OBJ file and what it refers to.

    Attributes:
        data: its text; it refers to the names of `files`.
        files: materials and textures by name; a texture's name ends in a digest of its content.
        notes: sentences on what is missing or was changed.
    """

    data: bytes
    files: dict[str, bytes] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def has_one_material(self) -> bool:
        """Whether texture coordinates belong to one texture as they are."""
        return len({m.group(1).strip() for m in _USEMTL.finditer(self.data)}) <= 1

    def __getitem__(self, name: str) -> bytes:
        """The content of a file; with `get` and `keys` the interface of trimesh's resolvers."""
        return self.files[name.removeprefix("./")]

    get = __getitem__

    def keys(self) -> Iterable[str]:
        """Names of the files."""
        return self.files.keys()


class FilesBeside:
    """Files that a mesh of another format names: regular ones in its folder or below.

    The reader of the mesh decides whether one that is missing is an error.

    Attributes:
        missing: names of those that are not there, or lie elsewhere.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.missing: list[str] = []

    def __getitem__(self, name: str) -> bytes:
        for text in dict.fromkeys((name.strip(), unquote(name.strip()))):
            path = _resolved(self.folder, text)
            if path is not None and path.is_relative_to(self.folder) and path.is_file():
                if path.stat().st_size > _LARGEST_TEXTURE_BYTES:
                    raise ValueError(f"{text} is implausibly large")
                return path.read_bytes()
        self.missing.append(name[:80])
        raise FileNotFoundError(f"{name[:80]} is not a file in the folder of the mesh")

    get = __getitem__

    def keys(self) -> Iterable[str]:
        """Nothing: files are found by their names alone."""
        return ()


def _resolved(folder: Path, name: str) -> Path | None:
    """The path of a name; None for names that no file can have."""
    try:
        path = (folder / name.replace("\\", "/")).resolve()
        path.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, a zero byte, a link to itself
        return None
    return path


def read_obj(path: Path, *, strict: bool = False) -> ObjFiles:
    """Read an OBJ file with its materials and textures.

    Args:
        path: the file.
        strict: refuse references to files outside the folder of the mesh (an untrusted mesh could
            refer to any file); otherwise they are left out.

    Raises:
        ToolkitError: such a reference, a texture that is no image, a material that is no text, or
            a face that counts from 0.
    """
    data = _plain_lines(path.read_bytes().removeprefix(_MARK))
    if found := _FACE_FROM_ZERO.search(data):
        raise ToolkitError(
            "a face counts its corners from 0: in OBJ files they count from 1", path=path,
            value=found.group()[:40].decode("ascii", "replace").strip(), hint="export it again",
        )  # fmt: skip
    names = [_text(m.group(1)) for m in _MTLLIB.finditer(data)]
    reader = _Reader(path.parent, path, strict)
    text = "".join(reader.material(found) for name in names for found in reader.libraries(name))
    notes = reader.notes
    data, note = _colors_to_one(data)
    notes += note
    if (extra := _MAP.findall(text)) and "map_kd" not in (kinds := [k.lower() for k in extra]):
        notes.append(f"{', '.join(sorted(set(kinds)))} without map_Kd: it is not shown")
    target = None
    if names:
        target = _safe(Path(names[0].strip().strip('"').replace("\\", "/")).stem) + ".mtl"
        lines = iter([b"mtllib " + target.encode() if text else b""])
        data = _MTLLIB.sub(lambda _: next(lines, b""), data)
    known = [name.strip() for name in _NEWMTL.findall(text)]
    used = {_text(m.group(1)) for m in _USEMTL.finditer(data)}
    if text and not used and "map_" in text.lower() and _FACE_WITH_UV.search(data):
        if len(set(known)) == 1:
            notes.append(f"no face names its material; the only one, {known[0]}, is used")
            start = _FACE.search(data)
            assert start is not None
            line = f"usemtl {known[0]}\n".encode("utf-8", "surrogateescape")
            data = data[: start.start()] + line + data[start.start() :]
        else:
            notes.append("no face names its material (usemtl): the mesh stays without texture")
    notes += _plain_colors(text, used & set(known))
    if text and (lost := sorted(used - set(known) - {""})):
        notes.append(f"materials are missing: {', '.join(lost[:4])}")
    files = dict(reader.files)
    if target is not None and text:
        files = {target: text.encode("utf-8", "surrogateescape"), **files}
    return ObjFiles(data, files, tuple(notes))


def _plain_lines(data: bytes) -> bytes:
    """The text with one way to end and to begin lines, and without comments behind numbers."""
    if b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    data = _INDENTED.sub(b"", data)
    data = _TABBED.sub(lambda match: match.group().replace(b"\t", b" "), data)
    return _COMMENTED.sub(rb"\1", data)


def _text(name: bytes) -> str:
    return name.strip().decode("utf-8", "surrogateescape")


def _plain_colors(text: str, used: set[str]) -> list[str]:
    """What is not shown of materials without a texture: a colour that no face has, or the only one.

    Several colours are those of the faces.
    """
    colors: dict[str, str] = {}
    name = ""
    for words in (line.split() for line in text.splitlines()):
        if words[:1] == ["newmtl"]:
            name = " ".join(words[1:])
        elif words[:1] == ["Kd"] and len(set(words[1:4])) > 1:  # grey is what is shown without
            colors[name] = " ".join(words[1:4])
    if not colors or _MAP.search(text):
        return []
    if not used:
        return [f"no face names its material (usemtl): colour Kd {next(iter(colors.values()))} is "
                "not shown"]  # fmt: skip
    of_faces = {colors.get(name) for name in used}
    if len(of_faces) == 1 and (only := of_faces.pop()):
        return [f"one colour, Kd {only}, and no texture: it is not shown, and tells no pose"]
    return []


def _colors_to_one(data: bytes) -> tuple[bytes, list[str]]:
    """Vertex colours of 0 to 255 as those of 0 to 1 that the format has, and what was changed."""
    rows = [m.group(1).split() for m in _VERTEX.finditer(data)]
    try:
        largest = max((float(word) for row in rows if len(row) == 6 for word in row[3:]), default=0)
    except ValueError:  # the parser will say what is wrong
        return data, []
    if not 1 < largest <= 255:
        return data, []

    def scaled(match: re.Match[bytes]) -> bytes:
        words = match.group(1).split()
        if len(words) != 6:
            return match.group(0)
        return b" ".join([b"v", *words[:3], *(b"%.6f" % (float(w) / 255) for w in words[3:])])

    return _VERTEX.sub(scaled, data), ["vertex colours up to 255 are divided by 255"]


def log_notes(path: Path, files: ObjFiles) -> None:
    """Warn of what is missing or was changed."""
    for note in files.notes:
        logger.warning("%s: %s", path, note)


def _safe(stem: str) -> str:
    return re.sub(r"[^A-Za-z0-9._+-]+", "_", stem).lstrip("._+-")[:64] or "material"


class _Reader:
    """Follows the references of one OBJ file."""

    def __init__(self, folder: Path, mesh: Path, strict: bool) -> None:
        self.folder, self.mesh, self.strict = folder.resolve(), mesh, strict
        self.files: dict[str, bytes] = {}
        self.notes: list[str] = []

    def libraries(self, text: str) -> list[Path]:
        """Material files of a line, whose names may have spaces."""
        whole = self.inside(self.mesh, text, quiet=True)
        if whole is not None:
            return [whole]
        words = text.split()
        parts = [self.inside(self.mesh, word) for word in (words if len(words) > 1 else [text])]
        return [p for p in parts if p is not None]

    def inside(self, source: Path, text: str, *, quiet: bool = False) -> Path | None:
        """The file that a line of `source` names; None if it is missing."""
        name = text.strip().strip('"')
        path = _resolved(source.parent.resolve(), name)
        if path is None:
            raise ToolkitError("names no file", path=source, value=text[:80])
        if not name or not path.is_relative_to(self.folder):
            if self.strict:
                raise ToolkitError(
                    "the mesh refers to a file outside its folder",
                    path=source,
                    value=text,
                    hint="put materials and textures in the folder of the mesh",
                )
            if path.is_file():
                is_named = path.suffix.lower() in (".mtl", ".png", ".jpg", ".jpeg")
                return path if is_named else None
        if not path.is_file():
            if not quiet and (other := self._alike(source.parent, name)) is not None:
                self.notes.append(f"{text} is missing; {other.name} is used")
                return other
            if not quiet:
                self.notes.append(f"{text} is missing; the mesh is read without it")
            return None
        return path

    def _alike(self, folder: Path, name: str) -> Path | None:
        """The only file of this name in other letters, or of a path of another machine."""
        *folders, wanted = name.replace("\\", "/").split("/")
        for start in range(len(folders) + 1):
            place = _resolved(folder.resolve(), "/".join(folders[start:]) or ".")
            if place is None or not place.is_relative_to(self.folder) or not place.is_dir():
                continue
            alike = [p for p in place.iterdir() if p.name.lower() == wanted.lower()]
            found = [p for p in alike if p.is_file()]
            if len(found) == 1 and found[0].resolve().is_relative_to(self.folder):
                return found[0]
        return None

    def material(self, path: Path) -> str:
        """The text of a material file, whose textures have the names of `files`."""
        if path.suffix.lower() != ".mtl":
            if self.strict:
                raise ToolkitError("not a material file", path=self.mesh, value=path.name)
            return ""
        if path.stat().st_size > _LARGEST_MATERIAL_BYTES:
            raise ToolkitError("the material file is implausibly large", path=path)
        text = path.read_bytes().removeprefix(_MARK).decode("utf-8", "surrogateescape")
        lines = [self.line(path, line) for line in text.splitlines()]
        return "\n".join(line for line in lines if line is not None) + "\n"

    def line(self, path: Path, line: str) -> str | None:
        words = line.split(maxsplit=1)
        keyword = words[0].lower() if words else ""
        if (not keyword.startswith("map_") and keyword not in _TEXTURE_KEYS) or len(words) < 2:
            return line
        options, name = texture_options(words[1])
        texture = self.inside(path, name)
        if texture is None:
            return None
        for option, values in options.items():
            if option in ("-s", "-o", "-t") and not _is_neutral(option, values):
                self.notes.append(
                    f"{path.name}: {keyword} {option} {' '.join(values)} is not applied: texture "
                    "coordinates are used as they are"
                )
        target, data = _texture(texture)
        self.files[target] = data
        return f"{words[0]} {target}"


def texture_options(text: str) -> tuple[dict[str, list[str]], str]:
    """Options of a texture line, and the name of the file, which may have spaces.

    >>> texture_options("-s 1 1 1 -o 0 0 red wall.png")
    ({'-s': ['1', '1', '1'], '-o': ['0', '0']}, 'red wall.png')
    """
    found: dict[str, list[str]] = {}
    rest = text.strip()
    for _ in _OPTIONS:  # each at most once
        words = rest.split(maxsplit=1)
        if len(words) < 2 or words[0].lower() not in _OPTIONS:
            break
        option, rest = words[0].lower(), words[1]
        values: list[str] = []
        for _ in range(_OPTIONS[option]):
            head = rest.split(maxsplit=1)
            numeric = _OPTIONS[option] == 1 or _NUMBER.fullmatch(head[0])
            if len(head) < 2 or not numeric:
                break
            values.append(head[0])
            rest = head[1]
        found[option] = values
    return found, rest.strip()


def _is_neutral(option: str, values: list[str]) -> bool:
    wanted = 1.0 if option == "-s" else 0.0
    return all(float(v) == wanted for v in values)


def _texture(path: Path) -> tuple[str, bytes]:
    """Name by content, and bytes, of a texture; formats that few programs read become PNG.

    Raises:
        ToolkitError: not an image.
    """
    if path.stat().st_size > _LARGEST_TEXTURE_BYTES:
        raise ToolkitError("the image file is implausibly large", path=path)
    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data), formats=[*_STORED, *_CONVERTED]) as image:
            if image.width * image.height > _LARGEST_PIXEL_COUNT:
                raise ToolkitError(
                    "the image has an implausible size", path=path, value=list(image.size)
                )
            kind = str(image.format)
            if kind not in _STORED:
                out = io.BytesIO()
                image.convert("RGBA" if "A" in image.getbands() else "RGB").save(out, "PNG")
                data, kind = out.getvalue(), "PNG"
    except ToolkitError:
        raise
    except Exception as error:  # the decoders of Pillow raise many kinds of errors
        raise ToolkitError("not a readable image", path=path) from error
    digest = hashlib.blake2b(data, digest_size=4).hexdigest()
    stem = _safe(path.stem)
    return f"{stem.removesuffix(f'-{digest}')}-{digest}{_STORED[kind]}", data
